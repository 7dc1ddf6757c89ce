//! A drive of the whole set, read by somebody else's reader: every message decodes, and as many as were sent.
//!
//! Needs Python with `mcap` and `mcap-ros2-support`: `MIRROR_PYTHON`, `python3`, or else an environment that the test makes
//! and installs them into from PyPI. Where none of these works, it says so and passes.

mod common;
mod python;

use common::{Bench, assert_nothing_left, instance, run, summary, told};
use python::python;
use std::process::Command;

const READER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tools/read_recording.py");

#[test]
fn every_message_of_a_drive_decodes_in_python() {
    let Some(python) = python() else {
        eprintln!("skipped: no Python into which mcap and mcap-ros2-support could be installed");
        return;
    };
    let bench = Bench::new();
    let name = instance("recording");
    let (drive, file) = (bench.path("drive.mcap"), bench.path("summary.json"));
    let mut command = bench.up(&name);
    command.args(["--episodes", "2", "--record"]).arg(&drive);
    let output = run(command.arg("--summary").arg(&file));
    assert!(output.status.success(), "{}", told(&output));
    assert_nothing_left(&name);
    let summary = summary(&file);
    assert_eq!(summary["recording"]["complete"], true);

    let read = Command::new(python)
        .args([READER, "--complete"])
        .arg(&drive)
        .output()
        .unwrap();
    assert!(read.status.success(), "{}", told(&read));
    let found: serde_json::Value = serde_json::from_slice(&read.stdout).unwrap();
    let topics = summary["recording"]["topics"].as_object().unwrap();
    assert!(topics.len() >= 8, "{topics:?}");
    let mut messages = 0;
    for (topic, counts) in topics {
        let written = counts["written"].as_u64().unwrap();
        let decoded = &found["topics"][format!("/{topic}")]["messages"];
        assert_eq!(decoded.as_u64().unwrap_or(0), written, "{topic}: {found}");
        assert_eq!(counts["received"], counts["written"], "{topic}");
        messages += written;
    }
    let steps = summary["steps"].as_u64().unwrap();
    assert!(messages > 6 * steps, "{messages} messages in {steps} steps");
    for derived in ["/viz/scan_low", "/viz/markers", "/tf"] {
        let decoded = found["topics"][derived]["messages"].as_u64().unwrap();
        assert!(decoded >= steps, "{derived}: {decoded} of {steps}");
    }
}
