//! `mirror evaluate`: the paper's studies with simulated people, without processes.

use crate::cli::{EvaluateDriveArguments, EvaluateImplantsArguments, Setting};
use crate::failure::Failure;
use crate::inputs;
use crate::screen::Progress;
use anyhow::{Context, Result};
use experiments::drive::{Condition, ConditionSummary, Study};
use experiments::implants;
use planning::Settings;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;

/// `mirror evaluate drive`: collisions and communication under each condition.
pub fn drive(arguments: &EvaluateDriveArguments) -> Result<ExitCode, Failure> {
    let plan = || -> Result<_> {
        let mut conditions = Vec::new();
        for name in &arguments.conditions {
            let known = || Condition::ALL.map(Condition::name).join(", ");
            let condition = Condition::parse(name).with_context(|| {
                format!(
                    "--conditions {name}: there is no such condition; there are {}",
                    known()
                )
            })?;
            conditions.push(condition);
        }
        let planned = conditions
            .iter()
            .any(|condition| condition.human().is_some());
        let model = planned
            .then(|| inputs::self_model(arguments.self_model.as_deref()))
            .transpose()?;
        Ok((conditions, model.map(|(_, model)| Arc::new(model))))
    };
    let (conditions, model) = plan().map_err(Failure::refused)?;
    let study = Study {
        conditions,
        people: arguments.people,
        seeds: u64::from(arguments.seeds),
        planned_seeds: u64::from(arguments.planned_seeds),
        seed: arguments.seed,
        rounds: arguments.rounds,
        settings: Settings::default(),
    };
    let progress = std::sync::OnceLock::new();
    let summaries =
        experiments::drive::run(&study, model.as_ref(), &arguments.out, &|done, total| {
            let progress = progress.get_or_init(|| Progress::new("people × seeds", total as u64));
            progress.at(done as u64, "");
        })?;
    if let Some(progress) = progress.get() {
        progress.finish();
    }
    print_drive(&summaries);
    println!("{0}/drive.csv, {0}/drive.json", arguments.out.display());
    Ok(ExitCode::SUCCESS)
}

fn print_drive(summaries: &[ConditionSummary]) {
    println!(
        "condition   rounds   collisions [95 % over people]   visual items/min   utterances/min   mean reward"
    );
    for summary in summaries {
        let ConditionSummary {
            condition,
            rounds,
            collisions,
            visual_per_minute,
            utterances_per_minute,
            reward,
            ..
        } = summary;
        let (mean, low, high) = (
            100.0 * collisions.mean,
            100.0 * collisions.low,
            100.0 * collisions.high,
        );
        println!(
            "{condition:<11} {rounds:>6}   {mean:>5.1} % [{low:>5.1}, {high:>5.1}]          {:>16.1} {:>16.1} {:>13.1}",
            visual_per_minute.mean, utterances_per_minute.mean, reward.mean,
        );
    }
}

/// `mirror evaluate implants`: what was learned of people's sight against the truth.
pub fn implants(arguments: &EvaluateImplantsArguments) -> Result<ExitCode, Failure> {
    let (_, model) =
        inputs::self_model(arguments.self_model.as_deref()).map_err(Failure::refused)?;
    let out: &Path = &arguments.out;
    std::fs::create_dir_all(out)
        .with_context(|| out.display().to_string())
        .map_err(Failure::refused)?;
    let settings = training::implants::Settings::default();
    let transfer = arguments.setting == Setting::Transfer;
    let mut reports = Vec::new();
    println!(
        "person   seconds   error where cars were (m)   of the middle (m)   error where cars crossed the limit (m)   azimuths"
    );
    for person in 1..=arguments.people {
        let report = implants::report(&model, person, arguments.rounds, transfer, &settings)?;
        println!(
            "{person:>6}   {:>7.1}   {:>25.2}   {:>17.2}   {:>38.2}   {:>8}",
            report.seconds,
            report.error_present_m,
            report.error_of_middle_m,
            report.error_crossed_m,
            report.crossed
        );
        reports.push(report);
    }
    implants::write_csv(&reports, out)?;
    implants::draw(&reports, out)?;
    println!(
        "{0}/implants.csv, {0}/implants.svg, {0}/implants.png",
        out.display()
    );
    Ok(ExitCode::SUCCESS)
}
