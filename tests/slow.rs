//! In lockstep, nobody is in a hurry: a process that computes for long is waited for, as are a recorder and a launcher that
//! fall behind, and no message is lost. Only a process that stands still is replaced.
//!
//! This test program is also the slow driver: `mirror up` starts it by `--exec`.

mod common;

use common::{
    Bench, Live, assert_no_message_lost, assert_nothing_left, instance, run, status, summary, told,
};
use messages::{DriverAction, LidarFrame, topic};
use runtime::{ClockMode, InputOptions, Node, Receive, RunArguments, Stamp, Wake};
use serde_json::Value;
use std::ffi::OsString;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::{Duration, Instant};
use testing::Stander;

testing::stand_in!(
    drive;
    a_process_that_computes_is_waited_for,
    a_process_that_stands_still_is_replaced,
    a_recorder_that_falls_behind_is_waited_for,
    a_launcher_that_falls_behind_is_waited_for,
);

/// The hang limit of these tests, in seconds, and the processor time for which the slow driver computes.
const LIMIT_S: f64 = 0.3;
const COMPUTES_S: f64 = 6.0 * LIMIT_S;

/// The driver of the tests below.
fn drive(role: &str, file: OsString) {
    let arguments = RunArguments::read(Path::new(&file)).unwrap();
    let mut node = Node::join(&arguments).unwrap();
    let mut frames = node
        .input::<LidarFrame>(topic::LIDAR, Receive::InOrder)
        .unwrap();
    let actions = node.output::<DriverAction>(topic::DRIVER_ACTION).unwrap();
    node.needs_no_catching_up();
    node.ready().unwrap();
    while node.wait(&mut [&mut frames], None).unwrap() != Wake::Stop {
        let Some(frame) = frames.next().unwrap() else {
            continue;
        };
        if frame.header.step == 3 && frame.header.episode == 0 {
            match role {
                "computes" => compute(),
                marker => stand_still_once(Path::new(marker)),
            }
        }
        let action = Stamp::of(&frame.header);
        actions.send_with(action, |_| {}).unwrap();
        node.end_step();
    }
    node.finish().unwrap();
}

/// Keeps the processor busy.
fn compute() {
    let used_s = || {
        // SAFETY: a live structure, written by the call.
        unsafe {
            let mut used: libc::timespec = core::mem::zeroed();
            libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &mut used);
            used.tv_sec as f64 + used.tv_nsec as f64 * 1e-9
        }
    };
    let end_s = used_s() + COMPUTES_S;
    while used_s() < end_s {
        core::hint::spin_loop();
    }
}

/// Waits for what never comes; the next driver of this run does not.
fn stand_still_once(marker: &Path) {
    let mut options = std::fs::OpenOptions::new();
    let first = options
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(marker)
        .is_ok();
    if first {
        loop {
            std::thread::park();
        }
    }
}

fn with_slow_driver(test: &str, role: impl FnOnce(&Bench) -> String) -> Value {
    let bench = Bench::new();
    let name = instance(test);
    let file = bench.path("summary.json");
    let driver = format!("driver={}", Stander::new(&role(&bench)).shell(&[]));
    let mut command = bench.up(&name);
    command
        .args(["--episodes", "2", "--quiet", "--exec", &driver])
        .args(["--hang-limit", &LIMIT_S.to_string(), "--summary"])
        .arg(&file);
    let output = run(&mut command);
    assert!(output.status.success(), "{}", told(&output));
    assert_nothing_left(&name);
    let summary = summary(&file);
    assert_eq!(summary["completed"], true);
    nothing_was_lost(&summary);
    summary
}

fn nothing_was_lost(summary: &Value) {
    assert_no_message_lost(summary);
    assert_eq!(summary["recording"]["complete"], true, "{summary:#}");
}

fn a_process_that_computes_is_waited_for() {
    let summary = with_slow_driver("computes", |_| "computes".to_owned());
    assert_eq!(summary["hangs"], 0);
    assert_eq!(summary["restarts"], 0);
    assert_eq!(summary["deaths"], Value::Array(Vec::new()));
}

fn a_process_that_stands_still_is_replaced() {
    let marker = |bench: &Bench| bench.path("stood-still").display().to_string();
    let summary = with_slow_driver("still", marker);
    assert_eq!(summary["hangs"], 1);
    assert_eq!(summary["restarts"], 1);
    let how = summary["deaths"][0]["how"].as_str().unwrap();
    assert!(how.contains("had not answered"), "{how}");
}

/// Stops one who only listens until everybody has waited for it, or has gone on without it for longer than its ports hold;
/// then lets it go on.
fn is_waited_for(process: &str) {
    let bench = Bench::new();
    let name = instance(&format!("stopped-{process}"));
    let file = bench.path("summary.json");
    let mut command = bench.up(&name);
    command
        .args(["--episodes", "1000000", "--quiet", "--hang-limit", "1000"])
        .arg("--summary")
        .arg(&file);
    let mut live = Live::start_quietly(&mut command, &name);
    let root = runtime::instance::root_for(&name);
    let arguments = RunArguments {
        index: 99,
        ..RunArguments::new(&root, &name, 0, ClockMode::Lockstep).unwrap()
    };
    let node = Node::join(&arguments).unwrap();
    let mut frames = node
        .input_with::<LidarFrame>(topic::LIDAR, InputOptions::recorder())
        .unwrap();
    let mut count = || {
        let mut count = 0;
        while frames.take().unwrap() {
            count += 1;
        }
        count
    };
    while count() == 0 {
        std::thread::yield_now();
    }
    live.signal(process, libc::SIGSTOP);
    let (mut gone_on, mut last) = (0, Instant::now());
    while gone_on < 8 * runtime::RECORDER_BUFFER && last.elapsed() < Duration::from_millis(500) {
        let came = count();
        gone_on += came;
        if came > 0 {
            last = Instant::now();
        }
        std::thread::sleep(Duration::from_millis(1)); // the port holds a thousand frames
    }
    live.signal(process, libc::SIGCONT);
    while count() == 0 {
        std::thread::yield_now();
    }
    assert!(status(&name).is_some(), "the run goes on");
    drop((frames, node));
    live.interrupt();
    assert_eq!(live.wait().code(), Some(1), "interrupted");
    live.assert_all_ended();
    assert_nothing_left(&name);
    let summary = summary(&file);
    assert_eq!(summary["deaths"], Value::Array(Vec::new()));
    nothing_was_lost(&summary);
    assert!(
        gone_on < runtime::RECORDER_BUFFER,
        "{gone_on} steps were driven without the {process}"
    );
}

fn a_recorder_that_falls_behind_is_waited_for() {
    is_waited_for("recorder");
}

fn a_launcher_that_falls_behind_is_waited_for() {
    is_waited_for("launcher");
}
