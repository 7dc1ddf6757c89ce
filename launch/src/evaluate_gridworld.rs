//! `mirror evaluate fit|communicate|implants` in a gridworld.

use crate::cli::{
    EvaluateCommunicateArguments, EvaluateFitArguments, EvaluateImplantsArguments,
    GridworldStudyArguments,
};
use crate::console::out;
use crate::failure::Failure;
use crate::inputs;
use crate::learn::command_line;
use crate::results_file::results_file;
use crate::screen::Progress;
use anyhow::{Context, Result, anyhow, ensure};
use domains::discrete::Domain;
use experiments::claims::write_study;
use experiments::gridworld::communicate::{self, Condition};
use experiments::gridworld::subject::LEARNING;
use experiments::gridworld::{Common, fit as fits, implants as limits, title};
use experiments::results::Claim;
use models::SelfModel;
use planning::Method;
use std::path::Path;
use std::process::ExitCode;
use std::sync::{Arc, OnceLock};
use std::time::Instant;

/// The quick form: so many people …
const QUICK_PEOPLE: u32 = 3;
/// … so many imagined futures …
const QUICK_SAMPLES: usize = 100;
/// Futures that the race's last candidates live through in the quick form.
const QUICK_FUTURES: usize = 16;
/// … so many phases of soft-Q imitation …
const QUICK_SQIL_PHASES: usize = 8;
/// … and so many rounds a person and condition.
const QUICK_ROUNDS: u32 = 6;

/// Where a study writes, and since when it runs.
struct StudyOutput<'a> {
    out: &'a Path,
    results: Option<&'a Path>,
    started: Instant,
    progress: OnceLock<Progress>,
}

impl<'a> StudyOutput<'a> {
    fn new(out: &'a Path, results: Option<&'a Path>) -> Self {
        Self {
            out,
            results,
            started: Instant::now(),
            progress: OnceLock::new(),
        }
    }

    fn at(&self, done: usize, total: usize) {
        let progress = self
            .progress
            .get_or_init(|| Progress::new("pieces, by effort", total as u64));
        progress.at(done as u64, "");
    }

    /// Writes the section and says where everything lies.
    fn finish(
        &self,
        name: &str,
        heading: &str,
        claims: &[Claim],
        section: impl FnOnce(&Path) -> String,
    ) -> Result<()> {
        if let Some(progress) = self.progress.get() {
            progress.finish();
        }
        let results = results_file(self.results, self.out);
        write_study(&results, name, heading, &section(&results), claims)?;
        for claim in claims {
            let word = claim.verdict.word();
            out!(
                "({}) {}: {word}\n    {}",
                claim.letter,
                claim.claim,
                claim.ours
            );
        }
        out!(
            "{0}/{name}.csv, .json, .svg, .png; section `{name}` of {1}; {2:.0} s",
            self.out.display(),
            results.display(),
            self.started.elapsed().as_secs_f64()
        );
        Ok(())
    }
}

fn prepared(arguments: &GridworldStudyArguments) -> Result<(Common, Arc<SelfModel>)> {
    let domain = arguments.domain.gridworld().ok_or_else(|| {
        anyhow!("--domain highway: this is a study of the gridworlds; the highway's is `drive`")
    })?;
    let (_, model) = inputs::self_model(Some(domain), arguments.files.self_model.as_deref())?;
    let common = Common {
        domain,
        people: match arguments.quick {
            true => arguments.people.min(QUICK_PEOPLE),
            false => arguments.people,
        },
        seeds: u64::from(arguments.seeds),
        seed: arguments.seed,
        sqil_phases: arguments.quick.then_some(QUICK_SQIL_PHASES),
    };
    Ok((common, model))
}

fn sorted(mut percents: Vec<u32>) -> Vec<u32> {
    percents.sort_unstable();
    percents.dedup();
    percents
}

fn note(quick: bool, what: &str) -> String {
    match quick {
        true => format!("**Quick form** ({what}): it shows that the study runs, and no more."),
        false => String::new(),
    }
}

/// `mirror evaluate fit`.
pub fn fit(arguments: &EvaluateFitArguments) -> Result<ExitCode, Failure> {
    let shared = &arguments.common;
    let (common, model) = prepared(shared).map_err(Failure::refused)?;
    let mut percents = sorted(arguments.fractions.clone());
    if let (true, [first, .., last]) = (shared.quick, &percents[..]) {
        percents = vec![*first, *last];
    }
    let study = fits::Study { common, percents };
    let output = StudyOutput::new(&shared.files.out, shared.files.results.as_deref());
    let report = fits::run(&study, &model, output.out, &|done, all| {
        output.at(done, all)
    })?;
    report.write(output.out)?;
    for line in report.lines() {
        out!("{line}");
    }
    let note = note(
        shared.quick,
        "3 people, two numbers of rounds, short soft-Q imitation",
    );
    let heading = format!("Likelihood of people in {} (`fit`)", title(common.domain));
    output.finish(&common.name("fit"), &heading, &report.claims, |results| {
        report.section(results, output.out, &command_line(), &note)
    })?;
    Ok(ExitCode::SUCCESS)
}

/// `mirror evaluate communicate`.
pub fn communicate(arguments: &EvaluateCommunicateArguments) -> Result<ExitCode, Failure> {
    let shared = &arguments.common;
    let plan = || -> Result<_> {
        let (common, model) = prepared(shared)?;
        let mut conditions = Vec::new();
        for name in &arguments.conditions {
            let condition = Condition::parse(name).with_context(|| {
                let known = Condition::DEFAULT.map(Condition::name).join(", ");
                format!("--conditions {name}: there is no such condition; there are {known}, self")
            })?;
            conditions.push(condition);
        }
        if conditions.is_empty() {
            conditions = Condition::DEFAULT.to_vec();
        }
        let (samples, rounds) = match shared.quick {
            true => (QUICK_SAMPLES, QUICK_ROUNDS),
            false => {
                let default = communicate::default_rounds(&common)?;
                (
                    arguments.samples as usize,
                    arguments.rounds.unwrap_or(default),
                )
            }
        };
        let mut settings = communicate::settings(&common, samples).context("--samples")?;
        if shared.quick {
            settings.race.first = QUICK_FUTURES / 2;
            settings.race.futures = QUICK_FUTURES;
        }
        let study = communicate::Study {
            method: match arguments.planner.as_str() {
                "ce" => Method::Ce,
                _ => Method::Race,
            },
            common,
            conditions,
            percents: sorted(arguments.fractions.clone()),
            rounds,
            settings,
        };
        Ok((study, model))
    };
    let (study, model) = plan().map_err(Failure::refused)?;
    let output = StudyOutput::new(&shared.files.out, shared.files.results.as_deref());
    let report = communicate::run(&study, &model, output.out, &|done, all| {
        output.at(done, all)
    })?;
    report.write(output.out)?;
    for line in report.lines() {
        out!("{line}");
    }
    let note = note(
        shared.quick,
        &format!(
            "3 people, {QUICK_ROUNDS} rounds, at most {QUICK_FUTURES} futures of a candidate, short soft-Q imitation"
        ),
    );
    let domain = study.common.domain;
    let heading = format!("Assistance in {} (`communicate`)", title(domain));
    let name = study.common.name("communicate");
    output.finish(&name, &heading, &report.claims, |results| {
        report.section(results, output.out, &command_line(), &note)
    })?;
    Ok(ExitCode::SUCCESS)
}

/// `mirror evaluate implants` of a gridworld.
pub fn implants(
    arguments: &EvaluateImplantsArguments,
    domain: Domain,
) -> Result<ExitCode, Failure> {
    let plan = || -> Result<_> {
        let (_, model) = inputs::self_model(Some(domain), arguments.files.self_model.as_deref())?;
        let people = arguments.people.unwrap_or(10);
        ensure!(people <= 10, "--people {people}: a gridworld has 10");
        let rounds = arguments.rounds.unwrap_or(LEARNING);
        ensure!(
            rounds <= LEARNING,
            "--rounds {rounds}: there are {LEARNING} to learn from"
        );
        let common = Common {
            domain,
            people: if arguments.quick {
                people.min(QUICK_PEOPLE)
            } else {
                people
            },
            seeds: u64::from(arguments.seeds),
            seed: arguments.seed,
            sqil_phases: None,
        };
        Ok((limits::Study { common, rounds }, model))
    };
    let (study, model) = plan().map_err(Failure::refused)?;
    let output = StudyOutput::new(&arguments.files.out, arguments.files.results.as_deref());
    let report = limits::run(&study, &model, output.out, &|done, all| {
        output.at(done, all)
    })?;
    report.write(output.out)?;
    for line in report.lines() {
        out!("{line}");
    }
    let note = note(arguments.quick, "3 people");
    let heading = format!(
        "What MIRROR found of sight in {} (`implants`)",
        title(domain)
    );
    let name = study.common.name("implants");
    output.finish(&name, &heading, &report.claims, |results| {
        report.section(results, output.out, &command_line(), &note)
    })?;
    Ok(ExitCode::SUCCESS)
}
