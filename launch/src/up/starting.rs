//! From the command to the run's first step: learning, if the human model has to, and the processes' start. Whoever
//! asks something of the set meanwhile is answered, and it can be suspended and ended.

use super::children::Children;
use super::control_socket::ControlSocket;
use super::plan::RunPlan;
use crate::process::NAMES;
use crate::suspend::Suspension;
use anyhow::{Result, anyhow, bail};
use messages::ProcessState;
use runtime::{Launcher, LauncherWake, now_ns, text_of};

const MS: u64 = 1_000_000;
/// How long processes may take to read their models and make their ports.
pub const READY_NS: u64 = 60_000 * MS;
/// How often learning is looked after.
const LOOK_NS: u64 = 20 * MS;

/// Learns what is still to be learned of the person.
///
/// # Errors
/// When that is not possible, or the user ends it.
pub fn learn(
    plan: &mut RunPlan,
    launcher: &mut Launcher,
    socket: &mut ControlSocket,
    suspension: &Suspension,
) -> Result<()> {
    if !plan.must_learn() {
        return Ok(());
    }
    let (mut learning, run) = (plan.clone(), launcher.arguments().clone());
    let thread = std::thread::spawn(move || learning.learn(&run).map(|()| learning));
    while !thread.is_finished() {
        let mut watched: Vec<_> = socket.descriptors().collect();
        watched.push(suspension.descriptor());
        if launcher.wait(&watched, Some(now_ns() + LOOK_NS))? == LauncherWake::Stop {
            bail!("interrupted while it learned about the person");
        }
        suspension.heed(|_| ());
        socket.answer_early(
            || early_status(plan, "learning"),
            "the set still learns what it takes of the person: the swap begins when it drives",
        );
    }
    *plan = thread
        .join()
        .map_err(|_| anyhow!("learning about the person failed"))??;
    Ok(())
}

/// Waits until every process said that it is ready.
///
/// # Errors
/// When one fails, ends, or takes too long, or the user ends it.
pub fn wait_ready(
    plan: &RunPlan,
    launcher: &mut Launcher,
    children: &mut Children,
    socket: &mut ControlSocket,
    suspension: &Suspension,
) -> Result<()> {
    let deadline = now_ns() + READY_NS;
    let mut missing = NAMES.to_vec();
    while !missing.is_empty() {
        let mut watched = children.descriptors();
        let living = watched.len();
        watched.extend(socket.descriptors());
        watched.push(suspension.descriptor());
        match launcher.wait(&watched, Some(deadline))? {
            LauncherWake::Report => {
                while let Some(report) = launcher.next_report()? {
                    let process = text_of(&report.process);
                    if report.header.run_id != launcher.arguments().run_id {
                        continue;
                    }
                    if report.state() == Ok(ProcessState::Failed) {
                        bail!("{process} failed: {}", text_of(&report.text));
                    }
                    missing.retain(|name| *name != process);
                }
            }
            LauncherWake::Child(at) if at < living => {
                let ended = children.reap(at)?;
                bail!("{} {}", NAMES[ended.place], ended.how);
            }
            LauncherWake::Child(_) => {
                suspension.heed(|signal| children.suspend(signal));
                socket.answer_early(
                    || early_status(plan, "starting"),
                    "the set is just starting: the swap begins when it drives",
                );
            }
            LauncherWake::Stop => bail!("interrupted"),
            LauncherWake::Deadline => {
                let seconds = READY_NS / 1_000_000_000;
                bail!("not ready within {seconds} s: {}", missing.join(", "));
            }
        }
    }
    Ok(())
}

/// What a set that does not drive yet says of itself.
fn early_status(plan: &RunPlan, phase: &str) -> serde_json::Value {
    let mut status = plan.status();
    status["phase"] = phase.into();
    status["processes"] = serde_json::Value::Array(Vec::new());
    status["steps"] = 0.into();
    status
}
