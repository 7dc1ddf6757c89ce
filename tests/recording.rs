//! A drive of the whole set, read by somebody else's reader: every message decodes, and as many as were sent.
//!
//! Needs Python with `mcap` and `mcap-ros2-support`, and with `rosbags` and `rerun-sdk`: `MIRROR_PYTHON`, `python3`, or else an
//! environment that the test makes and installs them into from PyPI. Where none of these works, it says so and passes.

mod common;
mod python;

use common::{Bench, assert_nothing_left, instance, mirror, run, summary, told};
use python::{python, python_with_rosbags};
use std::path::Path;
use std::process::{Command, Output};

const READER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tools/read_recording.py");

#[test]
fn every_message_of_a_drive_decodes_in_python() {
    let Some(python) = python() else {
        testing::skipped(
            "every_message_of_a_drive_decodes_in_python",
            "no Python into which mcap and mcap-ros2-support could be installed",
        );
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

const CHECKER: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../tests/python/check_recording.py"
);

/// Runs a program that checks something, and returns what it printed; it must have succeeded.
fn checked(command: &mut Command) -> String {
    let output: Output = command.output().unwrap();
    assert!(output.status.success(), "{}", told(&output));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Drives, and lets rosbags and rerun look at the recording: neither has any remark. The package of definitions that is
/// written out is the one that the recording carries.
#[test]
fn a_recording_passes_the_checks_of_rosbags_and_rerun() {
    let Some(python) = python_with_rosbags() else {
        testing::skipped(
            "a_recording_passes_the_checks_of_rosbags_and_rerun",
            "no Python into which rosbags and rerun-sdk could be installed",
        );
        return;
    };
    let bench = Bench::new();
    let name = instance("recording-checks");
    let (drive, file) = (bench.path("drive.mcap"), bench.path("summary.json"));
    let mut command = bench.up(&name);
    command.args(["--episodes", "3", "--record"]).arg(&drive);
    let output = run(command.arg("--summary").arg(&file));
    assert!(output.status.success(), "{}", told(&output));
    let package = bench.path("mirror_msgs");
    checked(mirror().args(["messages", "--out"]).arg(&package));
    let steps = summary(&file)["steps"].to_string();
    let text = checked(
        Command::new(python)
            .arg(CHECKER)
            .arg(&drive)
            .args([&steps, "0.15"])
            .arg(&package),
    );
    let definitions = format!("{} definitions", definitions());
    assert!(text.contains(&definitions), "{text}");
    let rerun = python.with_file_name("rerun");
    for more in [&[][..], &["--full"]] {
        let mut command = Command::new(&rerun);
        command.env("HOME", bench.directory.path()); // its settings
        let text = checked(command.args(["mcap", "check"]).args(more).arg(&drive));
        assert!(text.contains("/viz/markers"), "{text}");
        assert!(!text.contains("PROBLEM"), "{text}");
    }
}

/// How many messages there are.
fn definitions() -> usize {
    let mut count = 0;
    messages::for_each_message(|_| count += 1);
    count
}

/// Names that ROS 2 accepts: types in camel case, fields in snake case, and everything that a package must have.
#[test]
fn the_definitions_are_written_as_a_ros2_package() {
    let bench = Bench::new();
    let package = bench.path("made/here");
    let write = |path: &Path| run(mirror().args(["messages", "--out"]).arg(path));
    let output = write(&package);
    assert!(output.status.success(), "{}", told(&output));
    let read = |name: &str| std::fs::read_to_string(package.join(name)).unwrap();
    let (cmake, manifest) = (read("CMakeLists.txt"), read("package.xml"));
    roxmltree::Document::parse(&manifest).unwrap();
    assert!(manifest.contains("<member_of_group>rosidl_interface_packages</member_of_group>"));
    let mut count = 0;
    for entry in std::fs::read_dir(package.join("msg")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        assert!(cmake.contains(&format!("\"msg/{name}\"")), "{cmake}");
        let type_name = name.strip_suffix(".msg").unwrap();
        assert!(type_name.starts_with(|first: char| first.is_ascii_uppercase()));
        assert!(
            type_name
                .chars()
                .all(|letter| letter.is_ascii_alphanumeric())
        );
        let text = read(&format!("msg/{name}"));
        for line in text
            .lines()
            .filter(|line| !line.starts_with('#') && !line.is_empty())
        {
            let (_, field) = line.split_once(' ').unwrap();
            assert!(
                field.starts_with(|first: char| first.is_ascii_lowercase()),
                "{line}"
            );
            let is_snake = |letter: char| matches!(letter, 'a'..='z' | '0'..='9' | '_');
            assert!(field.chars().all(is_snake), "{line}");
            assert!(!field.contains("__") && !field.ends_with('_'), "{line}");
        }
        count += 1;
    }
    assert_eq!(count, definitions());
    let utterance = read("msg/Utterance.msg");
    assert!(
        utterance.contains("\n# What is said; in memory, zero-padded UTF-8.\nstring text\n"),
        "{utterance}"
    );
    // Again, into its own folder; but not among somebody's files.
    assert!(write(&package).status.success());
    let other = bench.directory.path();
    let refused = write(other);
    assert_eq!(refused.status.code(), Some(2), "{}", told(&refused));
    let error = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(error.contains(other.to_str().unwrap()), "{error}");
}
