//! `mirror evaluate real`: human models against recorded drivers.

use crate::cli::EvaluateRealArguments;
use crate::console::out;
use crate::failure::Failure;
use crate::inputs;
use crate::learn::command_line;
use crate::results_file::results_file;
use crate::screen::Progress;
use anyhow::Context;
use domains::commonroad::shipped;
use experiments::real::{MODELS, Report, Rule, Study, run};
use experiments::results::{with_interval, write_section};
use std::path::Path;
use std::process::ExitCode;
use std::sync::OnceLock;
use std::time::Instant;

/// The recorded scene that is studied if nobody says otherwise.
const DATA: &str = "highway-recorded";
/// Splits of the quick form.
const QUICK_SPLITS: u32 = 2;

/// `mirror evaluate real`.
pub fn real(arguments: &EvaluateRealArguments) -> Result<ExitCode, Failure> {
    let started = Instant::now();
    let (_, model) = inputs::self_model(None, arguments.files.self_model.as_deref())
        .map_err(Failure::refused)?;
    let splits = match arguments.quick {
        true => arguments.splits.min(QUICK_SPLITS),
        false => arguments.splits,
    };
    let study = Study {
        data: match &arguments.data {
            Some(data) => data.clone(),
            None => shipped::path(DATA).context("the recorded scene that ships")?,
        },
        splits: u64::from(splits),
        seed: arguments.seed,
        fog_m: arguments.fog,
        quick: arguments.quick,
        rule: Rule::default(),
    };
    let out: &Path = &arguments.files.out;
    let progress = OnceLock::new();
    let report = run(&study, &model, out, &|done, total| {
        let progress = progress.get_or_init(|| Progress::new("models", total as u64));
        progress.at(done as u64, "");
    })?;
    if let Some(progress) = progress.get() {
        progress.finish();
    }
    report.write(out)?;
    print(&report);
    let note = match arguments.quick {
        true => "**Quick form**: it shows that the study runs, and no more.",
        false => "",
    };
    let results = results_file(arguments.files.results.as_deref(), out);
    let body = report.section(&results, out, &command_line(), note);
    write_section(&results, "real", "Recorded drivers (`real`)", &body)?;
    out!(
        "{0}/real.csv, real.json, real.svg, real.png; section `real` of {1}; {2:.0} s",
        out.display(),
        results.display(),
        started.elapsed().as_secs_f64()
    );
    Ok(ExitCode::SUCCESS)
}

fn print(report: &Report) {
    out!(
        "{} drivers, {} of them tested in each of {} splits; {} left out. {}",
        report.drivers,
        report.tested,
        report.splits,
        report.left_out.len(),
        report.rule.words()
    );
    for (name, reason) in &report.left_out {
        out!("  left out {name}: {reason}");
    }
    out!("−log π(a) in nats a step [95 % over splits], by drivers learned from:");
    for kind in MODELS {
        let points: Vec<String> = report
            .of(kind.name())
            .map(|point| {
                let drivers = point.drivers;
                let (mean, median) = (&point.nll, point.median.mean);
                format!(
                    "{drivers}: {}, median {median:.2}",
                    with_interval(mean, 1.0, 2)
                )
            })
            .collect();
        out!("{:<9} {}", kind.name(), points.join("   "));
    }
}
