//! What a recording keeps of the run that made it, so that it can be replayed from nothing else.

use super::plan::RunPlan;
use crate::inputs;
use anyhow::{Context, Result};
use driver::Acting;
use recorder::setup::{ModelFile, SCHEMA, Setup};
use runtime::ClockMode;
use scenario::Scenario;
use std::collections::BTreeMap;

/// Name of the robot's self-model in [`Setup::files`]: known by its digest, because it is large and ships.
pub const SELF_MODEL: &str = "self-model";
/// Name of what was learned of the person: attached, because `mirror up` learns it anew at every start.
pub const IMPLANTS: &str = "implants";

/// Name of the simulated person's file, where it is the caller's: attached, for human models learn from them.
pub const PERSON: &str = "person";

/// What to write at the head of a recording. `options`: every process's, by process.
///
/// # Errors
/// When a model file cannot be read.
pub fn setup(plan: &RunPlan, options: BTreeMap<String, serde_json::Value>) -> Result<Setup> {
    let human: human::HumanOptions =
        serde_json::from_value(options["human"].clone()).context("options of human")?;
    let identify = |path| {
        ModelFile::identify(path, true).context("what the recording shall say about its models")
    };
    let mut files = BTreeMap::new();
    let model = &plan.self_model.0;
    let digest = inputs::model_digest(model);
    let self_model = ModelFile {
        path: model.clone(),
        blake3: digest.context("what the recording shall say about its models")?,
        attached: false,
    };
    files.insert(SELF_MODEL.to_owned(), self_model);
    if let Some(path) = &human.implants {
        files.insert(IMPLANTS.to_owned(), identify(path)?);
    }
    if let Scenario::Gridworld(Acting::File(path)) = &plan.driver.who {
        files.insert(PERSON.to_owned(), identify(path)?);
    }
    let clock = match plan.clock {
        ClockMode::Lockstep => "lockstep",
        ClockMode::RealTime => "realtime",
    };
    Ok(Setup {
        schema: SCHEMA,
        clock: clock.to_owned(),
        driver: plan.driver.name.clone(),
        options,
        files,
        exec: plan
            .exec
            .iter()
            .map(|(process, command)| ((*process).to_owned(), command.clone()))
            .collect(),
    })
}
