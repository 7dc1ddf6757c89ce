//! What a set says about itself.

use runtime::{ClockMode, Observer, RunArguments};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// What a set says about itself: from its launcher's answer, and the arguments that it gave its processes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SetDescription {
    /// `lockstep` or `realtime`.
    pub clock: Option<ClockMode>,
    /// How long a process polls before it sleeps, in µs; 0: it is always woken.
    pub spin_us: u32,
    /// The scene.
    pub scene: Option<String>,
    /// Who drives.
    pub driver: Option<String>,
    /// The human model.
    pub human: Option<String>,
    /// The planner.
    pub planner: Option<String>,
    /// Seed.
    pub seed: Option<u64>,
    /// The file that the recorder writes; without it, it only counts and digests.
    pub record: Option<String>,
    /// Identity of the run.
    #[serde(skip)]
    pub run_id: u64,
}

/// Asks the launcher of the instance with this directory for its status.
pub type AskStatus = fn(&Path) -> Option<serde_json::Value>;

/// Reads what a set says about itself; what is not there stays empty.
pub fn about(observer: &Observer, ask: AskStatus) -> SetDescription {
    let mut about = SetDescription::default();
    let mut processes = BTreeMap::new();
    for entry in std::fs::read_dir(observer.directory())
        .into_iter()
        .flatten()
        .flatten()
    {
        let path = entry.path();
        if path
            .extension()
            .is_some_and(|extension| extension == "json")
            && let Ok(arguments) = RunArguments::read(&path)
        {
            processes.insert(arguments.process.clone(), arguments);
        }
    }
    let option = |process: &str, path: &str| {
        let options = &processes.get(process)?.options;
        options
            .pointer(path)
            .filter(|value| !value.is_null())
            .cloned()
    };
    let text = |process, path| Some(option(process, path)?.as_str()?.to_owned());
    if let Some(world) = processes.get("world") {
        about.clock = Some(world.clock);
        about.run_id = world.run_id;
        about.spin_us = world.spin_us;
    }
    if let Some(status) = ask(&observer.directory()) {
        let said = |key: &str| Some(status[key].as_str()?.to_owned());
        about.scene = said("scene");
        about.driver = said("driver");
        about.human = said("human");
        about.planner = said("planner");
        about.seed = status["seed"].as_u64();
    }
    about.record = text("recorder", "/record");
    about
}
