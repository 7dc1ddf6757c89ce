//! `mirror evaluate all`: every study, one after the other, and the time of each.

use crate::cli::{Cli, Command, Evaluate, EvaluateAllArguments};
use crate::console::out;
use crate::failure::Failure;
use crate::learn::command_line;
use crate::results_file::results_file;
use anyhow::{Context, anyhow};
use clap::Parser;
use experiments::results::write_section;
use std::ffi::OsString;
use std::fmt::Write;
use std::process::ExitCode;
use std::time::Instant;

/// A study, its domain where it has several, and the name of the self-model that it takes.
const PARTS: [(&str, &str, &str); 12] = [
    ("fit", "driving", "driving-self"),
    ("fit", "search_rescue", "search-rescue-self"),
    ("fit", "bomb_defusal", "bomb-defusal-self"),
    ("implants", "driving", "driving-self"),
    ("implants", "search_rescue", "search-rescue-self"),
    ("implants", "bomb_defusal", "bomb-defusal-self"),
    ("communicate", "driving", "driving-self"),
    ("communicate", "search_rescue", "search-rescue-self"),
    ("communicate", "bomb_defusal", "bomb-defusal-self"),
    ("implants", "highway", "highway-self"),
    ("real", "", "highway-self"),
    ("drive", "highway", "highway-self"),
];

/// `mirror evaluate all`; `evaluate` runs one study.
pub fn all(
    arguments: &EvaluateAllArguments,
    evaluate: fn(&Evaluate) -> Result<ExitCode, Failure>,
) -> Result<ExitCode, Failure> {
    std::fs::create_dir_all(&arguments.out)
        .with_context(|| arguments.out.display().to_string())
        .map_err(Failure::refused)?;
    let results = results_file(arguments.results.as_deref(), &arguments.out);
    let mut times = Vec::new();
    for (study, domain, model) in PARTS {
        let name = format!("{study} {domain}").trim_end().to_owned();
        out!("== {name}");
        let mut words: Vec<OsString> = vec!["mirror".into(), "evaluate".into(), study.into()];
        if !domain.is_empty() {
            words.extend(["--domain".into(), domain.into()]);
        }
        words.extend(["--out".into(), arguments.out.clone().into()]);
        // The highway's implants have no section.
        if name != "implants highway" {
            words.extend(["--results".into(), results.clone().into()]);
        }
        if let Some(folder) = &arguments.self_models {
            let file = folder.join(format!("{model}.safetensors"));
            words.extend(["--self-model".into(), file.into()]);
        }
        if let (Some(data), "real") = (&arguments.data, study) {
            words.extend(["--data".into(), data.into()]);
        }
        if arguments.quick {
            words.push("--quick".into());
        }
        let parsed = Cli::try_parse_from(words).map_err(|e| Failure::refused(anyhow!(e)))?;
        let Command::Evaluate(study) = parsed.command else {
            continue;
        };
        let started = Instant::now();
        evaluate(&study)?;
        times.push((name, started.elapsed().as_secs_f64()));
    }
    let total: f64 = times.iter().map(|(_, seconds)| seconds).sum();
    let mut body = format!(
        "`{}`: seconds that each part took in this run, which went on from what was there.\n\n| part | seconds |\n| --- | --- |\n",
        command_line()
    );
    for (name, seconds) in &times {
        out!("{name:<28} {seconds:>8.0} s");
        let _ = writeln!(body, "| {name} | {seconds:.0} |");
    }
    out!("{:<28} {total:>8.0} s", "all");
    let _ = writeln!(body, "| all | {total:.0} |");
    write_section(&results, "all", "Time of each part", &body)?;
    Ok(ExitCode::SUCCESS)
}
