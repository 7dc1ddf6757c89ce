//! A human model written in Python, as a process of the set: it drives runs to their end, takes over and hands over
//! without a step left out, is refused when its messages are not ours, and is replaced when it dies.
//!
//! Needs Python with `iceoryx2` and `numpy`: `MIRROR_PYTHON`, `python3`, or else an environment that the test makes and
//! installs them into from PyPI. Where none of these works, it says so and passes.

mod common;
mod python;

use common::{
    Bench, Live, assert_no_message_lost, assert_nothing_left, assert_replaced, instance, mirror,
    run, summary, swap, told,
};
use messages::{LidarFrame, Message, topic};
use python::python_with_iceoryx2;
use recorder::topics::Recorded;
use runtime::{
    ClockMode, InstanceLock, Launcher, LauncherWake, Node, RunArguments, Stamp, now_ns, text_of,
};
use serde_json::Value;
use std::path::Path;
use std::process::Command;

const NO_PYTHON: &str = "no Python into which iceoryx2 and numpy could be installed";
const EXAMPLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/python");
/// Plans that take a few milliseconds.
const SMALL_PLANS: &str = "[planning]\nrace_steps = 6\nrace_first = 4\nrace_futures = 16\nsamples = 64\nfutures = 1\niterations = 2\nelites = 16\n";

/// The command that starts the example, or `None` where there is no Python for it.
fn human_model(test: &str) -> Option<String> {
    let Some(python) = python_with_iceoryx2() else {
        testing::skipped(test, NO_PYTHON);
        return None;
    };
    Some(format!("{} {EXAMPLE}/human_model.py", python.display()))
}

/// A run with the Python human model, to its end.
fn drives(test: &str, command: &mut Command, bench: &Bench, model: &str) -> Value {
    let name = instance(test);
    let file = bench.path("summary.json");
    command
        .args(["--instance", &name, "--exec", &format!("human={model}")])
        .arg("--summary")
        .arg(&file);
    let output = run(command);
    assert!(output.status.success(), "{}", told(&output));
    assert_nothing_left(&name);
    let summary = summary(&file);
    assert_eq!(summary["completed"], true, "{summary}");
    assert_eq!(summary["deaths"], Value::Array(Vec::new()));
    assert_eq!(summary["restarts"], 0);
    let human = &summary["processes"]["human"];
    assert_eq!(human["end"], "finished", "{summary}");
    assert_eq!(human["steps"], summary["steps"], "a belief for every step");
    assert_no_message_lost(&summary);
    summary
}

/// `mirror up` in lockstep, with an untrained self-model.
fn up(bench: &Bench) -> Command {
    let mut command = mirror();
    command
        .args(["up", "--human", "self", "--self-model"])
        .arg(bench.path("self.safetensors"));
    command
}

#[test]
fn python_drives_in_lockstep_and_repeats_itself() {
    let Some(model) = human_model("python_drives_in_lockstep_and_repeats_itself") else {
        return;
    };
    let bench = Bench::new();
    let drive = |test: &str| {
        let file = bench.path(&format!("{test}.mcap"));
        let mut command = up(&bench);
        command
            .args(["--planner", "none", "--episodes", "2", "--record"])
            .arg(&file);
        drives(test, &mut command, &bench, &model);
        beliefs(&file)
    };
    let (first, second) = (drive("python-first"), drive("python-second"));
    assert!(first.len() > 100, "{} beliefs", first.len());
    assert!(
        first.iter().all(|belief| &belief.kind[..7] == b"python\0"),
        "every belief is the Python model's"
    );
    assert!(first.iter().all(|belief| belief.latent == 12));
    let throttles: Vec<_> = first.iter().map(|belief| belief.action_mean[0]).collect();
    let spread = throttles.iter().fold(f32::NEG_INFINITY, |a, b| a.max(*b))
        - throttles.iter().fold(f32::INFINITY, |a, b| a.min(*b));
    assert!(spread > 0.1, "it predicts, not just one thing: {spread}");
    assert!(first.iter().any(|belief| belief.log_likelihood != 0.0));
    let same = first.iter().zip(&second).all(|(a, b)| {
        (a.mean, a.action_mean, a.action_deviation) == (b.mean, b.action_mean, b.action_deviation)
            && a.log_likelihood.to_bits() == b.log_likelihood.to_bits()
    });
    assert!(
        same && first.len() == second.len(),
        "lockstep is repeatable"
    );
}

/// Every human belief of a recording, in order.
fn beliefs(path: &Path) -> Vec<messages::HumanBelief> {
    let mut found = Vec::new();
    let read = recorder::read::read(path, |message| {
        if let Recorded::HumanBelief(belief) = message {
            found.push(*belief);
        }
    });
    read.unwrap();
    found.sort_by_key(|belief| (belief.header.episode, belief.header.step));
    found
}

#[test]
fn a_planner_asks_python_what_people_would_do() {
    let Some(model) = human_model("a_planner_asks_python_what_people_would_do") else {
        return;
    };
    let bench = Bench::new();
    let scene = bench.write("small.toml", SMALL_PLANS);
    let drive = bench.path("planned.mcap");
    let mut command = up(&bench);
    command
        .args(["--episodes", "1", "--scene"])
        .arg(scene)
        .arg("--record")
        .arg(&drive);
    drives("python-ce", &mut command, &bench, &model);
    let mut planned = 0;
    let read = recorder::read::read(&drive, |message| {
        if let Recorded::CommAction(decision) = message {
            assert_eq!(decision.reason, 0, "every question was answered");
            assert!(decision.value.is_finite());
            planned += 1;
        }
    });
    read.unwrap();
    assert!(planned > 50, "{planned} plans");
}

fn end(mut live: Live, name: &str) {
    live.signal("launcher", libc::SIGINT);
    assert_eq!(live.wait().code(), Some(1), "interrupted");
    live.assert_all_ended();
    assert_nothing_left(name);
}

fn swaps_in_and_out(test: &str, options: &[&str]) {
    let Some(model) = human_model("swaps_in_and_out") else {
        return;
    };
    let bench = Bench::new();
    let name = instance(test);
    let file = bench.path("summary.json");
    let mut command = bench.up(&name);
    command
        .args(["--episodes", "1000000"])
        .args(options)
        .arg("--summary")
        .arg(&file);
    let live = Live::start(&mut command, &name);
    for arguments in [
        &["--exec", &model][..],
        &["self"],
        &["--exec", &model],
        &["self"],
    ] {
        let (output, report) = swap(&name, &bench, &[&["human"], arguments].concat());
        assert!(output.status.success(), "{arguments:?}: {}", told(&output));
        assert_eq!(report["ticks_without_answer"], 0, "{report}");
        assert_eq!(report["lost_messages"], 0, "{report}");
        assert_eq!(report["old_died"], false, "{report}");
    }
    end(live, &name);
    let summary = summary(&file);
    assert_eq!(summary["swaps"].as_array().unwrap().len(), 4);
    assert_eq!(summary["deaths"], Value::Array(Vec::new()));
    assert_no_message_lost(&summary);
}

#[test]
fn python_takes_over_and_hands_over_in_lockstep() {
    swaps_in_and_out("python-swap", &[]);
}

#[test]
fn python_takes_over_and_hands_over_in_real_time() {
    swaps_in_and_out("python-real", &["--clock", "realtime"]);
}

/// The example with two fields of a message in each other's place: as many bytes, another meaning.
fn with_another_layout(bench: &Bench, model: &str) -> String {
    let hash = messages::LidarFrame::layout_text();
    for file in ["human_model.py", "mirror_ports.py", "mirror_process.py"] {
        let text = std::fs::read(Path::new(EXAMPLE).join(file)).unwrap();
        bench.write(file, text);
    }
    let module = std::fs::read_to_string(Path::new(EXAMPLE).join("mirror_messages.py")).unwrap();
    let altered = module.replace(&hash, OTHER_LAYOUT);
    assert_ne!(module, altered);
    bench.write("mirror_messages.py", altered);
    model.replace(EXAMPLE, &bench.directory.path().display().to_string())
}

const OTHER_LAYOUT: &str = "mirror/LidarFrame/1 layout 0123456789abcdef";

#[test]
fn another_layout_is_refused_by_name() {
    let Some(model) = human_model("another_layout_is_refused_by_name") else {
        return;
    };
    let bench = Bench::new();
    let stranger = with_another_layout(&bench, &model);
    let ours = messages::LidarFrame::layout_text();
    let name = instance("python-layout");
    let output = run(bench
        .up(&name)
        .args(["--exec", &format!("human={stranger}")]));
    assert!(!output.status.success(), "{}", told(&output));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    for part in ["world/lidar", &ours, OTHER_LAYOUT] {
        assert!(said.contains(part), "{part}: {said}");
    }
    assert_nothing_left(&name);

    let mut command = bench.up(&name);
    let live = Live::start(command.args(["--episodes", "1000000"]), &name);
    let (output, report) = swap(&name, &bench, &["human", "--exec", &stranger]);
    assert!(!output.status.success(), "{}", told(&output));
    assert_eq!(report, Value::Null);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    for part in ["stays as it is", "world/lidar", &ours, OTHER_LAYOUT] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let (output, _) = swap(&name, &bench, &["human", "self"]);
    assert!(output.status.success(), "{}", told(&output));
    end(live, &name);
}

#[test]
fn a_killed_python_process_is_started_again() {
    let Some(model) = human_model("a_killed_python_process_is_started_again") else {
        return;
    };
    let bench = Bench::new();
    let name = instance("python-killed");
    let file = bench.path("summary.json");
    let mut command = bench.up(&name);
    command
        .args(["--episodes", "5", "--exec", &format!("human={model}")])
        .arg("--summary")
        .arg(&file);
    let mut live = Live::start(&mut command, &name);
    live.signal("human", libc::SIGKILL);
    assert_eq!(live.wait().code(), Some(0));
    live.assert_all_ended();
    assert_nothing_left(&name);
    let summary = summary(&file);
    assert_replaced(&summary, "human");
    assert_eq!(summary["episodes"], 5);
    assert_no_message_lost(&summary);
}

#[test]
fn python_ends_with_its_launcher() {
    let Some(model) = human_model("python_ends_with_its_launcher") else {
        return;
    };
    let bench = Bench::new();
    let name = instance("python-orphan");
    let mut command = bench.up(&name);
    command.args(["--episodes", "1000000", "--exec"]);
    let mut live = Live::start(command.arg(format!("human={model}")), &name);
    live.signal("launcher", libc::SIGKILL);
    live.wait();
    live.wait_for_processes();
    let output = run(bench.up(&name).args(["--episodes", "1"]));
    assert!(output.status.success(), "{}", told(&output));
    assert_nothing_left(&name);
}

/// A process that loses the datagram of its first frame, as the transport may lose it, and waits for a second one.
const SWALLOWS: &str = r#"
import os, socket, stat, sys
from mirror_messages import ProcessState
from mirror_process import Node, RunArguments

def sockets():
    return {int(fd) for fd in os.listdir("/proc/self/fd") if os.path.exists(f"/proc/self/fd/{fd}")
            and stat.S_ISSOCK(os.stat(f"/proc/self/fd/{fd}").st_mode)}

def swallowed(fd):
    try:
        return socket.socket(fileno=os.dup(fd)).recv(1, socket.MSG_DONTWAIT) != b""
    except OSError:
        return False

with Node(RunArguments(sys.argv[-1])) as node:
    before = sockets()
    frames = node.input("world/lidar", in_order=True)
    ours = sockets() - before
    assert node.ready() and node.wait([frames])
    while not any(swallowed(fd) for fd in ours):  # it comes after its message
        pass
    assert node.wait_step(frames, (0, 0))
    node._say(ProcessState.RUNNING, "swallowed")
    assert node.wait_step(frames, (0, 1))
    assert node.lost_wakeups == 0, "it had to look up"
"#;

#[test]
fn python_is_woken_by_the_next_notification_after_one_was_swallowed() {
    let Some(python) = python_with_iceoryx2() else {
        testing::skipped(
            "python_is_woken_by_the_next_notification_after_one_was_swallowed",
            NO_PYTHON,
        );
        return;
    };
    const MINUTE_NS: u64 = 60_000_000_000;
    let bench = Bench::new();
    let root = testing::private_directory();
    let lock = InstanceLock::acquire(root.path(), "swallowed").unwrap();
    let mut launcher = Launcher::open(lock, 7, ClockMode::Lockstep).unwrap();
    let world = RunArguments {
        launcher_pid: 0, // a thread of this process, not a child of a launcher
        ..launcher.arguments().for_process("world", 0)
    };
    let world = Node::join(&world).unwrap();
    let frames = world.output::<LidarFrame>(topic::LIDAR).unwrap();
    let arguments = launcher.arguments().for_process("human", 3);
    let mut child = Command::new(python)
        .env("PYTHONPATH", EXAMPLE)
        .arg(bench.write("swallows.py", SWALLOWS))
        .arg(arguments.write().unwrap())
        .spawn()
        .unwrap();
    let descriptor = runtime::process_descriptor(child.id()).unwrap();
    let watched = [std::os::fd::AsRawFd::as_raw_fd(&descriptor)];
    launcher
        .wait_ready(&["human"], &watched, now_ns() + MINUTE_NS)
        .unwrap();
    launcher.start().unwrap();
    frames.send_with(Stamp::sensed(0, 0), |_| {}).unwrap();
    let said = |launcher: &mut Launcher| {
        let mut said = false;
        while let Some(report) = launcher.next_report().unwrap() {
            said |= text_of(&report.text) == "swallowed";
        }
        said
    };
    while !said(&mut launcher) {
        let wake = launcher.wait(&watched, Some(now_ns() + MINUTE_NS)).unwrap();
        assert_eq!(wake, LauncherWake::Report);
    }
    let stat = format!("/proc/{}/stat", child.id());
    while !std::fs::read_to_string(&stat).unwrap().contains(") S ") {
        std::thread::yield_now();
    }
    frames.send_with(Stamp::sensed(0, 1), |_| {}).unwrap();
    assert!(child.wait().unwrap().success());
}
