//! Signals to a running set: SIGHUP ends it in order, Ctrl-Z suspends all of it, and other people's programs end with it,
//! and so does what they start, whoever dies first.

mod common;

use common::{Bench, Live, assert_nothing_left, instance, state, status, summary, until};
use std::os::unix::process::CommandExt;
use std::process::Command;
use std::time::Duration;

fn steps(name: &str) -> u64 {
    status(name).map_or(0, |status| status["steps"].as_u64().unwrap_or(0))
}

fn goes_on(name: &str, more: u64) {
    let before = steps(name);
    until("the run goes on", || steps(name) >= before + more);
}

fn send(pid: u32, signal: libc::c_int) {
    // SAFETY: signals a process that this test started.
    assert_eq!(unsafe { libc::kill(pid as libc::pid_t, signal) }, 0);
}

/// Starts an endless run in a process group of its own, as a shell does, so that it can be suspended.
fn start(bench: &Bench, name: &str, options: &[&str]) -> Live {
    let mut command = bench.up(name);
    command
        .args(["--episodes", "1000000", "--summary"])
        .arg(bench.path("up.json"))
        .args(options)
        .process_group(0);
    on_hangup(&mut command, libc::SIG_DFL);
    Live::start(&mut command, name)
}

/// What the command finds in place for SIGHUP, whatever these tests were started with.
fn on_hangup(command: &mut Command, handler: libc::sighandler_t) {
    // SAFETY: only calls what may be called between fork and exec.
    unsafe {
        command.pre_exec(move || {
            libc::signal(libc::SIGHUP, handler);
            Ok(())
        });
    }
}

#[test]
fn a_closed_terminal_ends_the_set_in_order() {
    let bench = Bench::new();
    let name = instance("hangup");
    let mut live = start(&bench, &name, &[]);
    send(live.child.id(), libc::SIGHUP);
    assert_eq!(live.wait().code(), Some(1), "interrupted");
    live.assert_all_ended();
    assert_nothing_left(&name);
    assert_eq!(
        summary(&bench.path("up.json"))["ended_early"],
        "interrupted"
    );
}

#[test]
fn under_nohup_it_goes_on() {
    let bench = Bench::new();
    let name = instance("nohup");
    let mut command = bench.up(&name);
    command.args(["--episodes", "1000000"]).process_group(0);
    on_hangup(&mut command, libc::SIG_IGN);
    let mut live = Live::start(&mut command, &name);
    send(live.child.id(), libc::SIGHUP);
    goes_on(&name, 100);
    live.interrupt();
    assert_eq!(live.wait().code(), Some(1));
    assert_nothing_left(&name);
}

fn are_stopped(live: &Live) -> bool {
    let pids = live.processes.iter().map(|(_, pid)| *pid);
    pids.map(state).all(|state| state == Some('T'))
}

#[test]
fn ctrl_z_suspends_the_whole_set_and_nobody_notices_the_pause() {
    const PAUSE: Duration = Duration::from_secs(4);
    for clock in ["realtime", "lockstep"] {
        let bench = Bench::new();
        let name = instance(&format!("suspend-{clock}"));
        let mut live = start(&bench, &name, &["--clock", clock]);
        goes_on(&name, 5);
        send(live.child.id(), libc::SIGTSTP);
        until("everybody is stopped", || are_stopped(&live));
        // The pause itself: longer than a process may be silent.
        std::thread::sleep(PAUSE);
        assert!(are_stopped(&live));
        send(live.child.id(), libc::SIGCONT);
        goes_on(&name, 5);
        live.interrupt();
        assert_eq!(live.wait().code(), Some(1), "interrupted");
        live.assert_all_ended();
        assert_nothing_left(&name);
        let summary = summary(&bench.path("up.json"));
        assert_eq!(summary["hangs"], 0, "{clock}");
        assert_eq!(summary["deaths"], serde_json::json!([]), "{clock}");
        // A step of real time lasts 150 ms: the world would have missed as many as the pause has room for.
        let missed = summary["processes"]["world"]["missed_deadlines"].as_f64();
        let missed_s = missed.unwrap() * 0.15;
        assert!(
            missed_s + 0.3 < PAUSE.as_secs_f64(),
            "{clock}: {missed_s} s"
        );
        let longest_us = &summary["latency_us"]["sensing_to_display"]["max"];
        assert!(
            longest_us.as_f64().unwrap() < PAUSE.as_micros() as f64,
            "{clock}: no latency contains the pause: {longest_us}"
        );
    }
}

#[test]
fn a_suspended_set_ends_with_its_launcher() {
    let bench = Bench::new();
    let name = instance("suspend-kill");
    let mut live = start(&bench, &name, &[]);
    send(live.child.id(), libc::SIGTSTP);
    until("everybody is stopped", || are_stopped(&live));
    send(live.child.id(), libc::SIGKILL);
    live.wait();
    live.wait_for_processes();
    clean_up(&name);
}

/// Removes what a killed launcher left, as the next run of that name would.
fn clean_up(name: &str) {
    runtime::cleanup_dead(&runtime::instance::root_for(name), name).unwrap();
    assert_nothing_left(name);
}

/// Processes with this text in their command lines.
fn with(text: &str) -> Vec<u32> {
    let own = std::process::id();
    let processes = std::fs::read_dir("/proc").unwrap().flatten();
    processes
        .filter_map(|entry| entry.file_name().to_str()?.parse().ok())
        .filter(|pid| *pid != own && !matches!(state(*pid), None | Some('Z')))
        .filter(|pid| {
            let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            String::from_utf8_lossy(&line).contains(text)
        })
        .collect()
}

/// A run whose human model is a program that has started two others, one of them in a session of its own; and a text that
/// is in the command lines of these two alone.
fn with_children(bench: &Bench, name: &str) -> (Live, String) {
    let mark = format!("1{:07}", std::process::id());
    let sleep = format!("sleep {mark}{}", name.len());
    let script = bench.write(
        "human.sh",
        format!(
            "{sleep}.1 & setsid {sleep}.2 &\nexec {} process \"$1\"\n",
            env!("CARGO_BIN_EXE_mirror")
        ),
    );
    let exec = format!("human=sh {}", script.display());
    let live = start(bench, name, &["--exec", &exec]);
    let mark = sleep.replace(' ', "\0");
    until("both were started", || with(&mark).len() == 2);
    (live, mark)
}

/// The guard of the program: its parent.
fn parent(pid: u32) -> u32 {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    let rest = stat.rsplit_once(") ").unwrap().1;
    rest.split(' ').nth(1).unwrap().parse().unwrap()
}

#[test]
fn what_a_program_started_ends_with_the_run() {
    let bench = Bench::new();
    let name = instance("exec-end");
    let (mut live, mark) = with_children(&bench, &name);
    live.interrupt();
    assert_eq!(live.wait().code(), Some(1));
    assert_eq!(with(&mark), [0; 0], "when the launcher ends, they have");
    assert_nothing_left(&name);
}

#[test]
fn what_a_program_started_ends_with_the_program_and_with_its_guard() {
    let bench = Bench::new();
    for whom in ["program", "guard"] {
        let name = instance(&format!("exec-{whom}"));
        let (mut live, mark) = with_children(&bench, &name);
        let (program, before) = (live.pid("human"), with(&mark));
        let killed = match whom {
            "program" => program,
            _ => parent(program),
        };
        assert_ne!(killed, live.child.id());
        send(killed, libc::SIGKILL);
        until("another takes its place", || {
            let now = with(&mark);
            now.len() == 2 && now.iter().all(|pid| !before.contains(pid))
        });
        goes_on(&name, 100);
        live.interrupt();
        assert_eq!(live.wait().code(), Some(1));
        assert_eq!(with(&mark), [0; 0]);
        assert_nothing_left(&name);
        let summary = summary(&bench.path("up.json"));
        assert_eq!(summary["deaths"].as_array().unwrap().len(), 1, "{whom}");
        let how = summary["deaths"][0]["how"].as_str().unwrap();
        assert!(how.contains("signal 9"), "{how}");
    }
}

#[test]
fn what_a_program_started_ends_with_the_launcher() {
    let bench = Bench::new();
    let name = instance("exec-launcher");
    let (mut live, mark) = with_children(&bench, &name);
    send(live.child.id(), libc::SIGKILL);
    live.wait();
    live.wait_for_processes();
    until("they end, too", || with(&mark).is_empty());
    clean_up(&name);
}

/// A process that is killed with the test that started it.
struct Ends(u32);

impl Drop for Ends {
    fn drop(&mut self) {
        // SAFETY: a plain system call.
        unsafe { libc::kill(self.0 as libc::pid_t, libc::SIGKILL) };
    }
}

/// The terminal's own Ctrl-Z, where there is one: a shell with job control suspends the set and brings it back.
#[test]
fn a_shell_suspends_it_and_brings_it_back() {
    let bench = Bench::new();
    let name = instance("suspend-shell");
    let mut up = bench.up(&name);
    up.args(["--episodes", "1000000", "--quiet"]);
    let words = std::iter::once(up.get_program()).chain(up.get_args());
    let words: Vec<_> = words.map(|word| word.to_string_lossy()).collect();
    let script = format!(
        "set -m\n{} >/dev/null & job=$!\necho $job\nread go\nkill -TSTP $job\nread go\nfg >/dev/null\n",
        words.join(" ")
    );
    let mut shell = Command::new("bash");
    shell
        .arg("-c")
        .arg(script)
        .stdin(std::process::Stdio::piped())
        .stdout(std::process::Stdio::piped());
    let mut shell = shell.spawn().unwrap();
    let mut lines = std::io::BufReader::new(shell.stdout.take().unwrap());
    let mut job = String::new();
    std::io::BufRead::read_line(&mut lines, &mut job).unwrap();
    let job: u32 = job.trim().parse().unwrap();
    let _ends = Ends(job);
    goes_on(&name, 10);
    let mut go = shell.stdin.take().unwrap();
    std::io::Write::write_all(&mut go, b"\n").unwrap();
    until("it is stopped", || state(job) == Some('T'));
    std::io::Write::write_all(&mut go, b"\n").unwrap();
    goes_on(&name, 10);
    send(job, libc::SIGINT);
    shell.wait().unwrap();
    assert_nothing_left(&name);
}
