//! Which set is watched: one that runs already, or one that `mirror up` is started for.

use crate::cli::{Clock, UpArguments};
use crate::failure::Failure;
use crate::own;
use anyhow::{Context, Result, anyhow};
use profiler::StartedSet;
use runtime::instance::{lookup_roots, nodes, root_for, root_of};
use runtime::{NodeError, Observer, list_instances, now_ns};
use std::os::unix::process::CommandExt;
use std::process::Stdio;
use std::time::Duration;

/// How long a set may take until its launcher is there.
const START_NS: u64 = 60_000_000_000;
/// Between two looks for it.
const LOOK: Duration = Duration::from_millis(10);
/// More episodes than anybody waits for: the set is ended when enough was seen.
const ENDLESS: u32 = 1_000_000;

/// Name of the observer's node.
pub const NODE: &str = "profile";

/// Starts `mirror up` for this instance, with endlessly many episodes if `endless`, and returns once its launcher has
/// its place. It ends with this process.
///
/// # Errors
/// Status 2 when `up` refuses what it was asked for; it has then said why.
pub fn start(
    arguments: &UpArguments,
    instance: &str,
    endless: bool,
) -> Result<(StartedSet, Observer), Failure> {
    let mut command = own::command();
    command
        .arg("up")
        .args(up_options(arguments, instance, endless));
    command.stdin(Stdio::null()).stdout(Stdio::null());
    // Ctrl-C reaches us alone: the run ends in order.
    command.process_group(0);
    let parent = std::process::id() as libc::pid_t;
    // SAFETY: only calls what may be called between fork and exec.
    unsafe {
        command.pre_exec(move || {
            libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGTERM);
            if libc::getppid() != parent {
                libc::_exit(1);
            }
            Ok(())
        });
    }
    let child = command.spawn().context("starting mirror up")?;
    let mut started = StartedSet::new(child);
    let deadline = now_ns() + START_NS;
    let root = root_for(instance);
    loop {
        if let Some(status) = started.ended() {
            return Err(Failure {
                status: status.clamp(1, 255) as u8,
                error: anyhow!("the set did not start"),
            });
        }
        // Its node comes after everything that an earlier run left was removed.
        let nodes = nodes(&root, instance).unwrap_or_default();
        if nodes
            .iter()
            .any(|node| node.alive && node.process == "launcher")
        {
            return Ok((started, Observer::attach(&root, instance, NODE)?));
        }
        if now_ns() > deadline {
            return Err(anyhow!("the set's launcher did not come up in time").into());
        }
        std::thread::sleep(LOOK);
    }
}

/// The command line of `mirror up` for these options.
fn up_options(arguments: &UpArguments, instance: &str, endless: bool) -> Vec<String> {
    let UpArguments {
        scene,
        fog,
        human,
        planner,
        driver,
        episodes,
        clock,
        seed,
        record,
        summary,
        instance: _,
        exec,
        self_model,
        implants,
        spin,
        restarts,
        hang_limit,
        quiet: _,
        view,
        listen,
        void_after,
    } = arguments;
    let episodes = if endless { ENDLESS } else { *episodes };
    let clock = clock.map(|clock| match clock {
        Clock::Lockstep => "lockstep",
        Clock::Realtime => "realtime",
    });
    let planner: &planner::PlannerMethod = planner;
    let mut options = vec![
        format!("--scene={scene}"),
        format!("--human={human}"),
        format!("--planner={}", planner.name()),
        format!("--driver={driver}"),
        format!("--episodes={episodes}"),
        format!("--seed={seed}"),
        format!("--instance={instance}"),
        format!("--spin={spin}"),
        format!("--restarts={restarts}"),
        format!("--hang-limit={hang_limit}"),
        "--quiet".to_owned(),
    ];
    options.extend(clock.map(|clock| format!("--clock={clock}")));
    options.extend(view.then(|| "--view".to_owned()));
    options.extend(listen.map(|listen| format!("--listen={}", listen.0)));
    options.push(format!("--void-after={void_after}"));
    options.extend(fog.map(|fog| format!("--fog={fog}")));
    options.extend(exec.iter().map(|exec| format!("--exec={exec}")));
    for (name, path) in [
        ("record", record),
        ("summary", summary),
        ("self-model", self_model),
        ("implants", implants),
    ] {
        options.extend(
            path.iter()
                .map(|path| format!("--{name}={}", path.display())),
        );
    }
    options
}

/// Joins a set that runs.
///
/// # Errors
/// Status 2, with the names of those that run, if there is none of that name.
pub fn attach(instance: &str) -> Result<Observer, Failure> {
    let mut found = Vec::new();
    for root in lookup_roots() {
        let listed = list_instances(&root).map_err(|error| Failure::refused(anyhow!(error)))?;
        found.extend(listed);
    }
    Observer::attach(&root_of(instance), instance, NODE).map_err(|error| {
        let running: Vec<String> = found
            .into_iter()
            .filter(|state| state.launcher.is_some())
            .map(|state| state.instance)
            .collect();
        let which = match running.is_empty() {
            true => "no process set is running; start one with `mirror up`".to_owned(),
            false => format!("running: {}", running.join(", ")),
        };
        let why = match error {
            NodeError::LauncherGone { .. } => "there is no such instance".to_owned(),
            other => other.to_string(),
        };
        Failure::refused(anyhow!("--attach {instance}: {why}; {which}"))
    })
}
