//! `mirror ls`: the process sets that run now.
//!
//! A set that `mirror up` started says of itself what it is and how far it is. Of any other, and of one that does not
//! answer, what can be seen from outside is told: its launcher, its processes and whether they live.

use crate::cli::ListArguments;
use crate::columns;
use crate::console::out;
use crate::failure::Failure;
use crate::up::activity::GroupActivity;
use crate::up::control_socket::{self, Question};
use anyhow::Context;
use runtime::instance::{directory, lookup_roots};
use runtime::{InstanceState, list_instances};
use serde::Serialize;
use serde_json::Value;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

/// A set has this long to answer: it looks up from what it does every 50 ms, but a machine can be busy.
const PATIENCE: Duration = Duration::from_secs(2);

/// A set that runs.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
struct Running {
    /// Its name, for `--instance` and `--attach`.
    instance: String,
    /// The directory that its own lies in.
    root: PathBuf,
    /// Process id of its launcher; 0 while it takes its place.
    launcher: u32,
    /// See [`state_of`].
    state: String,
    /// What it says of itself: nothing where it does not.
    #[serde(flatten)]
    about: About,
    /// Its processes, in launch order.
    processes: Vec<Process>,
}

/// What a set says of itself.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
struct About {
    scene: Option<String>,
    human: Option<String>,
    planner: Option<String>,
    driver: Option<String>,
    /// `lockstep` or `realtime`.
    clock: Option<String>,
    seed: Option<u64>,
    /// Episodes that it is to drive.
    episodes: Option<u64>,
    /// The one that it drives now, counted from 0.
    episode: Option<u64>,
    /// The newest step of that, counted from 0.
    step: Option<u64>,
    /// Steps of all episodes so far.
    steps: Option<u64>,
}

/// A process of a set.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Process {
    process: String,
    pid: u32,
    /// `active`, `standby` (to take over from another), `starting`, `leaving`; `suspended` where the system has stopped
    /// it; `dead`.
    state: String,
    /// Which of its kind it is, such as `mirror` of human models.
    kind: Option<String>,
}

/// `mirror ls`. Status 2 if the directory of instances cannot be trusted.
pub fn ls(arguments: &ListArguments) -> Result<ExitCode, Failure> {
    let mut running = Vec::new();
    for root in lookup_roots() {
        let states = list_instances(&root).map_err(Failure::refused)?;
        running.extend(states.into_iter().filter_map(look));
    }
    if arguments.json {
        let text = serde_json::to_string_pretty(&running).context("sets as JSON")?;
        out!("{text}");
        return Ok(ExitCode::SUCCESS);
    }
    if running.is_empty() {
        out!("No process set is running; `mirror up` starts one.");
    }
    for (place, set) in running.iter().enumerate() {
        if place > 0 {
            out!("");
        }
        show(set);
    }
    Ok(ExitCode::SUCCESS)
}

/// Asks a set that has a launcher; nothing of what a dead run left.
fn look(state: InstanceState) -> Option<Running> {
    let launcher = state.launcher?;
    let is_suspended = launcher > 0 && is_stopped(launcher);
    let said = match is_suspended {
        true => None,
        false => control_socket::ask_within(
            &directory(&state.root, &state.instance),
            &Question::Status,
            PATIENCE,
        ),
    };
    Some(Running {
        state: state_of(said.as_ref(), is_suspended, &state),
        about: said.as_ref().map(about).unwrap_or_default(),
        processes: match said.as_ref().map(|said| &said["processes"]) {
            Some(Value::Array(children)) if !children.is_empty() => {
                children.iter().filter_map(child).collect()
            }
            _ => from_outside(&state, launcher),
        },
        instance: state.instance,
        root: state.root,
        launcher,
    })
}

/// `learning` about the person before the start, `starting`, `driving`; `suspended`; `replaying` a recording; `silent`
/// where it does not answer.
fn state_of(said: Option<&Value>, is_suspended: bool, state: &InstanceState) -> String {
    let phase = said.and_then(|said| said["phase"].as_str());
    let is_replay = || state.nodes.iter().any(|node| node.process == "replay");
    match phase {
        Some(phase) => phase,
        None if is_suspended => "suspended",
        None if is_replay() => "replaying",
        None => "silent",
    }
    .to_owned()
}

fn about(said: &Value) -> About {
    let text = |key: &str| Some(said[key].as_str()?.to_owned());
    let world = said["processes"]
        .as_array()
        .into_iter()
        .flatten()
        .find(|child| child["process"] == "world");
    let position = |at: usize| world?["position"][at].as_u64();
    About {
        scene: text("scene"),
        human: text("human"),
        planner: text("planner"),
        driver: text("driver"),
        clock: text("clock"),
        seed: said["seed"].as_u64(),
        episodes: said["episodes"].as_u64(),
        episode: position(0),
        step: position(1),
        steps: said["steps"].as_u64(),
    }
}

/// A process as its launcher tells of it.
fn child(said: &Value) -> Option<Process> {
    let pid = u32::try_from(said["pid"].as_u64()?).ok()?;
    let state = match said["phase"].as_str()? {
        _ if is_stopped(pid) => "suspended",
        "Starting" => "starting",
        "StandingBy" => "standby",
        "Speaking" => "active",
        "Leaving" => "leaving",
        other => other,
    };
    Some(Process {
        process: said["process"].as_str()?.to_owned(),
        pid,
        state: state.to_owned(),
        kind: said["kind"].as_str().map(str::to_owned),
    })
}

/// Processes as their nodes show them; the launcher stands elsewhere.
fn from_outside(state: &InstanceState, launcher: u32) -> Vec<Process> {
    let nodes = state.nodes.iter().filter(|node| node.pid != launcher);
    nodes
        .map(|node| Process {
            process: node.process.clone(),
            pid: node.pid,
            state: match node.alive {
                true if is_stopped(node.pid) => "suspended",
                true => "active",
                false => "dead",
            }
            .to_owned(),
            kind: None,
        })
        .collect()
}

/// Whether the system has stopped a process, as Ctrl-Z and SIGSTOP do.
fn is_stopped(pid: u32) -> bool {
    GroupActivity::of_process(pid).is_some_and(|activity| activity.is_stopped)
}

fn show(set: &Running) {
    let about = &set.about;
    let mut words = vec![set.state.clone()];
    words.extend(about.scene.clone());
    for (name, value) in [
        ("driver", &about.driver),
        ("human", &about.human),
        ("planner", &about.planner),
    ] {
        words.extend(value.as_ref().map(|value| format!("{name} {value}")));
    }
    words.extend(about.clock.clone());
    if let (Some(episode), Some(step)) = (about.episode, about.step) {
        words.push(format!("episode {episode} step {step}"));
    }
    words.extend(
        about
            .episodes
            .map(|episodes| format!("{episodes} episodes in all")),
    );
    out!("{}: {}", set.instance, words.join(" · "));
    let launcher = [
        "launcher".to_owned(),
        set.launcher.to_string(),
        match set.state.as_str() {
            "suspended" => "suspended",
            _ => "active",
        }
        .to_owned(),
        String::new(),
    ];
    let rows: Vec<Vec<String>> = std::iter::once(launcher.to_vec())
        .chain(set.processes.iter().map(|process| {
            vec![
                process.process.clone(),
                process.pid.to_string(),
                process.state.clone(),
                process.kind.clone().unwrap_or_default(),
            ]
        }))
        .collect();
    for line in columns::lines(&["process", "pid", "state", "kind"], &rows) {
        out!("  {line}");
    }
}
