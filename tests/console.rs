//! What is printed, and what becomes of a run whose output is full or unread.

mod common;

use common::{
    Bench, Live, assert_nothing_left, instance, mirror, run, status, summary, told, until,
};
use std::fs::File;
use std::io::Read;
use std::process::{Child, Command, Output, Stdio};

/// Runs a command whose output cannot be written.
fn onto_full(command: &mut Command) -> Output {
    let full = File::options().write(true).open("/dev/full").unwrap();
    let child = command
        .stdin(Stdio::null())
        .stdout(full)
        .stderr(Stdio::piped())
        .spawn();
    child.unwrap().wait_with_output().unwrap()
}

#[test]
fn an_output_that_is_full_is_an_error_in_words() {
    let bench = Bench::new();
    let name = instance("full");
    let demos = bench.path("rounds.safetensors");
    let mut commands: Vec<Command> = [
        &["--help"][..],
        &["--version"],
        &["up", "--help"],
        &["doctor", "--clean"],
        &["demos", "--person", "1", "--rounds", "1", "--out"],
        &["up"],
    ]
    .iter()
    .map(|words| match words {
        ["up"] => {
            let mut up = bench.up(&name);
            up.args(["--episodes", "1"]);
            up
        }
        words => {
            let mut command = mirror();
            command.args(*words);
            command
        }
    })
    .collect();
    commands[4].arg(&demos);
    for command in &mut commands {
        let output = onto_full(command);
        let why = format!("{command:?}: {}", told(&output));
        assert_eq!(output.status.code(), Some(1), "{why}");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(
            said.contains("standard output: No space left on device"),
            "{why}"
        );
        assert!(!said.contains("panicked"), "{why}");
    }
    assert!(demos.exists(), "what was asked for was done all the same");
    assert_nothing_left(&name);
}

/// A run whose recorder first prints more than anybody's buffers hold.
fn floods(bench: &Bench, name: &str) -> Command {
    let script = bench.write(
        "recorder.sh",
        format!(
            "yes a line that nobody reads | head -n 50000\nexec {} process \"$1\"\n",
            env!("CARGO_BIN_EXE_mirror")
        ),
    );
    let mut command = bench.up(name);
    command
        .args(["--episodes", "1000000", "--summary"])
        .arg(bench.path("up.json"))
        .args(["--exec", &format!("recorder=sh {}", script.display())])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(File::create(bench.path("errors")).unwrap());
    command
}

/// A run that is killed with the test that started it.
struct Run(Child);

impl Run {
    fn start(command: &mut Command) -> Self {
        Self(command.spawn().unwrap())
    }

    fn signal(&self, signal: libc::c_int) {
        // SAFETY: signals our own child, which was not waited for.
        unsafe { libc::kill(self.0.id() as libc::pid_t, signal) };
    }

    /// Ends it as Ctrl-C does; its status and what it wrote to pipes.
    fn interrupt(mut self) -> Output {
        self.signal(libc::SIGINT);
        let read = |pipe: Option<Box<dyn Read + Send>>| {
            std::thread::spawn(move || {
                let mut bytes = Vec::new();
                if let Some(mut pipe) = pipe {
                    pipe.read_to_end(&mut bytes).unwrap();
                }
                bytes
            })
        };
        let out = self.0.stdout.take().map(|pipe| Box::new(pipe) as _);
        let err = self.0.stderr.take().map(|pipe| Box::new(pipe) as _);
        let (out, err) = (read(out), read(err));
        Output {
            status: self.0.wait().unwrap(),
            stdout: out.join().unwrap(),
            stderr: err.join().unwrap(),
        }
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn number(name: &str, key: &str) -> u64 {
    status(name).map_or(0, |status| status[key].as_u64().unwrap_or(0))
}

#[test]
fn an_unread_pipe_stops_no_run() {
    let bench = Bench::new();
    let name = instance("unread");
    let set = Run::start(&mut floods(&bench, &name));
    until("the set drives", || number(&name, "steps") > 100);
    let dropped = number(&name, "dropped_lines");
    assert!(dropped > 0, "more was printed than anybody keeps");
    let before = number(&name, "steps");
    until("it drives on", || number(&name, "steps") > before + 1000);
    let errors = || std::fs::read_to_string(bench.path("errors")).unwrap();
    assert!(
        errors().contains("nobody reads the standard output"),
        "{}",
        errors()
    );

    // Whoever begins to read hears what is missing, and the end.
    let output = set.interrupt();
    assert_eq!(output.status.code(), Some(1), "interrupted");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("lines are missing here"), "{}", text.len());
    assert!(text.contains("ENDED EARLY: interrupted"));
    assert!(errors().contains("lines were not printed"), "{}", errors());
    assert!(summary(&bench.path("up.json"))["dropped_lines"].as_u64() >= Some(dropped));
    assert_nothing_left(&name);
}

#[test]
fn a_run_that_was_told_to_end_does_so_though_nobody_reads() {
    let bench = Bench::new();
    let name = instance("unread-end");
    let mut set = Run::start(&mut floods(&bench, &name));
    until("the set drives", || number(&name, "steps") > 100);
    set.signal(libc::SIGTERM);
    until("it ends", || set.0.try_wait().unwrap().is_some());
    let errors = std::fs::read_to_string(bench.path("errors")).unwrap();
    assert!(errors.contains("the end was not printed"), "{errors}");
    assert_nothing_left(&name);
}

fn swap(name: &str, arguments: &[&str]) -> Output {
    let mut command = mirror();
    run(command
        .arg("swap")
        .args(arguments)
        .args(["--instance", name]))
}

#[test]
fn a_swap_says_what_it_waits_for() {
    let bench = Bench::new();
    let name = instance("swap-words");
    let mut command = bench.up(&name);
    let mut live = Live::start(command.args(["--episodes", "1000000"]), &name);
    let output = swap(&name, &["driver", "sim:3"]);
    assert!(output.status.success(), "{}", told(&output));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(
        said.contains("waits for the end of episode"),
        "{}",
        told(&output)
    );
    live.interrupt();
    live.wait();
}

/// A set that learns about the person, once it does: cloning takes it several seconds, implants may take less than a swap to ask.
fn learns(bench: &Bench, name: &str) -> Run {
    let mut command = mirror();
    command
        .args(["up", "--planner", "none", "--human", "bc"])
        .args(["--episodes", "1000000", "--instance", name, "--self-model"])
        .arg(bench.path("self.safetensors"))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    let set = Run::start(&mut command);
    let learns = |status: serde_json::Value| status["phase"] == "learning";
    until("it learns", || status(name).is_some_and(learns));
    set
}

#[test]
fn a_swap_waits_in_words_for_a_set_that_still_learns() {
    let (bench, name) = (Bench::new(), instance("swap-early"));
    let set = learns(&bench, &name);
    let output = swap(&name, &["planner", "same"]);
    assert!(output.status.success(), "{}", told(&output));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("still learns"), "{}", told(&output));
    set.interrupt();
    assert_nothing_left(&name);
}

#[test]
fn learning_can_be_interrupted() {
    let (bench, name) = (Bench::new(), instance("learn-stop"));
    let output = learns(&bench, &name).interrupt();
    assert_eq!(output.status.code(), Some(1), "{}", told(&output));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("interrupted while it learned"), "{said}");
    assert_nothing_left(&name);
}

#[test]
fn nothing_is_learned_for_a_human_model_that_is_another_program() {
    let bench = Bench::new();
    let name = instance("exec-learns");
    let mut command = mirror();
    command
        .args(["up", "--planner", "none", "--exec", "human=false"])
        .args(["--instance", &name, "--self-model"])
        .arg(bench.path("self.safetensors"));
    let output = run(&mut command);
    assert_eq!(output.status.code(), Some(1), "{}", told(&output));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!said.contains("learning"), "{said}");
    assert!(said.contains("human ended with status 1"), "{said}");
    assert_nothing_left(&name);
}

#[test]
fn a_profile_says_what_it_watched() {
    let bench = Bench::new();
    let mut command = mirror();
    command
        .args(["profile", "--planner", "none", "--human", "self"])
        .args(["--episodes", "1", "--own-cost", "0", "--driver", "sim:3"])
        .args(["--instance", &instance("profile-about"), "--self-model"])
        .arg(bench.path("self.safetensors"));
    let output = run(&mut command);
    assert!(output.status.success(), "{}", told(&output));
    let said = String::from_utf8_lossy(&output.stdout);
    let about = "scene highway-fog · driver sim:3 · human self · planner none";
    assert!(said.contains(about), "{said}");
}

#[test]
fn to_attach_to_nobody_is_refused_in_words() {
    let bench = Bench::new();
    let name = instance("attach");
    let mut live = Live::start(bench.up(&name).args(["--episodes", "1000000"]), &name);
    let output = run(mirror().args(["profile", "--attach", "nope"]));
    assert_eq!(output.status.code(), Some(2), "{}", told(&output));
    let said = String::from_utf8_lossy(&output.stderr);
    for words in ["--attach nope: there is no such instance", &name] {
        assert!(said.contains(words), "{words}: {said}");
    }
    assert!(!said.contains("launcher 0"), "{said}");
    live.interrupt();
    live.wait();
}

#[test]
fn of_no_episode_there_is_no_mean() {
    let bench = Bench::new();
    let name = instance("no-mean");
    let file = bench.path("up.json");
    let mut command = bench.up(&name);
    command
        .args(["--clock", "realtime", "--summary"])
        .arg(&file)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let set = Run::start(&mut command);
    until("it drives", || number(&name, "steps") > 0);
    let output = set.interrupt();
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("no whole episodes"), "{said}");
    assert!(!said.contains("mean reward"), "{said}");
    assert_eq!(summary(&file)["reward_mean"], serde_json::Value::Null);
}
