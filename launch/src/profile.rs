//! `mirror profile`: starts a set, or joins one that runs, has it watched ([`profiler`]), and writes what was found.

mod target;

use crate::cli::ProfileArguments;
use crate::failure::Failure;
use crate::inputs;
use crate::screen::Screen;
use crate::suspend::Suspension;
use crate::up::control_socket::{self, Question};
use anyhow::{Context, Result, ensure};
use profiler::{Observed, Profile, Samples, Trace, Until, Watch, WatchEnd};
use profiler::{compare, text};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::SystemTime;

/// How long a set that runs already is watched, unless asked otherwise.
const ATTACHED_S: f64 = 10.0;

/// Runs `mirror profile`. Status 0 if something was seen and nothing went wrong with a run of our own, 2 if what was
/// asked for cannot be used.
pub fn profile(arguments: &ProfileArguments) -> Result<ExitCode, Failure> {
    let older = arguments.against.as_deref().map(compare::read);
    let older = older.transpose().map_err(Failure::refused)?;
    if let Some(directory) = &arguments.out {
        prepare(directory).map_err(Failure::refused)?;
    }
    let picture = arguments.picture.as_deref();
    let picture = picture.map(|path| inputs::writable("--picture", path));
    let picture = picture.transpose().map_err(Failure::refused)?;
    check_seconds(arguments).map_err(Failure::refused)?;

    let screen = Screen::new();
    screen.status("waiting for the set".to_owned());
    let (instance, observer, started) = match &arguments.attach {
        Some(instance) => (instance.clone(), target::attach(instance)?, None),
        None => {
            let chosen = arguments.scene.instance.clone();
            let instance = chosen.unwrap_or_else(|| format!("profile-{}", std::process::id()));
            let endless = arguments.own_cost > 0.0 || arguments.seconds.is_some();
            let (started, observer) = target::start(&arguments.scene, &instance, endless)?;
            let (suspension, launcher) = (Suspension::new()?, started.pid());
            std::thread::spawn(move || suspension.pass_on(launcher));
            (instance, observer, Some(started))
        }
    };
    let attached = started.is_none();
    let began = SystemTime::now();
    let mut watch = Watch::new(observer, started, status_of)?;
    screen.status("watching".to_owned());
    let observed = watch.observe(until(arguments))?;
    let mut slowdown = None;
    if arguments.own_cost > 0.0 && matches!(observed.end, WatchEnd::Enough | WatchEnd::Full) {
        screen.status("measuring what watching costs".to_owned());
        slowdown = profiler::cost_of_watching(&mut watch, &observed, arguments.own_cost)?;
    }
    let wrong = watch.end();
    screen.finish();
    if observed.is_empty() {
        return Err(profiler::nothing_seen().into());
    }
    let samples = Samples::new(&observed.reader());
    let profile = Profile::new(&instance, attached, &observed, &samples, slowdown);
    screen.line(&text::text(&profile));
    if let Some(older) = &older {
        let changes = compare::compare(older, &profile);
        screen.line(&text::changes(older, &profile, &changes));
        if let Some(directory) = &arguments.out {
            save_json(&directory.join("changes.json"), &changes)?;
        }
    }
    if let Some(directory) = &arguments.out {
        save(directory, &profile, &observed, &samples, began)?;
        screen.line(&format!(
            "wrote {}/profile.json, profile.hlog (HdrHistogram), trace.json (open it at ui.perfetto.dev)",
            directory.display()
        ));
    }
    if let Some(path) = &picture {
        draw(path, &profile)?;
    }
    Ok(match wrong {
        Some(wrong) => {
            screen.warn(&format!("mirror: {wrong}"));
            ExitCode::FAILURE
        }
        None => ExitCode::SUCCESS,
    })
}

/// The status of the set whose instance has this directory.
fn status_of(directory: &Path) -> Option<serde_json::Value> {
    control_socket::ask(directory, &Question::Status, |_| ()).ok()
}

/// When enough has been seen.
fn until(arguments: &ProfileArguments) -> Until {
    let ns = |seconds: f64| (seconds * 1e9) as u64;
    match (&arguments.attach, arguments.seconds) {
        (_, Some(seconds)) => Until {
            ns: Some(ns(seconds)),
            episodes: None,
        },
        (Some(_), None) => Until {
            ns: Some(ns(ATTACHED_S)),
            episodes: None,
        },
        (None, None) => Until {
            ns: None,
            episodes: Some(arguments.scene.episodes),
        },
    }
}

fn check_seconds(arguments: &ProfileArguments) -> Result<()> {
    let seconds = arguments.seconds.unwrap_or(ATTACHED_S);
    ensure!(
        seconds > 0.0 && seconds <= 86_400.0,
        "--seconds {seconds}: expected more than 0, at most 86400"
    );
    let own_cost = arguments.own_cost;
    ensure!(
        (0.0..=3_600.0).contains(&own_cost),
        "--own-cost {own_cost}: expected 0 to 3600 seconds"
    );
    Ok(())
}

/// What is written into the directory.
const FILES: [&str; 3] = ["profile.json", "profile.hlog", "trace.json"];

/// Makes the directory, and makes sure that files can be written there before anything is measured.
fn prepare(directory: &Path) -> Result<()> {
    let place = || format!("--out {}", directory.display());
    std::fs::create_dir_all(directory).with_context(place)?;
    files::check_directory(directory).context("--out")?;
    for name in FILES {
        files::check(&directory.join(name)).context("--out")?;
    }
    Ok(())
}

fn save_json(path: &Path, value: &impl Serialize) -> Result<()> {
    let mut text = serde_json::to_vec(value).with_context(|| path.display().to_string())?;
    text.push(b'\n');
    Ok(files::write(path, &text)?)
}

fn save(
    directory: &Path,
    profile: &Profile,
    observed: &Observed,
    samples: &Samples,
    began: SystemTime,
) -> Result<()> {
    save_json(&directory.join("profile.json"), profile)?;
    let path: PathBuf = directory.join("profile.hlog");
    let log = profiler::hlog(samples, began, profile.measured.seconds).context("profile.hlog")?;
    files::write(&path, &log)?;
    let around: Vec<(u32, u32)> = [&profile.typical, &profile.slowest]
        .into_iter()
        .flatten()
        .map(|trace: &Trace| (trace.episode, trace.step))
        .collect();
    let about = serde_json::to_value(&profile.measured).context("trace.json")?;
    let trace = profiler::trace(observed, &around, about);
    save_json(&directory.join("trace.json"), &trace)
}

/// Draws a typical step and the slowest.
fn draw(path: &Path, profile: &Profile) -> Result<()> {
    let about = &profile.measured.about;
    let or = |text: &Option<String>| text.clone().unwrap_or_else(|| "?".to_owned());
    let subtitle = format!(
        "scene {} · human model {} · planner {} · {} cores, of which others kept {:.2} busy",
        or(&about.scene),
        or(&about.human),
        or(&about.planner),
        profile.measured.cores,
        profile.measured.others_busy_cores
    );
    let steps = profile.counts.steps;
    let panel = |which: &str, trace: &Option<Trace>| {
        let trace = trace.as_ref()?;
        let ms = trace.latency_ns as f64 * 1e-6;
        let (episode, step) = (trace.episode, trace.step);
        let title = format!("{which} of {steps} steps: episode {episode}, step {step}, {ms:.3} ms");
        Some((title, trace.clone()))
    };
    let panels: Vec<(String, Trace)> = [
        panel("The median", &profile.typical),
        panel("The slowest", &profile.slowest),
    ]
    .into_iter()
    .flatten()
    .collect();
    let drawing = profiler::picture(&panels, &subtitle);
    Ok(files::write(path, drawing.as_bytes())?)
}
