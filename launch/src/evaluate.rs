//! `mirror evaluate`: the paper's studies with simulated people, without processes.

use crate::cli::{
    Domain, Evaluate, EvaluateDriveArguments, EvaluateForesightArguments,
    EvaluateImplantsArguments, EvaluateUnaidedArguments, Setting,
};
use crate::console::out;
use crate::failure::Failure;
use crate::inputs;
use crate::learn::command_line;
use crate::results_file::results_file;
use crate::screen::Progress;
use crate::{evaluate_all, evaluate_gridworld, evaluate_real};
use anyhow::{Context, Result};
use domains::discrete::SimulatedPerson;
use domains::highway::Scene;
use experiments::claims::write_study;
use experiments::drive::{Condition, Study};
use experiments::drive_report::{ConditionSummary, Report};
use experiments::table::write_json;
use experiments::{foresight, implants, unaided};
use planning::items::highway_settings_of;
use std::path::Path;
use std::process::ExitCode;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Instant;

/// `mirror evaluate`.
pub fn evaluate(study: &Evaluate) -> Result<ExitCode, Failure> {
    if let Some(results) = results_of(study) {
        inputs::writable_file("--results", results).map_err(Failure::refused)?;
    }
    match study {
        Evaluate::Fit(arguments) => evaluate_gridworld::fit(arguments),
        Evaluate::Communicate(arguments) => evaluate_gridworld::communicate(arguments),
        Evaluate::Drive(arguments) => drive(arguments),
        Evaluate::Real(arguments) => evaluate_real::real(arguments),
        Evaluate::Implants(arguments) => match arguments.domain.gridworld() {
            Some(domain) => evaluate_gridworld::implants(arguments, domain),
            None => implants(arguments),
        },
        Evaluate::Foresight(arguments) => foresight(arguments),
        Evaluate::Unaided(arguments) => unaided(arguments),
        Evaluate::All(arguments) => evaluate_all::all(arguments, evaluate),
    }
}

/// The file that a study was asked to write its section into.
fn results_of(study: &Evaluate) -> Option<&Path> {
    match study {
        Evaluate::Fit(arguments) => arguments.common.files.results.as_deref(),
        Evaluate::Communicate(arguments) => arguments.common.files.results.as_deref(),
        Evaluate::Drive(arguments) => arguments.files.results.as_deref(),
        Evaluate::Real(arguments) => arguments.files.results.as_deref(),
        Evaluate::Implants(arguments) => arguments.files.results.as_deref(),
        Evaluate::All(arguments) => arguments.results.as_deref(),
        Evaluate::Foresight(_) | Evaluate::Unaided(_) => None,
    }
}

/// `mirror evaluate foresight`: ranges foreseen against those measured.
fn foresight(arguments: &EvaluateForesightArguments) -> Result<ExitCode, Failure> {
    let (_, model) =
        inputs::self_model(None, arguments.self_model.as_deref()).map_err(Failure::refused)?;
    let out: &Path = &arguments.out;
    std::fs::create_dir_all(out)
        .with_context(|| out.display().to_string())
        .map_err(Failure::refused)?;
    let quick = arguments.quick;
    let study = foresight::Study {
        people: arguments
            .people
            .min(if quick { QUICK_PEOPLE } else { PEOPLE }),
        seeds: if quick { 1 } else { arguments.seeds.into() },
        seed: arguments.seed,
    };
    let progress = Progress::new("looking ahead", study.people.into());
    let report = foresight::run(&study, &model, &mut |done| {
        progress.at(done.into(), "people")
    });
    progress.finish();
    let report = report?;
    for line in report.lines() {
        out!("{line}");
    }
    let path = out.join("foresight.json");
    write_json(&path, &report)?;
    out!("{}", path.display());
    Ok(ExitCode::SUCCESS)
}

/// `mirror evaluate unaided`: the self-model in people's place.
fn unaided(arguments: &EvaluateUnaidedArguments) -> Result<ExitCode, Failure> {
    let domain = arguments.domain.gridworld();
    let everybody = domain.map_or(PEOPLE, |_| SimulatedPerson::COUNT);
    let people = arguments.people.unwrap_or(everybody);
    if people > everybody {
        let error = anyhow::anyhow!("--people {people}: there are {everybody}");
        return Err(Failure::refused(error));
    }
    let (_, model) =
        inputs::self_model(domain, arguments.self_model.as_deref()).map_err(Failure::refused)?;
    let out: &Path = &arguments.out;
    std::fs::create_dir_all(out)
        .with_context(|| out.display().to_string())
        .map_err(Failure::refused)?;
    let quick = arguments.quick;
    let study = unaided::Study {
        domain,
        people: people.min(if quick { QUICK_PEOPLE } else { people }),
        seeds: if quick { 1 } else { arguments.seeds.into() },
        seed: arguments.seed,
        rounds: arguments.rounds,
    };
    let progress = Progress::new("living rounds", study.people.into());
    let done = AtomicU32::new(0);
    let report = unaided::run(&study, &model, &|_| {
        let done = 1 + done.fetch_add(1, Ordering::Relaxed);
        progress.at(done.into(), "people");
    });
    progress.finish();
    let report = report?;
    for line in report.lines() {
        out!("{line}");
    }
    let path = out.join("unaided.json");
    write_json(&path, &report)?;
    out!("{}", path.display());
    Ok(ExitCode::SUCCESS)
}

/// `mirror evaluate drive`: collisions and communication under each condition.
fn drive(arguments: &EvaluateDriveArguments) -> Result<ExitCode, Failure> {
    let started = Instant::now();
    if arguments.domain != Domain::Highway {
        let error = anyhow::anyhow!(
            "--domain: `drive` is the highway's study; a gridworld's is `communicate`"
        );
        return Err(Failure::refused(error));
    }
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
            .then(|| inputs::self_model(None, arguments.files.self_model.as_deref()))
            .transpose()?;
        Ok((conditions, model.map(|(_, model)| model)))
    };
    let (conditions, model) = plan().map_err(Failure::refused)?;
    let fog = Scene::builtin("highway-fog").context("the scene that ships")?;
    let mut study = Study {
        conditions,
        people: arguments.people,
        seeds: u64::from(arguments.seeds),
        planned_seeds: u64::from(arguments.planned_seeds),
        seed: arguments.seed,
        rounds: arguments.rounds,
        settings: highway_settings_of(&fog),
    };
    if arguments.quick {
        study.people = study.people.min(QUICK_PEOPLE);
        study.seeds = 1;
        study.planned_seeds = 1;
        study.settings.samples = QUICK_SAMPLES;
        study.settings.elites = QUICK_SAMPLES / study.settings.futures / 5;
        study.settings.silent = 5;
        study.settings.race.futures = QUICK_FUTURES;
    }
    let progress = OnceLock::new();
    let report = experiments::drive::run(
        &study,
        model.as_ref(),
        &arguments.files.out,
        &|done, total| {
            let progress =
                progress.get_or_init(|| Progress::new("rounds, by effort", total as u64));
            progress.at(done as u64, "");
        },
    )?;
    if let Some(progress) = progress.get() {
        progress.finish();
    }
    report.write(&arguments.files.out)?;
    print_drive(&report);
    let note = if arguments.quick {
        format!(
            "**Quick form**: {} people and at most {QUICK_FUTURES} futures of a candidate; it shows that the study runs, and no more.",
            study.people
        )
    } else {
        String::new()
    };
    let results = results_file(arguments.files.results.as_deref(), &arguments.files.out);
    let body = report.section(&results, &arguments.files.out, &command_line(), &note);
    write_study(
        &results,
        "drive",
        "Driving on the highway (`drive`)",
        &body,
        &report.claims,
    )?;
    out!(
        "{0}/drive.csv, drive.json, drive.svg, drive.png; section `drive` of {1}; {2:.0} s",
        arguments.files.out.display(),
        results.display(),
        started.elapsed().as_secs_f64()
    );
    Ok(ExitCode::SUCCESS)
}

/// People, and imagined futures, of the quick form: it has to end within minutes on two cores.
const QUICK_PEOPLE: u32 = 3;
const QUICK_SAMPLES: usize = 200;
/// Futures that the race's last candidates live through in the quick form.
const QUICK_FUTURES: usize = 16;
/// The highway's people, and rounds that implants are learned from: each of the six cases once.
const PEOPLE: u32 = 21;
const ROUNDS: usize = 6;

fn print_drive(report: &Report) {
    out!(
        "condition   rounds   collisions [95 % over people]   highlighted s/min   utterances/min   mean reward"
    );
    for summary in &report.conditions {
        let ConditionSummary {
            condition,
            rounds,
            collisions,
            highlighted_s_per_minute,
            utterances_per_minute,
            reward,
            ..
        } = summary;
        let (mean, low, high) = (
            100.0 * collisions.mean,
            100.0 * collisions.low,
            100.0 * collisions.high,
        );
        out!(
            "{condition:<11} {rounds:>6}   {mean:>5.1} % [{low:>5.1}, {high:>5.1}]          {:>18.1} {:>16.1} {:>13.1}",
            highlighted_s_per_minute.mean,
            utterances_per_minute.mean,
            reward.mean,
        );
    }
    for tests in &report.tests {
        out!("{}", tests.sentence());
    }
    for claim in &report.claims {
        out!(
            "({}) {}: {}",
            claim.letter,
            claim.claim,
            claim.verdict.word()
        );
    }
}

/// `mirror evaluate implants`: what was learned of people's sight against the truth.
fn implants(arguments: &EvaluateImplantsArguments) -> Result<ExitCode, Failure> {
    let (_, model) = inputs::self_model(None, arguments.files.self_model.as_deref())
        .map_err(Failure::refused)?;
    let out: &Path = &arguments.files.out;
    std::fs::create_dir_all(out)
        .with_context(|| out.display().to_string())
        .map_err(Failure::refused)?;
    let settings = training::implants::ImplantSettings::of(domains::highway::modalities::NAME);
    let transfer = arguments.setting == Setting::Transfer;
    let mut reports = Vec::new();
    out!(
        "person   seconds   error where cars were (m)   of the middle (m)   error where cars crossed the limit (m)   azimuths"
    );
    let all = match arguments.quick {
        true => QUICK_PEOPLE,
        false => PEOPLE,
    };
    let people = arguments.people.unwrap_or(all).min(all);
    for person in 1..=people {
        let rounds = arguments.rounds.unwrap_or(ROUNDS);
        let report = implants::report(&model, person, rounds, transfer, &settings)?;
        out!(
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
    out!(
        "{0}/implants.csv, {0}/implants.svg, {0}/implants.png",
        out.display()
    );
    Ok(ExitCode::SUCCESS)
}
