//! `mirror up`: starts the process set, watches it to its end, and sums it up.
//!
//! What happens when a process ends before the run does stands in [`supervise`], how one is replaced while the run goes
//! on in [`swap`].

pub mod activity;
mod before;
mod children;
pub mod control_socket;
mod decisions;
mod ended;
mod heads;
mod options;
mod pages;
mod phase;
pub mod plan;
mod plans;
mod run;
mod run_callers;
mod run_stop;
pub mod setup;
mod starting;
mod summary;
mod summary_text;
mod supervise;
mod swap;
mod swap_notice;
mod swap_report;
mod tally;

use crate::cli::UpArguments;
use crate::doctor;
use crate::failure::Failure;
use crate::screen::Screen;
use crate::suspend::Suspension;
use before::Before;
use control_socket::ControlSocket;
use pages::Pages;
use plan::RunPlan;
use planner::PlannerMethod;
use run::Run;
use runtime::{InstanceLock, Launcher, now_ns};
use std::io::IsTerminal;
use std::process::ExitCode;
use summary::{RunEnding, RunSummary};

/// Runs `mirror up`.
pub fn up(arguments: &UpArguments) -> Result<ExitCode, Failure> {
    let mut plan = RunPlan::resolve(arguments).map_err(Failure::refused)?;
    doctor::check_open_files().map_err(Failure::refused)?;
    let lock = InstanceLock::take(&plan.instance).map_err(Failure::refused)?;
    let is_gridworld = plan.scene.gridworld().is_some();
    let plans = plan.planner != PlannerMethod::None;
    doctor::make_room(is_gridworld, plans).map_err(Failure::refused)?;
    let run_id = now_ns() ^ u64::from(std::process::id()) << 40;
    let mut launcher = Launcher::open(lock, run_id, plan.clock)?;
    let suspension = Suspension::new()?;
    let mut socket = ControlSocket::open(&launcher.arguments().directory())?;
    let screen = Screen::new();
    let notes = plan.scene.notes();
    if !notes.is_empty() {
        screen.line(&format!("{}: {}", plan.scene.name, notes.join("; ")));
    }
    starting::learn(&mut plan, &mut launcher, &mut socket, &suspension)?;
    screen.status("starting the processes".to_owned());
    let before = Before::set_aside(&plan).map_err(Failure::refused)?;
    let pages = Pages::prepare(&plan, launcher.arguments()).map_err(Failure::refused)?;
    let mut run = Run::open(plan, &mut launcher, socket, suspension, pages, &screen)?;
    let ending = run.complete();
    screen.finish();
    let is_whole = |ending: &RunEnding| ending.recording.as_ref().is_some_and(|it| it.complete);
    let kept = before.settle(ending.as_ref().is_ok_and(is_whole));
    let summed = ending.map(|ending| {
        let (plan, tally) = run.close();
        (RunSummary::new(&plan, &tally, ending), plan.summary)
    });
    if let Ok((summary, _)) = &summed {
        screen.line(&summary.text(std::io::stdout().is_terminal()));
    }
    for line in kept {
        screen.line(&line);
    }
    let (mut summary, file) = summed?;
    summary.dropped_lines = screen.dropped();
    if let Some(path) = &file {
        summary.save(path)?;
    }
    Ok(if summary.is_success() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}
