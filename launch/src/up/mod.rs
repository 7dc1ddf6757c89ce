//! `mirror up`: starts the process set, watches it to its end, and sums it up.
//!
//! What happens when a process ends before the run does stands in [`supervise`], how one is replaced while the run goes
//! on in [`swap`].

mod children;
pub mod door;
mod heads;
pub mod plan;
mod run;
mod summary;
mod supervise;
mod swap;
mod tally;

use crate::cli::UpArguments;
use crate::doctor::SHARED_MEMORY_NEEDED;
use crate::failure::Failure;
use crate::screen::Screen;
use anyhow::anyhow;
use plan::Plan;
use run::Run;
use runtime::instance::{default_root, shared_memory_free};
use runtime::{InstanceLock, Launcher, now_ns};
use std::process::ExitCode;
use summary::Summary;

/// Runs `mirror up`.
pub fn up(arguments: &UpArguments) -> Result<ExitCode, Failure> {
    let mut plan = Plan::resolve(arguments).map_err(Failure::refused)?;
    let free = shared_memory_free();
    if free < SHARED_MEMORY_NEEDED {
        let (free, needed) = (free >> 20, SHARED_MEMORY_NEEDED >> 20);
        return Err(Failure::refused(anyhow!(
            "/dev/shm has {free} MiB free, a set of processes needs {needed}"
        )));
    }
    let lock = InstanceLock::acquire(&default_root(), &plan.instance).map_err(Failure::refused)?;
    let run_id = now_ns() ^ u64::from(std::process::id()) << 40;
    let mut launcher = Launcher::open(lock, run_id, plan.clock)?;
    plan.learn(launcher.arguments())?;
    let screen = Screen::new();
    screen.status("starting the processes".to_owned());
    let mut run = Run::open(plan, &mut launcher, &screen)?;
    let ending = run.complete();
    screen.finish();
    let ending = ending?;
    let (plan, tally) = run.close();
    let summary = Summary::new(&plan, &tally, ending);
    screen.line(&summary.text());
    if let Some(path) = &plan.summary {
        summary.save(path)?;
    }
    Ok(if summary.is_success() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}
