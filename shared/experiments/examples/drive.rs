//! The highway study over all people: `drive SELF_MODEL OUT CONDITIONS [key=value …]`.

use experiments::drive::{Condition, Study, run};
use std::sync::Arc;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, model, out, conditions, rest @ ..] = arguments.as_slice() else {
        anyhow::bail!("usage: drive SELF_MODEL OUT CONDITIONS [key=value …]");
    };
    let mut study = Study {
        conditions: conditions.split(',').filter_map(Condition::parse).collect(),
        people: 21,
        seeds: 3,
        planned_seeds: 1,
        seed: 1,
        rounds: 6,
        settings: planning::Settings::default(),
    };
    for option in rest {
        let (key, value) = option.split_once('=').unwrap_or((option, ""));
        match key {
            "people" => study.people = value.parse()?,
            "planned_seeds" => study.planned_seeds = value.parse()?,
            "terminal" => study.settings.terminal_value = value.parse()?,
            "samples" => study.settings.samples = value.parse()?,
            "elites" => study.settings.elites = value.parse()?,
            _ => anyhow::bail!("unknown option {key}"),
        }
    }
    let model = models::checkpoint::load_self_model(model.as_ref()).map(Arc::new)?;
    let summaries = run(&study, Some(&model), out.as_ref(), &|done, total| {
        eprintln!("{done}/{total}");
    })?;
    for s in summaries {
        println!("{}", serde_json::to_string(&s)?);
    }
    Ok(())
}
