//! Killing, stopping or spoiling any process of a set: the run goes on as the table in `launch/src/up/supervise.rs`
//! says; nothing stays behind.

mod common;

use common::{
    Bench, Live, assert_no_message_lost, assert_nothing_left, assert_replaced, instance, run,
    state, status, summary, told, until,
};
use messages::{ImagineAnswer, ImagineRequest, topic};
use runtime::Observer;
use serde_json::Value;
use std::collections::BTreeMap;

/// Episodes of a run that is disturbed at its beginning.
const EPISODES: u64 = 40;

/// Disturbs a running set and returns the exit status, and the summary.
fn disturbed(
    test: &str,
    options: &[&str],
    disturb: impl FnOnce(&Bench, &mut Live),
) -> (Option<i32>, Value) {
    let bench = Bench::new();
    let name = instance(test);
    let file = bench.path("summary.json");
    let mut command = bench.up(&name);
    command
        .args(["--episodes", &EPISODES.to_string()])
        .args(options)
        .arg("--summary")
        .arg(&file);
    let mut live = Live::start(&mut command, &name);
    disturb(&bench, &mut live);
    let status = live.wait();
    live.assert_all_ended();
    assert_nothing_left(&name);
    next_run_works(&Bench::new(), &name);
    (status.code(), summary(&file))
}

fn next_run_works(bench: &Bench, name: &str) {
    let output = run(bench.up(name).args(["--episodes", "1"]));
    assert!(output.status.success(), "{}", told(&output));
    assert_nothing_left(name);
}

/// Kills `process`: another takes its place, and the run is driven to its end.
fn is_replaced(process: &str) -> Value {
    let (status, summary) = disturbed(process, &[], |_, live| {
        live.signal(process, libc::SIGKILL);
    });
    assert_replaced(&summary, process);
    let deaths = &summary["deaths"];
    let how = deaths[0]["how"].as_str().unwrap();
    assert!(how.contains("signal 9 (SIGKILL)"), "{how}");
    assert_eq!(deaths[0]["cause"], "signal");
    assert_eq!(
        (&summary["killed"], &summary["crashes"]),
        (&1.into(), &0.into())
    );
    assert!(deaths[0]["back_after_ms"].as_f64().unwrap() > 0.0);
    assert_eq!(summary["hangs"], 0);
    assert_eq!(summary["ended_early"], Value::Null);
    assert_eq!(summary["digest"], Value::Null, "a disturbed run has none");
    assert_eq!(status, Some(0));
    summary
}

#[test]
fn the_world_begins_another_episode() {
    let summary = is_replaced("world");
    assert_eq!(summary["void_episodes"], 1);
    assert_eq!(summary["episodes"], EPISODES - 1);
}

/// Everybody else loses no episode, and no step of one.
fn no_step_is_lost(process: &str) {
    let summary = is_replaced(process);
    assert_eq!(summary["void_episodes"], 0);
    assert_eq!(summary["episodes"], EPISODES);
    assert_no_message_lost(&summary);
}

#[test]
fn another_driver_takes_the_wheel() {
    no_step_is_lost("driver");
}

#[test]
fn another_belief_goes_on() {
    no_step_is_lost("belief");
}

#[test]
fn another_human_model_goes_on() {
    no_step_is_lost("human");
}

#[test]
fn another_planner_goes_on() {
    no_step_is_lost("planner");
}

#[test]
fn another_renderer_goes_on() {
    no_step_is_lost("renderer");
}

#[test]
fn another_recorder_goes_on() {
    no_step_is_lost("recorder");
}

/// The scene that ships, with plans that take a few milliseconds.
const SMALL_PLANS: &str = "[planning]\nrace_steps = 6\nrace_first = 4\nrace_futures = 16\nsamples = 64\nfutures = 1\niterations = 2\nelites = 16\n";

#[test]
fn a_plan_begins_again_when_the_human_model_dies_in_the_middle_of_it() {
    let bench = Bench::new();
    let name = instance("midplan");
    let file = bench.path("summary.json");
    // It is stopped for a while before it is killed, and hangs only for us.
    let mut command = bench.planned(&name, SMALL_PLANS);
    command
        .args(["--episodes", "1", "--hang-limit", "1000", "--summary"])
        .arg(&file);
    let mut live = Live::start(&mut command, &name);
    stop_within_a_plan(&live, &name);
    live.signal("human", libc::SIGKILL);
    assert_eq!(live.wait().code(), Some(0));
    live.assert_all_ended();
    assert_nothing_left(&name);
    let summary = summary(&file);
    assert_replaced(&summary, "human");
    assert_eq!(summary["hangs"], 0);
}

/// Stops the human model while the planner waits for its answer: from then on the plan can only be given up.
fn stop_within_a_plan(live: &Live, name: &str) {
    let root = runtime::instance::root_for(name);
    let observer = Observer::attach(&root, name, "witness").unwrap();
    let mut questions = observer.input::<ImagineRequest>(topic::IMAGINE).unwrap();
    let mut answers = observer
        .input::<ImagineAnswer>(topic::IMAGINE_ANSWER)
        .unwrap();
    // By the step that is planned from: how many were asked, and how many answered. The first is not seen from its
    // beginning.
    let mut steps: BTreeMap<(u32, u32), [u32; 2]> = BTreeMap::new();
    let mut look = || {
        let mut heard = false;
        while let Some(question) = questions.next().unwrap() {
            let header = &question.header;
            steps.entry((header.episode, header.step)).or_default()[0] += 1;
            heard = true;
        }
        while let Some(answer) = answers.next().unwrap() {
            let header = &answer.header;
            steps.entry((header.episode, header.step)).or_default()[1] += 1;
        }
        let newest = steps.values().skip(1).next_back();
        let waits = newest.is_some_and(|[asked, answered]| asked > answered);
        (heard && newest.is_some(), waits)
    };
    loop {
        until("the planner asks", || look().0);
        live.signal("human", libc::SIGSTOP);
        until("one is stopped and the other waits", || {
            state(live.pid("human")) == Some('T') && state(live.pid("planner")) == Some('S')
        });
        if look().1 {
            return;
        }
        live.signal("human", libc::SIGCONT);
    }
}

#[test]
fn a_stopped_process_is_replaced() {
    let (status, summary) = disturbed("stopped", &[], |_, live| {
        live.signal("human", libc::SIGSTOP);
    });
    assert_eq!(summary["hangs"], 1);
    assert_eq!(summary["restarts"], 1);
    let how = summary["deaths"][0]["how"].as_str().unwrap();
    assert!(how.contains("had not answered"), "{how}");
    assert_eq!(summary["deaths"][0]["cause"], "launcher");
    assert_eq!(
        (&summary["killed"], &summary["crashes"]),
        (&0.into(), &0.into())
    );
    assert_eq!(summary["episodes"], EPISODES);
    assert_eq!(status, Some(0));
}

#[test]
fn without_restarts_a_death_ends_the_run() {
    let (status, summary) = disturbed("once", &["--restarts", "0"], |_, live| {
        live.signal("belief", libc::SIGKILL);
    });
    let reason = summary["ended_early"].as_str().unwrap();
    assert!(
        reason.contains("belief") && reason.contains("signal 9"),
        "{reason}"
    );
    assert_eq!(summary["completed"], false);
    assert_eq!(summary["restarts"], 0);
    assert_eq!(status, Some(1));
}

#[test]
fn a_model_that_became_garbage_ends_the_run_in_words() {
    let (status, summary) = disturbed("garbage", &["--restarts", "3"], |bench, live| {
        bench.write("self.safetensors", [0x55; 4096]);
        live.signal("belief", libc::SIGKILL);
    });
    let deaths = summary["deaths"].as_array().unwrap();
    assert_eq!(deaths.len(), 4, "{deaths:?}");
    let reason = summary["ended_early"].as_str().unwrap();
    for part in ["belief", "self.safetensors", "3 restarts in a row"] {
        assert!(reason.contains(part), "{reason}");
    }
    assert_eq!(status, Some(1));
}

#[test]
fn two_sets_do_not_meet() {
    let (bench, other) = (Bench::new(), instance("beside"));
    let mut beside = Live::start(bench.up(&other).args(["--episodes", "1000000"]), &other);
    let summary = is_replaced("planner");
    assert_eq!(summary["episodes"], EPISODES);
    beside.signal("launcher", libc::SIGINT);
    assert_eq!(beside.wait().code(), Some(1), "interrupted");
    assert_nothing_left(&other);
}

#[test]
fn launcher_takes_everybody_with_it() {
    let bench = Bench::new();
    let name = instance("launcher");
    let mut live = Live::start(bench.up(&name).args(["--episodes", "1000000"]), &name);
    live.signal("launcher", libc::SIGKILL);
    live.wait();
    live.wait_for_processes();
    next_run_works(&bench, &name);
}

/// A run in which a process dies as one with a bug does: it goes on, and says so at its end.
fn crashes(process: &str, signal: libc::c_int, name_of_signal: &str) {
    let bench = Bench::new();
    let name = instance(&format!("crash-{process}"));
    let file = bench.path("summary.json");
    let mut command = bench.up(&name);
    command.args(["--episodes", &EPISODES.to_string(), "--summary"]);
    let mut live = Live::start(command.arg(&file), &name);
    let pid = live.pid(process) as libc::pid_t;
    until("it has a part in a step", || {
        let status = status(&name).unwrap();
        let mut processes = status["processes"].as_array().unwrap().iter();
        let known = processes.find(|known| known["process"] == process);
        known.is_some_and(|known| known["position"].is_array())
    });
    // Rust's own handler takes the first SIGSEGV for a full stack, finds that it was none, and lets the next one
    // through. SAFETY: signals a process of this set; once its launcher has reaped it, there is none.
    while unsafe { libc::kill(pid, signal) } == 0 {
        std::thread::yield_now();
    }
    let (status, text) = live.wait_for_text();
    live.assert_all_ended();
    assert_nothing_left(&name);
    let summary = summary(&file);
    assert_eq!(summary["completed"], true);
    assert_eq!(summary["ended_early"], Value::Null);
    assert_eq!(summary["episodes"], EPISODES);
    assert_eq!(
        (&summary["crashes"], &summary["killed"]),
        (&1.into(), &0.into())
    );
    assert_eq!(summary["deaths"][0]["cause"], "crash");
    assert_eq!(summary["deaths"][0]["signal"], name_of_signal);
    assert_eq!(status.code(), Some(1), "{text}");
    let last = text.trim_end().lines().last().unwrap();
    for part in ["CRASHED", process, name_of_signal, "exit status 1"] {
        assert!(last.contains(part), "no {part:?} in {last:?}");
    }
    let position = &summary["deaths"][0]["position"];
    let [episode, step] = [0, 1].map(|at| position[at].as_u64().expect("it had a part in a step"));
    let at = format!("episode {episode} step {step}");
    assert!(last.contains(&at), "no {at:?} in {last:?}");
}

#[test]
fn a_run_with_a_segmentation_fault_is_no_success() {
    crashes("human", libc::SIGSEGV, "SIGSEGV");
}

#[test]
fn a_run_with_an_abort_is_no_success() {
    crashes("driver", libc::SIGABRT, "SIGABRT");
}
