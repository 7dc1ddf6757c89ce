//! `mirror doctor`: what runs, what dead runs left, and whether this machine's limits suffice.

use crate::cli::DoctorArguments;
use crate::failure::Failure;
use runtime::instance::{default_root, shared_memory_free};
use runtime::{InstanceState, cleanup_dead, list_instances};
use std::process::ExitCode;

/// What a set needs in shared memory, generously.
pub const SHARED_MEMORY_NEEDED: u64 = 64 << 20;
/// Open files that a process of a set needs, generously.
const FILES_NEEDED: u64 = 512;

/// Prints the report. Status 0 if all is well, 1 if something was left behind or a limit is too low.
pub fn doctor(arguments: &DoctorArguments) -> Result<ExitCode, Failure> {
    let root = default_root();
    let mut well = true;
    println!("Instances below {}", root.display());
    let states =
        list_instances(&root).map_err(|error| Failure::from(anyhow::Error::from(error)))?;
    if states.is_empty() {
        println!("  none runs, and none left anything");
    }
    for state in &states {
        let left = show(state);
        if !left {
            continue;
        }
        if arguments.clean {
            let report = cleanup_dead(&root, &state.instance).map_err(anyhow::Error::from)?;
            println!(
                "    cleaned: {} dead processes, {} files in shared memory",
                report.nodes, report.files
            );
            well &= report.failed == 0;
        } else {
            println!("    `mirror doctor --clean` removes it");
            well = false;
        }
    }
    println!("Limits");
    let free = shared_memory_free();
    well &= limit(
        "shared memory free (/dev/shm)",
        free >> 20,
        SHARED_MEMORY_NEEDED >> 20,
        "MiB",
    );
    well &= limit("open files (ulimit -n)", open_files(), FILES_NEEDED, "");
    let cores = std::thread::available_parallelism().map_or(1, usize::from) as u64;
    well &= limit("processor cores", cores, 1, "");
    Ok(if well {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

/// Prints an instance; true if it is, in part or in whole, what a dead run left.
fn show(state: &InstanceState) -> bool {
    let dead = state.nodes.iter().filter(|node| !node.alive).count();
    match state.launcher {
        Some(pid) => println!("  {}: runs under process {pid}", state.instance),
        None => println!("  {}: its launcher is dead", state.instance),
    }
    for node in &state.nodes {
        let word = if node.alive { "lives" } else { "is dead" };
        println!("    {:<10} process {:<8} {word}", node.process, node.pid);
    }
    println!("    {} files in shared memory", state.shared_files);
    state.launcher.is_none() || dead > 0
}

fn limit(what: &str, have: u64, need: u64, unit: &str) -> bool {
    let enough = have >= need;
    let word = if enough { "ok" } else { "TOO LOW" };
    println!("  {what:<32} {have} {unit} (needed: {need}) {word}");
    enough
}

fn open_files() -> u64 {
    let mut limit = libc::rlimit {
        rlim_cur: 0,
        rlim_max: 0,
    };
    // SAFETY: a live structure of the right type.
    match unsafe { libc::getrlimit(libc::RLIMIT_NOFILE, &mut limit) } {
        0 => limit.rlim_cur,
        _ => 0,
    }
}
