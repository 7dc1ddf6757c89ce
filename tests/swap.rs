//! Replacing processes of a running set: no step without its answer, no message lost, and what was decided before stays
//! as it would have been.

mod common;

use common::{
    Bench, Live, assert_no_message_lost, assert_nothing_left, instance, run, status, summary, swap,
    told,
};
use messages::{CommAction, Header, LidarFrame, Message, RobotBelief, topic};
use recorder::topics::Recorded;
use runtime::{Node, Receive, RunArguments, Stamp, Wake};
use serde_json::Value;
use std::ffi::OsString;
use std::path::Path;
use std::process::Output;
use testing::Stander;

testing::stand_in!(
    stand_in;
    the_old_one_may_die_before_the_border,
    both_may_die,
    human_models_change_places_in_lockstep,
    human_models_change_places_in_real_time,
    every_other_process_changes_places_too,
    what_cannot_take_over_changes_nothing,
    decisions_before_a_swap_are_those_of_a_run_without_it,
);

const MARK: &str = "MIRROR_TEST_MARK";

/// What a process does that stands in for one of the set.
fn stand_in(role: &str, file: OsString) {
    let mut node = Node::join(&RunArguments::read(Path::new(&file)).unwrap()).unwrap();
    match role {
        "belief" => believe(&mut node),
        "planner" => decide(&mut node),
        other => panic!("no role {other}"),
    }
    node.finish().unwrap();
}

/// Computes an empty belief for every frame. As long as it stands by it never says that it has caught up; what it would say is
/// held back.
fn believe(node: &mut Node) {
    let mut frames = node
        .input::<LidarFrame>(topic::LIDAR, Receive::InOrder)
        .unwrap();
    let beliefs = node.output::<RobotBelief>(topic::ROBOT_BELIEF).unwrap();
    if node.ready().unwrap() == Wake::Stop {
        return;
    }
    while node.wait(&mut [&mut frames], None).unwrap() != Wake::Stop {
        frames.take().unwrap();
        let stamp = Stamp::of(frames.header().unwrap());
        beliefs.send_with(stamp, |_| {}).unwrap();
        if node.is_active(stamp.episode, stamp.step) {
            node.end_step();
        }
    }
}

/// Decides nothing, as soon as it is its turn. As long as it stands by it never says that it has caught up. The first of its kind
/// has passed over every step there is.
fn decide(node: &mut Node) {
    let mut beliefs = node
        .input::<RobotBelief>(topic::ROBOT_BELIEF, Receive::InOrder)
        .unwrap();
    let decisions = node.output::<CommAction>(topic::COMM_ACTION).unwrap();
    let mark = std::env::var(MARK).unwrap();
    if !Path::new(&mark).exists() {
        std::fs::write(&mark, "").unwrap();
        node.pass(u32::MAX - 1, 0);
    }
    if node.ready().unwrap() == Wake::Stop {
        return;
    }
    while node.wait(&mut [&mut beliefs], None).unwrap() != Wake::Stop {
        beliefs.take().unwrap();
        let stamp = Stamp::of(beliefs.header().unwrap()).next();
        if node.is_active(stamp.episode, stamp.step) {
            decisions
                .send_with(stamp, |decision| decision.reason = 1)
                .unwrap();
            node.end_step();
        }
    }
}

/// Living processes of a kind, as (number, phase).
fn living(name: &str, process: &str) -> Vec<(u64, String)> {
    let status = status(name).unwrap();
    let all = status["processes"].as_array().unwrap().iter();
    all.filter(|child| child["process"] == process)
        .map(|child| {
            let phase = child["phase"].as_str().unwrap().to_owned();
            (child["index"].as_u64().unwrap(), phase)
        })
        .collect()
}

/// Waits until that many steps more are done.
fn goes_on(name: &str, steps: u64) {
    let done = || status(name).unwrap()["steps"].as_u64().unwrap();
    let before = done();
    while done() < before + steps {
        std::thread::yield_now();
    }
}

/// Begins to replace `process` by a stand-in that never catches up, and waits until it stands by; its number comes with it.
fn begins_to_swap(name: &str, process: &str) -> (std::thread::JoinHandle<(Output, Value)>, u64) {
    let (instance, asked) = (name.to_owned(), process.to_owned());
    let swap = std::thread::spawn(move || {
        let bench = Bench::new();
        let mark = bench.path("mark").display().to_string();
        let command = Stander::new(&asked).shell(&[(MARK, &mark)]);
        swap(&instance, &bench, &[&asked, "--exec", &command])
    });
    loop {
        let found = living(name, process);
        if let Some((number, _)) = found.iter().find(|(_, phase)| phase == "StandingBy") {
            return (swap, *number);
        }
        std::thread::yield_now();
    }
}

/// The old process may die before the border: the new one goes on where it stopped, and who cannot, having passed over what is
/// owed, is started once more.
fn the_old_one_may_die_before_the_border() {
    for clock in ["lockstep", "realtime"] {
        let bench = Bench::new();
        let name = instance(&format!("swap-dies-{clock}"));
        let file = bench.path("up.json");
        let mut command = bench.up(&name);
        command
            .args(["--episodes", "1000000", "--clock", clock])
            .arg("--summary")
            .arg(&file);
        let live = Live::start(&mut command, &name);
        for (process, starts_once_more) in [("belief", false), ("planner", true)] {
            let (swap, stood_by) = begins_to_swap(&name, process);
            live.signal(process, libc::SIGKILL);
            let (output, report) = swap.join().unwrap();
            assert!(output.status.success(), "{clock}: {}", told(&output));
            assert_eq!(report["old_died"], true, "{report}");
            if clock == "lockstep" {
                assert_eq!(report["ticks_without_answer"], 0, "{report}");
            }
            goes_on(&name, 20);
            let now = living(&name, process);
            assert_eq!(now.len(), 1, "{now:?}");
            assert_eq!(now[0].1, "Speaking");
            let is_another = now[0].0 != stood_by;
            assert_eq!(is_another, starts_once_more, "{clock} {process}: {now:?}");
        }
        end(live, &name);
        let summary = summary(&file);
        let deaths = summary["deaths"].as_array().unwrap();
        assert_eq!(deaths.len(), 2, "{deaths:?}");
        assert_eq!(summary["restarts"], 0, "{summary}");
    }
}

/// Where both die, the launcher starts another of the old kind, as it does without a swap.
fn both_may_die() {
    let bench = Bench::new();
    let name = instance("swap-both");
    let file = bench.path("up.json");
    let mut command = bench.up(&name);
    command
        .args(["--episodes", "1000000"])
        .arg("--summary")
        .arg(&file);
    let live = Live::start(&mut command, &name);
    for process in ["belief", "planner"] {
        let (swap, _) = begins_to_swap(&name, process);
        let new = runtime::instance::nodes(&runtime::instance::root_for(&name), &name);
        for node in new.unwrap().iter().filter(|node| node.process == process) {
            // SAFETY: signals a process of this test's own set.
            unsafe { libc::kill(node.pid as libc::pid_t, libc::SIGKILL) };
        }
        let (output, report) = swap.join().unwrap();
        assert!(!output.status.success(), "{report}");
        goes_on(&name, 20);
        let now = living(&name, process);
        assert_eq!(now.len(), 1, "{now:?}");
        assert_eq!(now[0].1, "Speaking");
    }
    swaps_cleanly(&name, &bench, &["belief", "same"]);
    end(live, &name);
    assert_eq!(summary(&file)["restarts"], 2);
}

fn swaps_cleanly(name: &str, bench: &Bench, arguments: &[&str]) -> Value {
    let (output, report) = swap(name, bench, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", told(&output));
    assert_eq!(report["ticks_without_answer"], 0, "{report}");
    assert_eq!(report["lost_messages"], 0, "{report}");
    assert_eq!(report["old_died"], false, "{report}");
    assert!(report["border"].is_array(), "{report}");
    report
}

/// Implants of a person: learning them is not what is tested here.
fn implants(bench: &Bench) -> String {
    bench.write_implants();
    bench.path("implants.safetensors").display().to_string()
}

/// The arguments of a swap to a human model of this kind.
fn with_what_it_learned<'a>(kind: &'a str, implants: &'a str, policy: &'a str) -> Vec<&'a str> {
    let mut arguments = vec!["human", kind];
    match kind {
        "mirror" => arguments.extend(["--implants", implants]),
        "bc" => arguments.extend(["--implants", policy]),
        _ => {}
    }
    arguments
}

fn end(mut live: Live, name: &str) {
    live.signal("launcher", libc::SIGINT);
    assert_eq!(live.wait().code(), Some(1), "interrupted");
    live.assert_all_ended();
    assert_nothing_left(name);
}

fn human_models_change_places_in_lockstep() {
    let bench = Bench::new();
    let (implants, policy) = (implants(&bench), bench.write_policy());
    let name = instance("swap-lockstep");
    let file = bench.path("summary.json");
    let mut command = bench.up(&name);
    command
        .args(["--episodes", "1000000", "--summary"])
        .arg(&file);
    let live = Live::start(&mut command, &name);
    let mut last = (0, 0);
    for kind in ["mirror", "bc", "self", "mirror"] {
        let arguments = with_what_it_learned(kind, &implants, &policy);
        let report = swaps_cleanly(&name, &bench, &arguments);
        let border = (
            report["border"][0].as_u64().unwrap(),
            report["border"][1].as_u64().unwrap(),
        );
        assert!(border > last, "{border:?} after {last:?}");
        last = border;
    }
    end(live, &name);
    let summary = summary(&file);
    assert_eq!(summary["swaps"].as_array().unwrap().len(), 4);
    assert_eq!(summary["deaths"], Value::Array(Vec::new()));
    assert_eq!(summary["human"], "mirror");
    assert_no_message_lost(&summary);
}

fn human_models_change_places_in_real_time() {
    let bench = Bench::new();
    let (implants, policy) = (implants(&bench), bench.write_policy());
    let name = instance("swap-realtime");
    let mut command = bench.up(&name);
    command.args(["--episodes", "1000000", "--clock", "realtime"]);
    let live = Live::start(&mut command, &name);
    for kind in ["mirror", "bc", "self", "mirror"] {
        let arguments = with_what_it_learned(kind, &implants, &policy);
        swaps_cleanly(&name, &bench, &arguments);
    }
    end(live, &name);
}

fn every_other_process_changes_places_too() {
    let bench = Bench::new();
    let name = instance("swap-all");
    let mut command = bench.up(&name);
    command.args(["--episodes", "1000000"]);
    let live = Live::start(&mut command, &name);
    for (process, kind) in [
        ("belief", "same"),
        ("planner", "none"),
        ("renderer", "same"),
        ("driver", "sim:3"),
        ("world", "same"),
        ("recorder", "same"),
    ] {
        let report = swaps_cleanly(&name, &bench, &[process, kind]);
        let step = report["border"][1].as_u64().unwrap();
        if ["world", "driver"].contains(&process) {
            assert_eq!(step, 0, "{process} changes between two episodes");
        }
    }
    end(live, &name);
}

fn what_cannot_take_over_changes_nothing() {
    let bench = Bench::new();
    let name = instance("swap-refused");
    let mut command = bench.up(&name);
    command.args(["--episodes", "1000000"]);
    let live = Live::start(&mut command, &name);
    let garbage = bench.write("garbage.safetensors", [7; 999]);
    let garbage = garbage.display().to_string();
    for (arguments, told_of) in [
        (vec!["human", "nobody"], "nobody"),
        (vec!["cook", "same"], "cook"),
        (vec!["planner", "loud"], "loud"),
        (vec!["driver", "sim:99"], "99"),
        (vec!["belief", "other"], "other"),
        (
            vec!["human", "mirror", "--implants", &garbage],
            "garbage.safetensors",
        ),
        (
            vec!["human", "--exec", "/no/such/program"],
            "ended with status 127",
        ),
        (vec!["human", "--exec", "false"], "ended with status 1"),
    ] {
        let (output, report) = swap(&name, &bench, &arguments);
        assert!(!output.status.success(), "{arguments:?}");
        assert_eq!(report, Value::Null);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(said.contains(told_of), "{arguments:?}: {said}");
    }
    swaps_cleanly(&name, &bench, &["human", "self"]);
    end(live, &name);
    let (output, _) = swap(&name, &bench, &["human", "self"]);
    assert_eq!(output.status.code(), Some(2), "nobody is there");
    assert!(told(&output).contains(&name));
}

fn decisions_before_a_swap_are_those_of_a_run_without_it() {
    let bench = Bench::new();
    let name = instance("swap-before");
    let undisturbed = bench.path("undisturbed.mcap");
    let swapped = bench.path("swapped.mcap");
    let mut command = bench.up(&name);
    command
        .args(["--episodes", "1000000", "--record"])
        .arg(&swapped);
    let mut live = Live::start(&mut command, &name);
    let implants = implants(&bench);
    let report = swaps_cleanly(&name, &bench, &["human", "mirror", "--implants", &implants]);
    let border = (
        report["border"][0].as_u64().unwrap() as u32,
        report["border"][1].as_u64().unwrap() as u32,
    );
    // The new model says something before the run ends.
    let steps = || status(&name).map_or(0, |status| status["steps"].as_u64().unwrap());
    let before = steps();
    while steps() < before + 10 {
        std::thread::yield_now();
    }
    live.interrupt();
    live.wait();
    // The run without a swap goes as far as the border.
    let output = run(bench
        .up(&name)
        .args(["--episodes", &(border.0 + 1).to_string(), "--record"])
        .arg(&undisturbed));
    assert!(output.status.success(), "{}", told(&output));
    let (before, after) = (beliefs(&undisturbed), beliefs(&swapped));
    let earlier = |beliefs: &[((u32, u32), Vec<u8>)]| -> Vec<_> {
        let earlier = beliefs.iter().filter(|(at, _)| *at < border);
        earlier.cloned().collect()
    };
    let (expected, mut found) = (earlier(&before), earlier(&after));
    assert!(!expected.is_empty());
    let proposed = found.len();
    // A border that was proposed and came too late may have been spoken of twice.
    if report["tries"].as_u64() > Some(1) {
        found.retain(|belief| expected.contains(belief));
    }
    assert!(expected == found, "beliefs before {border:?} differ");
    let kinds: Vec<_> = after
        .iter()
        .filter(|(at, _)| *at >= border)
        .map(|(_, body)| body)
        .collect();
    assert!(!kinds.is_empty() && kinds.len() == after.len() - proposed);
    assert!(
        kinds
            .iter()
            .all(|body| body.windows(6).any(|w| w == b"mirror")),
        "the new model speaks from the border on"
    );
}

/// Position and body without the header of every human belief that was recorded.
fn beliefs(path: &std::path::Path) -> Vec<((u32, u32), Vec<u8>)> {
    let mut found = Vec::new();
    let read = recorder::read::read(path, |message| {
        if let Recorded::HumanBelief(belief) = message {
            let position = (belief.header.episode, belief.header.step);
            let body = belief.bytes()[size_of::<Header>()..].to_vec();
            found.push((position, body));
        }
    });
    read.unwrap();
    found.sort_by_key(|(position, _)| *position);
    found
}
