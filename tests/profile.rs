//! `mirror profile` against other witnesses: processes that read the clock themselves, and `/proc`.
//!
//! This test program starts itself again as two processes of the set, belief and planner, which write down when they
//! took a message and when they sent one.

mod common;
mod profile_files;

use common::{Bench, Live, assert_nothing_left, instance, mirror, run, status, told, until};
use messages::{CommAction, LidarFrame, RobotBelief, topic};
use profile_files::{Trace, check_histograms, check_trace, json};
use runtime::{Node, Receive, RunArguments, Stamp, Wake};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use testing::Stander;

testing::stand_in!(
    stand_in;
    hops_and_compute_times_agree_with_those_who_read_the_clock_themselves,
    attached_it_disturbs_nobody_and_agrees_with_proc,
    a_run_that_ends_while_watched_leaves_nothing,
    its_files_open_elsewhere_and_compare,
    plans_are_followed_into_the_human_model_and_back,
    gridworlds_are_profiled_too,
    what_cannot_be_used_is_refused,
);

const LOG: &str = "MIRROR_TEST_LOG";

/// The monotonic clock, read without any of the project's code.
fn clock_ns() -> u64 {
    let mut time = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: a live structure.
    assert_eq!(
        unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &mut time) },
        0
    );
    time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
}

/// Computes for so long.
fn compute(ns: u64) {
    let end = clock_ns() + ns;
    while clock_ns() < end {
        core::hint::spin_loop();
    }
}

/// What a process does that stands in for one of the set.
fn stand_in(role: &str, file: OsString) {
    let arguments = RunArguments::read(Path::new(&file)).unwrap();
    let mut node = Node::join(&arguments).unwrap();
    let log = match role {
        "belief" => believe(&mut node),
        "planner" => decide(&mut node),
        other => panic!("no role {other}"),
    };
    std::fs::write(std::env::var(LOG).unwrap(), log).unwrap();
    node.finish().unwrap();
}

/// Answers every frame, after some computing, with an empty belief.
fn believe(node: &mut Node) -> String {
    let mut frames = node
        .input::<LidarFrame>(topic::LIDAR, Receive::InOrder)
        .unwrap();
    let beliefs = node.output::<RobotBelief>(topic::ROBOT_BELIEF).unwrap();
    let mut log = String::new();
    if node.ready().unwrap() == Wake::Stop {
        return log;
    }
    while node.wait(&mut [&mut frames], None).unwrap() != Wake::Stop {
        let taken = clock_ns();
        frames.take().unwrap();
        let header = *frames.header().unwrap();
        compute(20_000 + u64::from(header.step % 7) * 10_000);
        let before = clock_ns();
        beliefs.send_with(Stamp::of(&header), |_| {}).unwrap();
        let after = clock_ns();
        node.end_step();
        writeln!(log, "{taken} {before} {after}").unwrap();
    }
    log
}

/// Answers every belief with an empty decision.
fn decide(node: &mut Node) -> String {
    let mut beliefs = node
        .input::<RobotBelief>(topic::ROBOT_BELIEF, Receive::InOrder)
        .unwrap();
    let decisions = node.output::<CommAction>(topic::COMM_ACTION).unwrap();
    let mut log = String::new();
    if node.ready().unwrap() == Wake::Stop {
        return log;
    }
    while node.wait(&mut [&mut beliefs], None).unwrap() != Wake::Stop {
        let taken = clock_ns();
        beliefs.take().unwrap();
        let header = *beliefs.header().unwrap();
        compute(5_000);
        let before = clock_ns();
        decisions
            .send_with(Stamp::of(&header).next(), |decision| decision.reason = 1)
            .unwrap();
        let after = clock_ns();
        node.end_step();
        writeln!(log, "{taken} {before} {after}").unwrap();
    }
    log
}

/// What a stand-in wrote down about a step.
#[derive(Clone, Copy, Debug)]
struct Witnessed {
    /// After the wait for the input had ended.
    taken: u64,
    /// Before the output was sent.
    before: u64,
    /// After it.
    after: u64,
}

impl Witnessed {
    /// The port reads the clock for what was computed and for when it was sent one after the other, and may be ousted
    /// in between.
    fn sending(&self) -> u64 {
        self.after - self.before
    }
}

fn witnessed(path: &Path) -> Vec<Witnessed> {
    let text = std::fs::read_to_string(path).unwrap();
    let line = |line: &str| {
        let mut numbers = line.split(' ').map(|word| word.parse().unwrap());
        Witnessed {
            taken: numbers.next().unwrap(),
            before: numbers.next().unwrap(),
            after: numbers.next().unwrap(),
        }
    };
    text.lines().map(line).collect()
}

/// `mirror profile` of a set of its own, without planning.
fn profile(bench: &Bench, out: &Path) -> Command {
    let mut command = mirror();
    command.args(["profile", "--human", "self", "--planner", "none"]);
    command
        .arg("--self-model")
        .arg(bench.path("self.safetensors"));
    command.arg("--out").arg(out);
    command
}

fn assert_well(output: &Output) {
    assert!(output.status.success(), "{}", told(output));
}

/// The command line that runs this test program as a process of the set.
fn stands_in(process: &str, log: &Path) -> String {
    let log = log.display().to_string();
    let program = Stander::new(process).shell(&[(LOG, &log)]);
    format!("{process}={program}")
}

fn hops_and_compute_times_agree_with_those_who_read_the_clock_themselves() {
    let bench = Bench::new();
    let out = bench.path("out");
    let logs = ["belief", "planner"].map(|process| bench.path(&format!("{process}.log")));
    let name = instance("witness");
    let output = run(profile(&bench, &out)
        .args(["--episodes", "2", "--own-cost", "0", "--instance", &name])
        .args(["--exec", &stands_in("belief", &logs[0])])
        .args(["--exec", &stands_in("planner", &logs[1])]));
    assert_well(&output);
    assert_nothing_left(&name);
    let trace = Trace::read(&out);
    let [belief, planner] = logs.map(|log| witnessed(&log));
    let checked = [
        check_compute(&trace, "belief", "computes belief/robot", &belief),
        check_compute(&trace, "planner", "computes comm/action", &planner),
    ];
    assert!(checked.iter().all(|checked| *checked > 40), "{checked:?}");

    // The hop from belief to planner: from its sending until the planner begins.
    let (mut told, mut least, mut most) = (Vec::new(), Vec::new(), Vec::new());
    let began = trace.slices("planner", "computes comm/action");
    for (sent, used) in trace.arrows("belief/robot") {
        let sender = belief
            .iter()
            .find(|step| (step.before..=step.after).contains(&sent));
        let work = began.iter().find(|slice| slice.from == used);
        let receiver = work.and_then(|work| {
            let sends = |step: &&Witnessed| (step.before..=step.after).contains(&work.to);
            planner.iter().find(sends)
        });
        let (Some(sender), Some(receiver)) = (sender, receiver) else {
            panic!("{sent} → {used} is no hop that both saw");
        };
        // Nobody can have begun later than the moment when they had it in hand.
        assert!(
            used - sent <= receiver.taken + receiver.sending() - sender.before,
            "{sent} → {used} {sender:?} {receiver:?}"
        );
        told.push((used - sent) as i64);
        // The sender may be told that it has sent only after the receiver has the message.
        least.push(receiver.taken as i64 - sender.after as i64);
        most.push(receiver.taken as i64 - sender.before as i64);
    }
    assert!(told.len() > 40, "{}", told.len());
    let median = |values: &mut Vec<i64>| {
        values.sort_unstable();
        values[values.len() / 2]
    };
    println!(
        "hop belief → planner, {} steps, medians: the profiler says {} ns, the two processes between {} and {} ns",
        told.len(),
        median(&mut told),
        median(&mut least),
        median(&mut most)
    );
}

/// Every slice is a step that the process saw too: sent between its clock readings around sending, begun no later than
/// it had its input, and no earlier than its step before ended. Returns how many there were.
fn check_compute(trace: &Trace, process: &str, name: &str, steps: &[Witnessed]) -> usize {
    let slices = trace.slices(process, name);
    for slice in &slices {
        let place = steps
            .iter()
            .position(|step| (step.before..=step.after).contains(&slice.to));
        let place = place.unwrap_or_else(|| panic!("{process}: nothing was sent at {slice:?}"));
        let step = steps[place];
        let latest = step.taken + step.sending();
        assert!(slice.from <= latest, "{process}: {slice:?} {step:?}");
        if let Some(previous) = place.checked_sub(1).map(|place| steps[place]) {
            assert!(
                slice.from >= previous.after,
                "{process}: {slice:?} {step:?}"
            );
        }
    }
    slices.len()
}

/// User and system time of a process, from `/proc`, in seconds, and how finely the kernel counts it.
fn cpu_s(pid: u32) -> (f64, f64) {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    let after_name = &stat[stat.rfind(')').unwrap() + 2..];
    let fields: Vec<&str> = after_name.split(' ').collect();
    let ticks: u64 = fields[11].parse::<u64>().unwrap() + fields[12].parse::<u64>().unwrap();
    // SAFETY: no arguments to get wrong.
    let per_second = unsafe { libc::sysconf(libc::_SC_CLK_TCK) } as f64;
    (ticks as f64 / per_second, 1.0 / per_second)
}

fn attached_it_disturbs_nobody_and_agrees_with_proc() {
    let bench = Bench::new();
    let out = bench.path("out");
    let name = instance("attach");
    let mut live = Live::start(bench.up(&name).args(["--episodes", "1000000"]), &name);
    let before: BTreeMap<String, f64> = live
        .processes
        .iter()
        .map(|(process, pid)| (process.clone(), cpu_s(*pid).0))
        .collect();
    let output = run(mirror()
        .args(["profile", "--attach", &name, "--seconds", "1.5"])
        .args(["--own-cost", "1", "--out"])
        .arg(&out));
    assert_well(&output);
    let profile = json(&out.join("profile.json"));
    assert_eq!(profile["schema"], "mirror.profile/1");
    assert_eq!(profile["measured"]["attached"], true);
    assert_eq!(profile["measured"]["clock"], "lockstep");
    assert_eq!(profile["measured"]["planner"], "none");
    for (process, pid) in &live.processes {
        let seen = &profile["processes"][process];
        assert_eq!(seen["pid"], *pid, "{process}");
        let at = |moment: usize| seen["cpu_s"][moment].as_f64().unwrap();
        let (after, tick) = cpu_s(*pid);
        // What the kernel shows is rounded down, user and system time each.
        assert!(before[process] <= at(0), "{process}: {seen}");
        assert!(at(0) <= at(1), "{process}: {seen}");
        assert!(at(1) <= after + 2.0 * tick, "{process}: {seen} {after}");
        assert!(seen["rss_kib"].as_u64().unwrap() > 0, "{process}: {seen}");
    }
    // It saw the run from the inside, and whole; the processes answered when asked.
    let counts = &profile["counts"];
    assert!(counts["steps"].as_u64().unwrap() > 20, "{counts}");
    for process in ["world", "driver", "belief", "human", "planner", "renderer"] {
        let reported = &profile["processes"][process]["reported"];
        assert!(
            reported["steps"].as_u64().unwrap() > 20,
            "{process}: {reported}"
        );
        let metric = &profile["metrics"][format!("compute {process}")];
        for (low, high) in [
            ("p50", "p90"),
            ("p90", "p99"),
            ("p99", "p999"),
            ("p999", "max"),
        ] {
            assert!(metric[low].as_u64() <= metric[high].as_u64(), "{metric}");
        }
    }
    assert!(profile["own"]["cpu_s"].as_f64().unwrap() > 0.0);
    assert!(profile["own"]["slowdown"]["turns"].as_u64().unwrap() >= 6);
    // The set drives on, loses nothing, and ends as always.
    live.signal("launcher", libc::SIGTERM);
    assert_eq!(live.wait().code(), Some(1));
    assert_nothing_left(&name);
}

fn a_run_that_ends_while_watched_leaves_nothing() {
    let bench = Bench::new();
    let name = instance("ends");
    let out = bench.path("out");
    let live = Live::start(bench.up(&name).args(["--episodes", "1000000"]), &name);
    let child = mirror()
        .args(["profile", "--attach", &name, "--seconds", "600", "--out"])
        .arg(&out)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // Once it reads what every process of the set sends, it has a part in the run; then it sees some of it.
    let ours = runtime::instance::prefix(&runtime::instance::root_for(&name), &name);
    until("it watches", || {
        let maps = std::fs::read_to_string(format!("/proc/{}/maps", child.id())).unwrap();
        let sent = |line: &&str| line.contains(&ours) && line.ends_with(".data");
        let files = maps.lines().filter(sent);
        let files = files.filter_map(|line| line.split_whitespace().last());
        files.collect::<BTreeSet<_>>().len() >= live.processes.len() - 1
    });
    let steps = || status(&name).unwrap()["steps"].as_u64().unwrap();
    let before = steps();
    until("the run goes on", || steps() > before + 200);
    live.signal("launcher", libc::SIGTERM);
    let output = child.wait_with_output().unwrap();
    assert_well(&output);
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("until the run ended"), "{said}");
    let counts = &json(&out.join("profile.json"))["counts"];
    assert!(counts["steps"].as_u64().unwrap() > 0, "{counts}");
    drop(live);
    assert_nothing_left(&name);
}

fn its_files_open_elsewhere_and_compare() {
    let bench = Bench::new();
    let out = bench.path("out");
    let picture = bench.path("step.svg");
    let output = run(profile(&bench, &out)
        .args(["--episodes", "20", "--own-cost", "0", "--picture"])
        .arg(&picture));
    assert_well(&output);
    let text = std::fs::read_to_string(&picture).unwrap();
    roxmltree::Document::parse(&text).unwrap();
    let profile_json = out.join("profile.json");
    let profile = json(&profile_json);
    check_histograms(&out, &profile);
    check_trace(&Trace::read(&out));
    for which in ["typical", "slowest"] {
        let trace = &profile[which];
        let path = trace["path"].as_array().unwrap();
        let mut at = 0;
        for span in path {
            assert_eq!(span["from_ns"], at, "{which}: a gap in {path:?}");
            at = span["to_ns"].as_i64().unwrap();
        }
        assert_eq!(trace["latency_ns"], at, "{which}");
    }
    assert_eq!(
        profile["slowest"]["latency_ns"],
        profile["metrics"]["tick"]["max"]
    );
    assert_eq!(profile["counts"]["missed_deadlines"], 0);

    // The same figures, ten times as long, were slower by a factor of ten.
    let mut slow = profile.clone();
    for (_, metric) in slow["metrics"].as_object_mut().unwrap() {
        for (_, value) in metric.as_object_mut().unwrap().iter_mut() {
            match value {
                Value::Array(values) => {
                    for value in values {
                        *value = (value.as_u64().unwrap() * 10).into();
                    }
                }
                Value::Number(number) if number.is_u64() => {
                    *value = (number.as_u64().unwrap() * 10).into()
                }
                _ => {}
            }
        }
    }
    let older = bench.write("older.json", slow.to_string());
    let now = bench.path("now");
    let output = run(self::profile(&bench, &now)
        .args(["--episodes", "20", "--own-cost", "0", "--against"])
        .arg(&older));
    assert_well(&output);
    let changes = json(&now.join("changes.json"));
    let compute = changes
        .as_array()
        .unwrap()
        .iter()
        .find(|change| change["figure"] == "compute world p50")
        .unwrap()
        .clone();
    assert_eq!(compute["verdict"], "faster", "{compute}");
}

/// A scene in which planning takes moments, and an episode ends soon.
const QUICK: &str = "name = \"quick\"
[planning]
race_steps = 6
race_first = 4
race_futures = 16
horizon = 2
samples = 24
futures = 1
elites = 6
iterations = 2
[episode]
max_steps = 40
";

fn plans_are_followed_into_the_human_model_and_back() {
    let bench = Bench::new();
    let scene = bench.write("quick.toml", QUICK);
    for clock in ["lockstep", "realtime"] {
        let out = bench.path(clock);
        let output = run(mirror()
            .args([
                "profile",
                "--human",
                "self",
                "--clock",
                clock,
                "--episodes",
                "1",
            ])
            .args(["--own-cost", "0", "--self-model"])
            .arg(bench.path("self.safetensors"))
            .arg("--scene")
            .arg(&scene)
            .arg("--out")
            .arg(&out));
        assert_well(&output);
        let profile = json(&out.join("profile.json"));
        assert_eq!(profile["measured"]["clock"], clock);
        assert_eq!(profile["measured"]["planner"], "race");
        assert!(profile["counts"]["futures_per_plan"].as_f64().unwrap() > 0.0);
        let metric = |name: &str| profile["metrics"][name].clone();
        let plans = metric("compute planner")["count"].as_u64().unwrap();
        assert!(plans > 5, "{clock}: {plans} plans");
        assert_eq!(metric("planner awaits answers")["count"], plans, "{clock}");
        assert!(metric("compute human answers")["count"].as_u64().unwrap() > 5);
        // The planner cannot wait for longer than from its input to its output.
        let awaited = metric("planner awaits answers")["max"].as_u64().unwrap();
        assert!(awaited <= metric("sensing to decision")["max"].as_u64().unwrap());
        check_trace(&Trace::read(&out));
    }
}

/// Where the world sends observations in place of frames, and a plan asks for choices.
fn gridworlds_are_profiled_too() {
    let bench = Bench::new();
    let out = bench.path("out");
    let scene = bench.write(
        "quick.toml",
        "name = \"quick\"\ndomain = \"driving\"\nsetting = \"transfer\"\n[planning]\nhorizon = 2\nsamples = 60\n\
         elites = 12\niterations = 2\nrace_steps = 4\nrace_first = 4\nrace_futures = 16\n",
    );
    let output = run(mirror()
        .args(["profile", "--human", "ideal", "--episodes", "3"])
        .args(["--own-cost", "0.5", "--scene"])
        .arg(&scene)
        .arg("--out")
        .arg(&out));
    assert_well(&output);
    let profile = json(&out.join("profile.json"));
    let counts = &profile["counts"];
    assert!(counts["steps"].as_u64().unwrap() > 20, "{counts}");
    // Watching begins and ends within a step.
    assert!(
        counts["incomplete_steps"].as_u64().unwrap() <= 2,
        "{counts}"
    );
    let metrics = profile["metrics"].as_object().unwrap();
    for name in [
        "tick",
        "compute world",
        "wait world/observation → belief",
        "hop world/observation → belief",
        "sensing to display",
        "planner awaits answers",
    ] {
        let count = metrics[name]["count"].as_u64().unwrap();
        assert!(count > 15, "{name}: {count}");
    }
    let frames = metrics.keys().find(|name| name.contains("world/lidar"));
    assert_eq!(frames, None);
    check_trace(&Trace::read(&out));
}

fn refused(arguments: &[&str], words: &[&str]) {
    let output = run(mirror().arg("profile").args(arguments));
    assert_eq!(
        output.status.code(),
        Some(2),
        "{arguments:?}: {}",
        told(&output)
    );
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    for word in words {
        assert!(
            error.contains(word),
            "{arguments:?}: no {word:?} in {error}"
        );
    }
    assert!(!error.contains("panicked"), "{arguments:?}: {error}");
}

fn what_cannot_be_used_is_refused() {
    let bench = Bench::new();
    let path = |path: &PathBuf| path.to_str().unwrap().to_owned();
    refused(&["--attach", "nobody-runs-this"], &["nobody-runs-this"]);
    refused(&["--attach", "a/b"], &["a/b"]);
    refused(&["--attach", "x", "--scene", "highway-fog"], &["--attach"]);
    refused(&["--scene", "the-moon"], &["the-moon"]);
    refused(&["--seconds", "0"], &["--seconds"]);
    refused(&["--own-cost", "-1"], &["--own-cost"]);
    let missing = path(&bench.path("missing.json"));
    refused(&["--against", &missing], &["missing.json"]);
    let garbage = path(&bench.write("garbage.json", [0xff, 0, 7]));
    refused(&["--against", &garbage], &["garbage.json"]);
    let other = path(&bench.write("other.json", "{\"schema\": \"mirror.profile/9\"}"));
    refused(
        &["--against", &other],
        &["other.json", "mirror.profile/9", "mirror.profile/1"],
    );
    let hollow = path(&bench.write("hollow.json", "{\"schema\": \"mirror.profile/1\"}"));
    refused(&["--against", &hollow], &["hollow.json", "measured"]);
    let file = path(&bench.write("file", "no folder"));
    refused(&["--out", &file], &["file"]);
    refused(&["--out", &format!("{file}/below")], &["below"]);
    refused(&["--picture", "/nowhere/step.svg"], &["/nowhere/step.svg"]);
}
