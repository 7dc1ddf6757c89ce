//! Killing any process of a set: the run ends, or goes on, as `mirror up`'s table says; nothing stays behind.

mod common;

use common::{Bench, Live, assert_nothing_left, instance, run, summary, told};

/// Kills `process` in a running set and returns the summary.
fn killed(process: &str, after: impl FnOnce(&mut Live)) -> serde_json::Value {
    let bench = Bench::new();
    let name = instance(process);
    let file = bench.path("summary.json");
    let mut command = bench.up(&name);
    command
        .args(["--episodes", "1000000", "--summary"])
        .arg(&file);
    let mut live = Live::start(&mut command, &name);
    live.signal(process, libc::SIGKILL);
    after(&mut live);
    let status = live.wait();
    assert_eq!(status.code(), Some(1), "{process}");
    live.assert_all_ended();
    assert_nothing_left(&name);
    next_run_works(&bench, &name);
    summary(&file)
}

fn next_run_works(bench: &Bench, name: &str) {
    let output = run(bench.up(name).args(["--episodes", "1"]));
    assert!(output.status.success(), "{}", told(&output));
    assert_nothing_left(name);
}

fn ends_the_run(process: &str) {
    let summary = killed(process, |_| {});
    let reason = summary["ended_early"].as_str().unwrap();
    assert!(
        reason.contains(process) && reason.contains("signal 9"),
        "{reason}"
    );
    assert!(
        summary["deaths"][process]
            .as_str()
            .unwrap()
            .contains("signal 9")
    );
    assert_eq!(summary["completed"], false);
    assert_eq!(summary["digest"], serde_json::Value::Null);
}

#[test]
fn world_ends_the_run() {
    ends_the_run("world");
}

#[test]
fn driver_ends_the_run() {
    ends_the_run("driver");
}

#[test]
fn belief_ends_the_run() {
    ends_the_run("belief");
}

#[test]
fn human_ends_the_run() {
    ends_the_run("human");
}

#[test]
fn planner_ends_the_run() {
    ends_the_run("planner");
}

#[test]
fn renderer_ends_the_run() {
    ends_the_run("renderer");
}

#[test]
fn recorder_leaves_the_run_going_and_interrupt_ends_it() {
    let summary = killed("recorder", |live| {
        live.wait_for_line("START");
        live.wait_for_line("START");
        live.signal("launcher", libc::SIGINT);
    });
    assert_eq!(summary["ended_early"], "interrupted");
    assert!(
        summary["deaths"]["recorder"]
            .as_str()
            .unwrap()
            .contains("signal 9")
    );
    assert_eq!(summary["recording"], serde_json::Value::Null);
    assert!(summary["episodes"].as_u64().unwrap() >= 2);
}

#[test]
fn launcher_takes_everybody_with_it() {
    let bench = Bench::new();
    let name = instance("launcher");
    let mut live = Live::start(bench.up(&name).args(["--episodes", "1000000"]), &name);
    live.signal("launcher", libc::SIGKILL);
    live.wait();
    live.wait_for_processes();
    next_run_works(&bench, &name);
}
