//! `mirror replay`: feeds a recorded drive to belief, human model and planner again, as processes of their own, in
//! lockstep over shared memory, and compares what they say with what was said then.

mod report;
mod report_text;
mod resolve;
mod set;
mod shown;

use crate::cli::ReplayArguments;
use crate::doctor;
use crate::failure::Failure;
use crate::inputs;
use crate::screen::Screen;
use anyhow::Context;
use report::ReplayReport;
use resolve::Resolved;
use runtime::{ClockMode, InstanceLock, Launcher, now_ns};
use set::Set;
use std::process::ExitCode;

/// Runs `mirror replay`. Status 0 if the replay of a whole drive came to its end and, where everything is as it was
/// recorded, every decision is the same; 1 if one differs that should not, or if the recording is but a part of the
/// drive.
pub fn replay(arguments: &ReplayArguments) -> Result<ExitCode, Failure> {
    let summary = arguments.summary.as_deref();
    let summary = summary.map(|path| inputs::writable("--summary", path));
    let summary = summary.transpose().map_err(Failure::refused)?;
    let drive = ::replay::Drive::read(&arguments.recording).map_err(Failure::refused)?;
    let mut resolved = Resolved::new(arguments, &drive).map_err(Failure::refused)?;
    doctor::check_open_files().map_err(Failure::refused)?;
    let name = arguments.instance.clone();
    let name = name.unwrap_or_else(|| format!("replay-{}", std::process::id()));
    let lock = InstanceLock::take(&name).map_err(Failure::refused)?;
    let is_gridworld = resolved.belief.scenario.gridworld().is_some();
    let plans = resolved.planner.method != planner::PlannerMethod::None;
    doctor::make_room(is_gridworld, plans).map_err(Failure::refused)?;
    let run_id = now_ns() ^ u64::from(std::process::id()) << 40;
    let mut launcher = Launcher::open(lock, run_id, ClockMode::Lockstep)?;
    let directory = launcher.arguments().directory();
    resolved
        .provide(&drive, &directory)
        .map_err(Failure::refused)?;
    let items = resolved.items().map_err(Failure::refused)?;
    let screen = Screen::new();
    for warning in &resolved.warnings {
        screen.warn(&format!("mirror: {warning}"));
    }
    let rows = directory.join("rows.jsonl");
    let started = now_ns();
    let mut set = Set::start(&launcher, &resolved, &arguments.recording, &rows, &screen)?;
    let ended = set.play(&mut launcher, &screen);
    let all_well = set.end(&mut launcher, ended.is_ok());
    screen.finish();
    ended.and(all_well)?;
    let rows = ::replay::load_rows(&rows).context("the replay's rows")?;
    launcher.clean()?;
    let beside = shown::beside(&rows);
    let mut report = ReplayReport::new(&drive, &resolved, items, rows);
    report.wall_seconds = (now_ns() - started) as f64 * 1e-9;
    screen.line(&report.text(arguments.lines));
    if let Some(path) = &summary {
        report.save(path)?;
    }
    if arguments.view {
        shown::show(arguments, &drive, &resolved, beside, &screen)?;
    }
    Ok(if report.is_success() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}
