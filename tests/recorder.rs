//! The recorder against what happens to recorders: killed and started again, a disk that is slow, a disk that is full.
//! Nothing that was written is lost, what was not is counted, and the run goes on.

mod common;
mod python;

use common::{Bench, Live, assert_nothing_left, instance, mirror, run, summary, told};
use messages::{LidarFrame, Message, Outcome, topic};
use python::python;
use recorder::read::{Ending, Found, read};
use recorder::recording::About;
use recorder::result::RecorderResult;
use recorder::topics::TOPICS;
use runtime::{ClockMode, InstanceLock, Launcher, Node, RunArguments, Stamp, now_ns};
use std::path::Path;
use std::process::{Child, Command};

const MINUTE_NS: u64 = 60_000_000_000;

/// Sequence numbers of the LIDAR frames in a file, and what else was found.
fn frames(path: &Path) -> (Vec<u64>, Found) {
    let mut sequences = Vec::new();
    let found = read(path, |message| {
        if message.topic() == 0 {
            sequences.push(message.header().sequence);
        }
    });
    (sequences, found.unwrap())
}

/// When the LIDAR frames of a file were, as whole steps of the drive from 1970 on, and what is left over.
fn times(path: &Path) -> Vec<(u64, u64)> {
    const STEP_NS: u64 = 150_000_000;
    let bytes = std::fs::read(path).unwrap();
    let options = mcap::read::Options::IgnoreEndMagic;
    let messages = mcap::MessageStream::new_with_options(&bytes, options.into()).unwrap();
    let messages = messages.map_while(Result::ok);
    messages
        .filter(|message| message.channel.topic == "/world/lidar")
        .map(|message| (message.log_time / STEP_NS, message.log_time % STEP_NS))
        .collect()
}

/// The last step that any message of a file is of.
fn last_step(path: &Path) -> (u32, u32) {
    let mut last = (0, 0);
    let found = read(path, |message| {
        let header = message.header();
        if TOPICS[message.topic()].is_repeatable() {
            last = last.max((header.episode, header.step));
        }
    });
    found.unwrap();
    last
}

/// How many messages Python's own reader finds before a file breaks off, by topic and in all.
fn python_counts(python: &Path, file: &Path) -> serde_json::Value {
    const SCRIPT: &str = "
import json, sys
from mcap.exceptions import McapError
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from struct import error
channels, counts, end = {}, {}, 'closed'
with open(sys.argv[1], 'rb') as file:
    try:
        for record in StreamReader(file, validate_crcs=True).records:
            if isinstance(record, Channel):
                channels[record.id] = record.topic
            elif isinstance(record, Message):
                topic = channels[record.channel_id]
                counts[topic] = counts.get(topic, 0) + 1
    except (McapError, error) as what:
        end = type(what).__name__
print(json.dumps({'counts': counts, 'end': end}))
";
    let output = Command::new(python)
        .args(["-c", SCRIPT])
        .arg(file)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", told(&output));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// A recorder in a process of its own, a sender in this one, and the launcher between them.
struct Set {
    launcher: Launcher,
    node: Node,
    lidar: runtime::Output<LidarFrame>,
    outcome: runtime::Output<Outcome>,
    recorder: RunArguments,
    step: u32,
}

impl Set {
    fn new(root: &Path, options: &recorder::RecorderOptions) -> Self {
        let lock = InstanceLock::acquire(root, "parts").unwrap();
        let launcher = Launcher::open(lock, options.about.run_id, ClockMode::Lockstep).unwrap();
        let recorder = launcher
            .arguments()
            .for_process("recorder", 0)
            .with_options(options)
            .unwrap();
        let sender = RunArguments {
            launcher_pid: 0, // a thread of this process, not a child of a launcher
            ..launcher.arguments().for_process("sender", 1)
        };
        let node = Node::join(&sender).unwrap();
        Self {
            lidar: node.output(topic::LIDAR).unwrap(),
            outcome: node.output(topic::OUTCOME).unwrap(),
            launcher,
            node,
            recorder,
            step: 0,
        }
    }

    fn start_recorder(&mut self) -> Child {
        let file = self.recorder.write().unwrap();
        let child = mirror().arg("process").arg(file).spawn().unwrap();
        let deadline = now_ns() + MINUTE_NS;
        self.launcher
            .wait_ready(&["recorder"], &[], deadline)
            .unwrap();
        self.launcher.start_process(0).unwrap();
        child
    }

    /// Sends steps at a pace that a recorder can follow, until `done`.
    fn send(&mut self, mut done: impl FnMut(u32) -> bool) {
        while !done(self.step) {
            let stamp = Stamp {
                episode: 0,
                step: self.step,
                cause_ns: 1,
            };
            let write = |frame: &mut LidarFrame| {
                // What does not compress, so that chunks fill the file.
                let mut state = u64::from(stamp.step) * 0x9e37_79b9_7f4a_7c15 + 1;
                for range in &mut frame.range {
                    state ^= state << 13;
                    state ^= state >> 7;
                    state ^= state << 17;
                    *range = state as f32 / u64::MAX as f32;
                }
            };
            self.lidar.send_with(stamp, write).unwrap();
            self.outcome
                .send_with(stamp, |outcome| outcome.reward = 0.5)
                .unwrap();
            self.step += 1;
            self.node.wait(&mut [], Some(now_ns() + 300_000)).unwrap();
        }
    }
}

#[test]
fn a_killed_recorder_leaves_its_chunks_and_the_next_one_goes_on() {
    let root = testing::private_directory();
    let (file, result) = (
        root.path().join("drive.mcap"),
        root.path().join("result.json"),
    );
    let second = root.path().join("drive.part2.mcap");
    // What an older run left under the same names is no part of this one.
    std::fs::write(&file, b"something else").unwrap();
    std::fs::write(&second, b"something else").unwrap();
    let options = recorder::RecorderOptions {
        record: Some(file.clone()),
        result: Some(result.clone()),
        about: About {
            run_id: 77,
            ..About::default()
        },
        ..recorder::RecorderOptions::default()
    };
    let mut set = Set::new(root.path(), &options);
    let mut child = set.start_recorder();
    set.send(|_| std::fs::metadata(&file).is_ok_and(|found| found.len() > 300_000));
    child.kill().unwrap(); // SIGKILL
    child.wait().unwrap();
    set.launcher.clean().unwrap();
    let killed_at = u64::from(set.step);
    let before = std::fs::read(&file).unwrap();
    let (first, found) = frames(&file);
    assert!(
        matches!(found.ending, Ending::Cut { .. }),
        "{:?}",
        found.ending
    );
    assert_eq!(found.run_id, Some(77));
    assert_eq!(first, (0..first.len() as u64).collect::<Vec<_>>());
    // The chunk that was being filled may have been just begun.
    assert!(first.len() > 100 && (first.len() as u64) <= killed_at);

    // The world does not wait for recorders.
    let gap_end = set.step + 40;
    set.send(|step| step >= gap_end);
    let mut child = set.start_recorder();
    let last = set.step + 300;
    set.send(|step| step >= last);
    set.launcher.stop().unwrap();
    assert!(child.wait().unwrap().success());

    assert_eq!(
        std::fs::read(&file).unwrap(),
        before,
        "the first part was touched"
    );
    let result = RecorderResult::load(&result).unwrap();
    assert_eq!(result.parts, [file.clone(), second.clone()]);
    assert_eq!(result.file.as_deref(), Some(file.as_path()));
    assert!(!result.complete);
    assert_eq!(result.digest, "", "a digest of what was not received");
    let (later, found) = frames(&second);
    assert_eq!(found.ending, Ending::Closed);
    for name in [LidarFrame::ROS_TYPE, Outcome::ROS_TYPE] {
        let known = TOPICS.iter().find(|topic| topic.ros_type == name).unwrap();
        let counts = &result.topics[known.name];
        // All of the gap, but for what its sender keeps for those who join late.
        let least = 40 - runtime::HISTORY as u64;
        assert!(counts.lost_restart >= least, "{name}: {counts:?}");
        assert_eq!(
            counts.written + counts.lost(),
            u64::from(set.step),
            "{name}: {counts:?}"
        );
        let lost = &found.closing.as_ref().unwrap()[&format!("lost {}", known.name)];
        assert_eq!(*lost, counts.lost().to_string());
    }
    assert_eq!(found.closing.as_ref().unwrap()["complete"], "false");
    // Complete but for the gap that was counted.
    assert_eq!(later.last(), Some(&u64::from(set.step - 1)));
    assert_eq!(later, (later[0]..u64::from(set.step)).collect::<Vec<_>>());
    let counts = &result.topics[topic::LIDAR];
    assert_eq!(later[0] - first.len() as u64, counts.lost_restart);
    assert_eq!(counts.written, (first.len() + later.len()) as u64);

    let Some(python) = python() else {
        testing::skipped(
            "a_killed_recorder_leaves_its_chunks_and_the_next_one_goes_on",
            "no Python into which mcap could be installed",
        );
        return;
    };
    let found = python_counts(python, &file);
    let theirs = found["counts"]["/world/lidar"].as_u64().unwrap();
    // A chunk that was cut is ours alone to open.
    assert!(theirs > 100 && theirs <= first.len() as u64, "{found}");
    assert_eq!(
        python_counts(python, &second)["counts"]["/world/lidar"],
        later.len()
    );
}

#[test]
fn a_recorder_killed_in_a_whole_run_leaves_a_recording() {
    let bench = Bench::new();
    let (name, file) = (instance("recorder-killed"), bench.path("drive.mcap"));
    let json = bench.path("summary.json");
    let mut command = bench.up(&name);
    command
        .args(["--episodes", "1000000", "--record"])
        .arg(&file);
    let mut live = Live::start(command.arg("--summary").arg(&json), &name);
    while std::fs::metadata(&file).is_ok_and(|found| found.len() < 200_000) {
        live.wait_for_line("START");
    }
    live.signal("recorder", libc::SIGKILL);
    let second = bench.path("drive.part2.mcap");
    while std::fs::metadata(&second).map_or(0, |found| found.len()) < 200_000 {
        live.wait_for_line("START");
    }
    live.signal("launcher", libc::SIGINT);
    assert_eq!(live.wait().code(), Some(1));
    live.assert_all_ended();
    assert_nothing_left(&name);
    let (mut sequences, found) = frames(&file);
    assert!(
        matches!(found.ending, Ending::Cut { .. }),
        "{:?}",
        found.ending
    );
    assert!(found.setup.is_some());
    assert_eq!(sequences, (0..sequences.len() as u64).collect::<Vec<_>>());
    assert!(sequences.len() > 20);
    let (later, found) = frames(&second);
    assert_eq!(found.ending, Ending::Closed);
    sequences.extend(later);
    // The drive's time goes on: forward, and from step to step.
    let times = [times(&file), times(&second)].concat();
    assert!(times.is_sorted_by(|before, after| before.0 < after.0));
    assert!(times.iter().all(|(_, rest)| *rest == times[0].1));
    let recording = &summary(&json)["recording"];
    assert_eq!(
        recording["parts"].as_array().unwrap().len(),
        2,
        "{recording}"
    );
    let lidar = &recording["topics"]["world/lidar"];
    let missing = sequences.last().unwrap() + 1 - sequences.len() as u64;
    assert!(missing > 0);
    assert_eq!(lidar["written"], sequences.len());
    assert_eq!(lidar["lost_restart"], missing, "{recording}");
    assert_eq!(recording["complete"], false);
    // What it left can be replayed.
    let replayed = instance("recorder-killed-replay");
    let output = run(mirror()
        .arg("replay")
        .arg(&file)
        .args(["--instance", &replayed]));
    assert_eq!(output.status.code(), Some(1), "{}", told(&output));
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    for words in [
        "CUT SHORT",
        "drive.part2.mcap",
        "GAPS",
        "what is there is the same bit for bit",
        "only a part of the drive",
    ] {
        assert!(text.contains(words), "no {words:?} in {text}");
    }
    assert!(!text.contains("REPRODUCED"), "{text}");
    assert_nothing_left(&replayed);
}

/// `--exec recorder=…` with a recorder whose options say that its disk is slow.
fn slow_recorder(bench: &Bench, stall_ms: u32, blocks: u32) -> String {
    let slow = bench.path("slow.json");
    let slow = slow.display();
    let text = format!(
        "set -e\nsed -e 's/\"stall_ms_per_chunk\":0/\"stall_ms_per_chunk\":{stall_ms}/' \
         -e 's/\"queue_blocks\":0/\"queue_blocks\":{blocks}/' \"$1\" > {slow}\n\
         grep -q 'chunk\":{stall_ms}.*blocks\":{blocks}\\|blocks\":{blocks}.*chunk\":{stall_ms}' {slow}\n\
         exec {} process {slow}\n",
        env!("CARGO_BIN_EXE_mirror")
    );
    let script = bench.write("slow.sh", text);
    format!("recorder=sh {}", script.display())
}

#[test]
fn a_slow_disk_costs_counted_messages_in_real_time_and_the_run_goes_on() {
    let bench = Bench::new();
    let scene = bench.write(
        "fast.toml",
        "name = \"fast\"\n[clock]\nrate = 40.0\n[episode]\nmax_steps = 120\n",
    );
    let (name, file) = (instance("stall"), bench.path("drive.mcap"));
    let json = bench.path("summary.json");
    std::fs::write(&file, "an earlier drive").unwrap();
    let mut command = bench.up(&name);
    command.args(["--episodes", "3", "--clock", "realtime", "--exec"]);
    command
        .arg(slow_recorder(&bench, 400, 64))
        .arg("--scene")
        .arg(scene);
    let output = run(command
        .arg("--record")
        .arg(&file)
        .arg("--summary")
        .arg(&json));
    assert_eq!(output.status.code(), Some(1), "{}", told(&output));
    assert_nothing_left(&name);
    let summary = summary(&json);
    assert_eq!(summary["completed"], true, "{}", told(&output));
    let recording = &summary["recording"];
    assert_eq!(recording["complete"], false);
    assert_eq!(recording["error"], serde_json::Value::Null);
    let (_, found) = frames(&file);
    assert_eq!(found.ending, Ending::Closed);
    let closing = found.closing.as_ref().unwrap();
    assert_eq!(closing["complete"], "false");
    let mut topics_with_loss = 0;
    for (topic, counts) in recording["topics"].as_object().unwrap() {
        let count = |what: &str| counts[what].as_u64().unwrap();
        assert_eq!(
            count("received"),
            count("written") + count("lost_queue"),
            "{topic}"
        );
        assert_eq!(
            closing[&format!("lost {topic}")],
            (count("lost_queue") + count("lost_ports")).to_string()
        );
        topics_with_loss += u32::from(count("lost_queue") > 0);
    }
    assert!(topics_with_loss >= 6, "{recording}");
    assert!(
        String::from_utf8_lossy(&output.stdout).contains("INCOMPLETE"),
        "{}",
        told(&output)
    );
    // What is not whole takes nothing's place.
    let kept = bench.path("drive.mcap.before");
    assert_eq!(std::fs::read(&kept).unwrap(), b"an earlier drive");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains(kept.to_str().unwrap()), "{said}");
    // The gaps are where the file says they are.
    let lost = found.counted_lost().unwrap();
    let replayed = instance("stall-replay");
    let output = run(mirror()
        .arg("replay")
        .arg(&file)
        .args(["--instance", &replayed]));
    assert_eq!(output.status.code(), Some(1), "{}", told(&output));
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        text.contains(&format!("{lost} messages were lost")) && text.contains("GAPS"),
        "{text}"
    );
    assert!(text.contains("only a part of the drive"), "{text}");
}

#[test]
fn a_slow_disk_costs_nothing_in_lockstep() {
    let bench = Bench::new();
    let scene = bench.write(
        "short.toml",
        "name = \"short\"\n[episode]\nmax_steps = 100\n",
    );
    let (name, file) = (instance("stall-lockstep"), bench.path("drive.mcap"));
    let json = bench.path("summary.json");
    let mut command = bench.up(&name);
    command
        .args(["--episodes", "2", "--exec"])
        .arg(slow_recorder(&bench, 30, 64));
    command.arg("--scene").arg(scene);
    let output = run(command
        .arg("--record")
        .arg(&file)
        .arg("--summary")
        .arg(&json));
    assert!(output.status.success(), "{}", told(&output));
    assert_eq!(summary(&json)["recording"]["complete"], true);
    let (sequences, found) = frames(&file);
    assert_eq!(found.counted_lost(), Some(0));
    assert_eq!(
        sequences.len() as u64,
        summary(&json)["steps"].as_u64().unwrap()
    );
}

#[test]
fn a_full_disk_costs_counted_messages_and_the_run_goes_on() {
    let bench = Bench::new();
    let (disk, copy) = (bench.path("disk"), bench.path("copy.mcap"));
    std::fs::create_dir(&disk).unwrap();
    // A file system of our own, in a namespace of our own: it is gone with the command.
    let small = |size: &str, then: &str| {
        let mut command = Command::new("unshare");
        command.args(["--user", "--map-root-user", "--mount", "sh", "-c"]);
        command.arg(format!(
            "mount -t tmpfs -o size={size} none \"$1\" && {{ {then}; }}"
        ));
        command.arg("sh").arg(&disk);
        command
    };
    if !small("64k", "true")
        .output()
        .is_ok_and(|output| output.status.success())
    {
        testing::skipped(
            "a_full_disk_costs_counted_messages_and_the_run_goes_on",
            "a file system cannot be mounted here",
        );
        return;
    }
    let (name, json) = (instance("disk-full"), bench.path("summary.json"));
    let then = "disk=$1; copy=$2; shift 2; \"$@\"; status=$?; cp \"$disk/drive.mcap\" \"$copy\"; exit $status";
    let mut command = small("500k", then);
    let mut up = bench.up(&name);
    up.args(["--episodes", "3", "--record"])
        .arg(disk.join("drive.mcap"))
        .arg("--summary")
        .arg(&json);
    command.arg(&copy).arg(up.get_program()).args(up.get_args());
    let output = run(&mut command);
    assert_eq!(output.status.code(), Some(1), "{}", told(&output));
    assert_nothing_left(&name);
    let summary = summary(&json);
    assert_eq!(summary["completed"], true, "{}", told(&output));
    assert_eq!(summary["episodes"], 3);
    assert!(
        summary["digest"].is_string(),
        "all was received, so that there is a digest"
    );
    let recording = &summary["recording"];
    assert_eq!(recording["complete"], false);
    let (sequences, found) = frames(&copy);
    let last = last_step(&copy);
    // What happened, to which file, and where that ends: in the summary, in the file and on the terminal.
    let error = recording["error"].as_str().unwrap();
    assert!(
        error.contains("drive.mcap: no space left on device"),
        "{error}"
    );
    let end = format!("it ends after episode {} step {}", last.0, last.1);
    assert!(error.contains(&end), "{error}: not {end}");
    assert_eq!(found.ending, Ending::Closed, "there was room for an end");
    let closing = found.closing.as_ref().unwrap();
    assert_eq!(closing["complete"], "false");
    assert_eq!(closing["error"], error);
    let lidar = &recording["topics"]["world/lidar"];
    assert_eq!(lidar["written"], sequences.len());
    let lost = lidar["lost_disk"].as_u64().unwrap();
    assert!(lost > 0 && !sequences.is_empty());
    assert_eq!(
        sequences.len() as u64 + lost,
        summary["steps"].as_u64().unwrap()
    );
    assert_eq!(sequences, (0..sequences.len() as u64).collect::<Vec<_>>());
    let warned = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(warned.contains("recording incomplete"), "{warned}");
    assert!(warned.contains(error), "{warned}");
    let told = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(told.contains("no space left on device"), "{told}");
}
