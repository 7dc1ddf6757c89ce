//! The recorder in a run: it sees every message from the start to the last word, with and without a file.

mod common;

use common::{about, known};
use messages::{
    CommAction, Display, DriverAction, HumanBelief, LidarFrame, Message, Outcome, ProcessState,
    RobotBelief, Scene, topic,
};
use recorder::RecorderOptions;
use recorder::result::RecorderResult;
use recorder::topics::TOPICS;
use runtime::{
    ClockMode, Digest, InstanceLock, Launcher, LauncherWake, Node, Output, RunArguments, Stamp,
    now_ns,
};
use std::path::Path;

const STEPS: u32 = 400;

/// Everything that a run's processes send, in one.
struct Sender {
    node: Node,
    lidar: Output<LidarFrame>,
    scene: Output<Scene>,
    outcome: Output<Outcome>,
    robot: Output<RobotBelief>,
    human: Output<HumanBelief>,
    comm: Output<CommAction>,
    display: Output<Display>,
    action: Output<DriverAction>,
    digest: Digest,
}

impl Sender {
    fn join(arguments: &RunArguments) -> anyhow::Result<Self> {
        let node = Node::join(arguments)?;
        Ok(Self {
            lidar: node.output(topic::LIDAR)?,
            scene: node.output(topic::SCENE)?,
            outcome: node.output(topic::OUTCOME)?,
            robot: node.output(topic::ROBOT_BELIEF)?,
            human: node.output(topic::HUMAN_BELIEF)?,
            comm: node.output(topic::COMM_ACTION)?,
            display: node.output(topic::DISPLAY)?,
            action: node.output(topic::DRIVER_ACTION)?,
            digest: Digest::new(),
            node,
        })
    }

    /// Sends all steps; the digest of what was sent.
    fn run(&mut self) -> anyhow::Result<String> {
        self.node.ready()?;
        for step in 0..STEPS {
            let digest = &mut self.digest;
            send(&self.lidar, step, digest)?;
            send(&self.scene, step, digest)?;
            send(&self.outcome, step, digest)?;
            send(&self.robot, step, digest)?;
            send(&self.human, step, digest)?;
            send(&self.comm, step, digest)?;
            send(&self.display, step, digest)?;
            send(&self.action, step, digest)?;
        }
        self.node.finish()?;
        Ok(self.digest.hex())
    }
}

fn send<M: Message>(output: &Output<M>, step: u32, digest: &mut Digest) -> anyhow::Result<()> {
    let message = known::<M>(step, 3);
    digest.add(output.topic(), &message);
    let stamp = Stamp {
        episode: 0,
        step,
        cause_ns: 1,
    };
    Ok(output.send_with(stamp, |place| *place = message)?)
}

/// Runs a recorder against a sender; the recorder's result, its last report's digest, and the sender's digest.
fn record(
    instance: &str,
    record: Option<&Path>,
) -> anyhow::Result<(RecorderResult, String, String)> {
    let root = testing::private_directory();
    let lock = InstanceLock::acquire(root.path(), instance)?;
    let mut launcher = Launcher::open(lock, 42, ClockMode::Lockstep)?;
    let process = |name: &str, index| RunArguments {
        launcher_pid: 0, // threads of this process, not children of a launcher
        ..launcher.arguments().for_process(name, index)
    };
    let (ours, theirs) = (process("recorder", 0), process("sender", 1));
    let result = root.path().join("recorder.json");
    let options = RecorderOptions {
        record: record.map(Path::to_owned),
        result: Some(result.clone()),
        about: about(),
        ..RecorderOptions::default()
    };
    let recorder = std::thread::spawn(move || recorder::run(&ours, &options));
    // The sender's ports stay until the recorder is done: one that is gone before a busy machine let the recorder look
    // for the first time was never there.
    let (release, held) = std::sync::mpsc::channel::<()>();
    let sender = std::thread::spawn(move || {
        let mut sender = Sender::join(&theirs)?;
        let digest = sender.run()?;
        let _ = held.recv();
        anyhow::Ok(digest)
    });
    let deadline = now_ns() + 60_000_000_000;
    launcher.wait_ready(&["recorder", "sender"], &[], deadline)?;
    launcher.start()?;
    finished(&mut launcher, "sender", deadline)?;
    launcher.stop()?;
    let report = finished(&mut launcher, "recorder", deadline)?;
    recorder.join().expect("the recorder does not panic")?;
    drop(release);
    let sent = sender.join().expect("the sender does not panic")?;
    let reported = report
        .digest
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect();
    Ok((RecorderResult::load(&result)?, reported, sent))
}

fn finished(
    launcher: &mut Launcher,
    name: &str,
    deadline: u64,
) -> anyhow::Result<messages::Report> {
    loop {
        anyhow::ensure!(
            launcher.wait(&[], Some(deadline))? == LauncherWake::Report,
            "no word from the {name}"
        );
        while let Some(report) = launcher.next_report()? {
            let is_named = report.process.starts_with(name.as_bytes());
            if is_named && report.state() == Ok(ProcessState::Finished) {
                return Ok(report);
            }
            anyhow::ensure!(
                report.state() != Ok(ProcessState::Failed),
                "a process failed"
            );
        }
    }
}

#[test]
fn every_message_of_a_run_is_recorded() -> anyhow::Result<()> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("run.mcap");
    let (result, reported, sent) = record("file", Some(&path))?;
    assert!(result.complete, "{result:?}");
    assert_eq!(result.digest, sent);
    assert_eq!(result.digest, reported);
    for topic in TOPICS.iter().filter(|topic| topic.is_repeatable()) {
        let counts = &result.topics[topic.name];
        // A world lets be sensed one or the other.
        let sent = match topic.name {
            topic::OBSERVATION | topic::PICTURE => 0,
            _ => u64::from(STEPS),
        };
        assert_eq!((counts.received, counts.written), (sent, sent));
    }
    let bytes = std::fs::read(&path)?;
    let mut scenes = 0;
    for message in mcap::MessageStream::new(&bytes)? {
        scenes += u32::from(message?.channel.topic == "/world/scene");
    }
    assert_eq!(scenes, STEPS);
    Ok(())
}

#[test]
fn the_digest_needs_no_file() -> anyhow::Result<()> {
    let (result, reported, sent) = record("none", None)?;
    assert!(result.complete, "{result:?}");
    assert_eq!(
        (result.digest.as_str(), reported.as_str()),
        (sent.as_str(), sent.as_str())
    );
    assert_eq!(result.file, None);
    assert_eq!(result.topics["world/scene"].received, u64::from(STEPS));
    assert_eq!(result.topics["world/scene"].written, 0);
    Ok(())
}

#[test]
fn a_recording_that_cannot_be_created_ends_the_process_with_the_files_name() -> anyhow::Result<()> {
    let root = testing::private_directory();
    let lock = InstanceLock::acquire(root.path(), "bad")?;
    let launcher = Launcher::open(lock, 42, ClockMode::RealTime)?;
    let ours = RunArguments {
        launcher_pid: 0,
        ..launcher.arguments().for_process("recorder", 0)
    };
    let options = RecorderOptions {
        record: Some("/nowhere/at/all.mcap".into()),
        ..RecorderOptions::default()
    };
    let error = recorder::run(&ours, &options).expect_err("no recording, no run");
    assert!(
        format!("{error:#}").contains("/nowhere/at/all.mcap"),
        "{error:#}"
    );
    Ok(())
}
