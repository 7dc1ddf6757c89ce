//! What the whole-system tests share: starting `mirror`, an untrained self-model, and looking for what a run left.
#![allow(dead_code)] // Each test program uses its own part.

pub mod others;

use domains::highway::modalities::layout;
use models::{Kind, PersonalPolicy, Posterior, RecurrentPolicy, RecurrentSizes, SelfModel, Sizes};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use runtime::instance::{nodes, prefix, root_for};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, ExitStatus, Output, Stdio};
use std::time::{Duration, Instant};

/// The program under test.
pub fn mirror() -> Command {
    Command::new(env!("CARGO_BIN_EXE_mirror"))
}

/// Nothing here takes as long: what does, hangs.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Waits until something holds.
pub fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let since = Instant::now();
    while !holds() {
        assert!(since.elapsed() < PATIENCE, "{what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// A process's state letter; none if there is none.
pub fn state(pid: u32) -> Option<char> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    stat.rsplit_once(") ")?.1.chars().next()
}

/// A scene file: the highway in fog, with plans of so many imagined futures, which take moments, and what `more` says.
pub fn quick_scene(samples: u32, more: &str) -> String {
    format!(
        "name = \"quick\"\n[fog]\nfront_m = 13.0\nside_m = 8.0\nrear_m = 3.0\n[planning]\nhorizon = 2\n\
         race_steps = 6\nrace_first = 4\nrace_futures = 16\n\
         samples = {samples}\nfutures = 1\nelites = {}\niterations = 2\n{more}",
        samples / 4
    )
}

/// A directory with a self-model in it that never learned anything: what these tests ask does not depend on that.
pub struct Bench {
    pub directory: tempfile::TempDir,
}

impl Bench {
    pub fn new() -> Self {
        let directory = tempfile::tempdir().unwrap();
        let model = SelfModel::new(
            Sizes::of(&layout()),
            layout(),
            &mut ChaCha8Rng::seed_from_u64(1),
        );
        let file = directory.path().join("self.safetensors");
        model.save(&file, "tests").unwrap();
        Self { directory }
    }

    /// Implants that learned nothing either.
    pub fn write_implants(&self) {
        let model = SelfModel::load(&self.path("self.safetensors"), layout()).unwrap();
        let implants = Posterior::neutral(&model, true);
        let path = self.path("implants.safetensors");
        implants.save(&path, &model, 0, "tests").unwrap();
    }

    /// A policy for human model `bc` that learned nothing either.
    pub fn write_policy(&self) -> String {
        let layout = layout();
        let rng = &mut ChaCha8Rng::seed_from_u64(3);
        let person = PersonalPolicy {
            policy: RecurrentPolicy::new(RecurrentSizes::of(&layout, 3), &layout, rng),
            limits: vec![10.0; layout.perception.limits()],
            heard: 0,
        };
        let path = self.path("policy.safetensors");
        person.save(&path, Kind::Bc, &layout, "tests", &[]).unwrap();
        path.display().to_string()
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }

    /// `mirror up` with a planner in this scene, and with implants that learned nothing, in an instance of its own.
    pub fn planned(&self, instance: &str, scene: &str) -> Command {
        self.write_implants();
        let mut command = mirror();
        command
            .args(["up", "--human", "mirror"])
            .args(["--instance", instance, "--self-model"])
            .arg(self.path("self.safetensors"))
            .arg("--implants")
            .arg(self.path("implants.safetensors"))
            .arg("--scene")
            .arg(self.write("scene.toml", scene));
        command
    }

    /// `mirror up` without planning, in an instance of its own.
    pub fn up(&self, instance: &str) -> Command {
        let mut command = mirror();
        command.args([
            "up",
            "--human",
            "self",
            "--planner",
            "none",
            "--instance",
            instance,
            "--self-model",
        ]);
        command.arg(self.path("self.safetensors"));
        command
    }
}

/// A name that no other test uses.
pub fn instance(test: &str) -> String {
    format!("t-{test}-{}", std::process::id())
}

/// Runs a command to its end; its summary must have been asked for as `summary`.
pub fn run(command: &mut Command) -> Output {
    command.stdin(Stdio::null()).output().unwrap()
}

/// Status, standard output and standard error, for messages of failed assertions.
pub fn told(output: &Output) -> String {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    format!(
        "{}\n--- stdout\n{}\n--- stderr\n{}",
        output.status,
        text(&output.stdout),
        text(&output.stderr)
    )
}

/// A summary's JSON.
pub fn summary(path: &Path) -> serde_json::Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

/// What a running set says of itself; none if it is not there, or ends before it answers.
pub fn status(instance: &str) -> Option<serde_json::Value> {
    status_in(&root_for(instance), instance)
}

/// As [`status`], of a set whose instances are below `root`.
pub fn status_in(root: &Path, instance: &str) -> Option<serde_json::Value> {
    let socket = runtime::instance::directory(root, instance).join("launcher.sock");
    let mut stream = std::os::unix::net::UnixStream::connect(socket).ok()?;
    stream.write_all(b"{\"command\":\"status\"}\n").ok()?;
    let mut line = String::new();
    BufReader::new(stream).read_line(&mut line).ok()?;
    let answer: serde_json::Value = serde_json::from_str(&line).ok()?;
    Some(answer["done"].clone())
}

/// `mirror swap` to its end: what it printed, and its report, if it wrote one.
pub fn swap(instance: &str, bench: &Bench, arguments: &[&str]) -> (Output, serde_json::Value) {
    let report = bench.path("report.json");
    let _ = std::fs::remove_file(&report);
    let mut command = mirror();
    command
        .arg("swap")
        .args(arguments)
        .args(["--instance", instance, "--report"])
        .arg(&report);
    let output = run(&mut command);
    let report = std::fs::read_to_string(&report).map_or(serde_json::Value::Null, |text| {
        serde_json::from_str(&text).unwrap()
    });
    (output, report)
}

/// Asserts that a run lost no message of any topic.
pub fn assert_no_message_lost(summary: &serde_json::Value) {
    for (topic, lost) in summary["lost_messages"].as_object().unwrap() {
        assert_eq!(lost, 0, "{topic}");
    }
}

/// Asserts that one process died, once, and that another took its place to the run's end.
pub fn assert_replaced(summary: &serde_json::Value, process: &str) {
    let deaths = summary["deaths"].as_array().unwrap();
    assert_eq!(deaths.len(), 1, "{deaths:?}");
    assert_eq!(deaths[0]["process"], process);
    assert_eq!(summary["restarts"], 1);
    assert_eq!(summary["completed"], true);
}

/// A `mirror up` that goes on until it is ended.
pub struct Live {
    pub child: Child,
    lines: BufReader<ChildStdout>,
    instance: String,
    /// Process name and id, the launcher's included.
    pub processes: Vec<(String, u32)>,
}

impl Live {
    /// Starts it, and returns once the first episode has begun.
    pub fn start(command: &mut Command, instance: &str) -> Self {
        let mut live = Self::spawn(command.stderr(Stdio::inherit()), instance);
        live.wait_for_line("START");
        live.find_processes();
        assert_eq!(
            live.processes.len(),
            8,
            "seven processes and the launcher: {:?}",
            live.processes
        );
        live
    }

    /// Starts one that prints nothing, and returns once its first step was taken.
    pub fn start_quietly(command: &mut Command, instance: &str) -> Self {
        let mut live = Self::spawn(command.stderr(Stdio::null()), instance);
        let runs = |status: serde_json::Value| status["steps"].as_u64() > Some(0);
        while !status(instance).is_some_and(runs) {
            std::thread::yield_now();
        }
        live.find_processes();
        live
    }

    fn spawn(command: &mut Command, instance: &str) -> Self {
        let command = command.stdin(Stdio::null()).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap());
        Self {
            child,
            lines,
            instance: instance.to_owned(),
            processes: Vec::new(),
        }
    }

    fn find_processes(&mut self) {
        let found = nodes(&root_for(&self.instance), &self.instance).unwrap();
        let found = found.into_iter().map(|node| (node.process, node.pid));
        self.processes = found.collect();
    }

    /// Ends the run as Ctrl-C does.
    pub fn interrupt(&self) {
        // SAFETY: signals our own child, which was not waited for.
        unsafe { libc::kill(self.child.id() as libc::pid_t, libc::SIGINT) };
    }

    /// Reads on until a line contains `word`.
    pub fn wait_for_line(&mut self, word: &str) {
        let mut line = String::new();
        while self.lines.read_line(&mut line).unwrap() > 0 {
            if line.contains(word) {
                return;
            }
            line.clear();
        }
        panic!("{}: ended without a line with {word:?}", self.instance);
    }

    pub fn pid(&self, process: &str) -> u32 {
        self.processes
            .iter()
            .find(|(name, _)| name == process)
            .unwrap()
            .1
    }

    /// Sends a signal to one of its processes.
    pub fn signal(&self, process: &str, signal: libc::c_int) {
        // SAFETY: signals a process that this test started.
        assert_eq!(
            unsafe { libc::kill(self.pid(process) as libc::pid_t, signal) },
            0
        );
    }

    /// Waits for the launcher's end, reading what it prints.
    pub fn wait(&mut self) -> ExitStatus {
        std::io::copy(&mut self.lines, &mut std::io::sink()).unwrap();
        self.child.wait().unwrap()
    }

    /// As [`Live::wait`], with what it still printed.
    pub fn wait_for_text(&mut self) -> (ExitStatus, String) {
        let mut text = String::new();
        std::io::Read::read_to_string(&mut self.lines, &mut text).unwrap();
        (self.child.wait().unwrap(), text)
    }

    /// Waits for the end of every process but the launcher, which are not our children; at most five seconds.
    pub fn wait_for_processes(&self) {
        for (name, pid) in self
            .processes
            .iter()
            .filter(|(_, pid)| *pid != self.child.id())
        {
            let Ok(descriptor) = runtime::process_descriptor(*pid) else {
                continue;
            };
            let mut poll = libc::pollfd {
                fd: std::os::fd::AsRawFd::as_raw_fd(&descriptor),
                events: libc::POLLIN,
                revents: 0,
            };
            // SAFETY: a live array of one.
            assert_eq!(
                unsafe { libc::poll(&mut poll, 1, 5_000) },
                1,
                "{name} ({pid}) lives on"
            );
        }
    }

    /// Asserts that none of its processes lives.
    pub fn assert_all_ended(&self) {
        for (name, pid) in &self.processes {
            // SAFETY: signal 0 only asks.
            let gone = unsafe { libc::kill(*pid as libc::pid_t, 0) } != 0;
            assert!(gone, "{}: {name} ({pid}) lives on", self.instance);
        }
    }
}

/// A test that fails must not leave a process set behind.
impl Drop for Live {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Asserts that an instance left no node, no file and no shared memory.
pub fn assert_nothing_left(instance: &str) {
    let root = root_for(instance);
    assert!(nodes(&root, instance).unwrap().is_empty());
    assert!(!root.join(instance).exists());
    let prefix = prefix(&root, instance);
    let left: Vec<_> = std::fs::read_dir("/dev/shm")
        .unwrap()
        .flatten()
        .map(|entry| entry.file_name())
        .collect();
    let left: Vec<_> = left
        .iter()
        .filter(|name| name.to_string_lossy().starts_with(&prefix))
        .collect();
    assert!(left.is_empty(), "{left:?}");
}
