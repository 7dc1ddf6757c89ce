//! `mirror doctor`: what runs, what dead runs left, and whether this machine's limits suffice.

use crate::cli::DoctorArguments;
use crate::console::out;
use crate::failure::Failure;
use crate::keeps_up;
use anyhow::{Context, Result, ensure};
use runtime::instance::lookup_roots;
use runtime::{
    InstanceState, OPEN_FILES_NEEDED, cleanup_dead, list_instances, open_files, shared_memory_free,
    shared_memory_needed,
};
use std::process::ExitCode;

/// Prints the report. Status 0 if all is well, 1 if something was left behind or a limit is too low, 2 if the directory
/// of instances cannot be trusted; a machine that is too slow for real time is well, for in lockstep it need not keep up.
pub fn doctor(arguments: &DoctorArguments) -> Result<ExitCode, Failure> {
    let mut well = true;
    for root in lookup_roots() {
        let states = list_instances(&root).map_err(Failure::refused)?;
        out!("Instances below {}", root.display());
        if states.is_empty() {
            out!("  none runs, and none left anything");
        }
        for state in &states {
            well &= examine(state, arguments.clean)?;
        }
    }
    out!("Limits");
    match shared_memory_free() {
        Ok(free) => {
            let needed = shared_memory_needed(false, true);
            let (free, needed) = (free >> 10, needed >> 10);
            well &= limit("shared memory free (/dev/shm)", free, needed, "KiB");
        }
        Err(error) => {
            out!("  {error}");
            well = false;
        }
    }
    well &= limit(
        "open files (ulimit -n)",
        open_files(),
        OPEN_FILES_NEEDED,
        "",
    );
    let cores = std::thread::available_parallelism().map_or(1, usize::from) as u64;
    well &= limit("processor cores", cores, 1, "");
    if !arguments.clean {
        keeps_up::report()?;
    }
    Ok(if well {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

/// Shows an instance and cleans it if asked to; whether nothing is left of a dead run.
fn examine(state: &InstanceState, clean: bool) -> Result<bool> {
    if !show(state) {
        return Ok(true);
    }
    if !clean {
        out!("    `mirror doctor --clean` removes it");
        return Ok(false);
    }
    let report = cleanup_dead(&state.root, &state.instance)?;
    out!(
        "    cleaned: {} dead processes, {} files in shared memory",
        report.nodes,
        report.files
    );
    Ok(report.failed == 0)
}

/// Whether every process of a set may open as many files as it needs.
///
/// # Errors
/// Says how many it may.
pub fn check_open_files() -> Result<()> {
    let (have, need) = (open_files(), OPEN_FILES_NEEDED);
    ensure!(
        have >= need,
        "a process may open {have} files here, and those of a set need {need}; raise the limit (`ulimit -n {need}`)"
    );
    Ok(())
}

/// Makes sure that `/dev/shm` has room for the messages of a set; if it has not, what dead runs left is removed.
///
/// # Errors
/// Says what is free and what is needed, or why `/dev/shm` cannot be used.
pub fn make_room(is_gridworld: bool, plans: bool) -> Result<()> {
    let needed = shared_memory_needed(is_gridworld, plans);
    if shared_memory_free()? >= needed {
        return Ok(());
    }
    for root in lookup_roots() {
        for state in list_instances(&root)? {
            if state.launcher.is_none() {
                let clean = cleanup_dead(&root, &state.instance);
                clean.with_context(|| format!("what instance `{}` left", state.instance))?;
            }
        }
    }
    let free = shared_memory_free()?;
    ensure!(
        free >= needed,
        "/dev/shm has {} KiB free, and this set needs {}; other sets or programs hold the rest: `mirror doctor` lists sets, `mirror doctor --clean` removes what dead ones left",
        free >> 10,
        needed.div_ceil(1 << 10)
    );
    Ok(())
}

/// Prints an instance; true if it is, in part or in whole, what a dead run left.
fn show(state: &InstanceState) -> bool {
    let dead = state.nodes.iter().filter(|node| !node.alive).count();
    match state.launcher {
        Some(pid) => out!("  {}: runs under process {pid}", state.instance),
        None => out!("  {}: its launcher is dead", state.instance),
    }
    for node in &state.nodes {
        let word = if node.alive { "lives" } else { "is dead" };
        out!("    {:<10} process {:<8} {word}", node.process, node.pid);
    }
    out!("    {} files in shared memory", state.shared_files);
    state.launcher.is_none() || dead > 0
}

fn limit(what: &str, have: u64, need: u64, unit: &str) -> bool {
    let enough = have >= need;
    let word = if enough { "ok" } else { "TOO LOW" };
    out!("  {what:<32} {have} {unit} (needed: {need}) {word}");
    enough
}
