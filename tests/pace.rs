//! A machine that is too slow for real time says so: to the person who drives, while it happens, in the summary, and beforehand.

mod common;

use common::{Bench, assert_nothing_left, instance, mirror, run, summary, told};
use serde_json::Value;

/// Sixty simulated seconds in one: no machine plans by the cross-entropy method within a step of 2.5 ms.
const FAST: &str = "name = \"fast\"\n[clock]\nrate = 60.0\n[episode]\nmax_steps = 200\n";

/// The share of a step that a plan may take, where this machine is to keep up.
const SHARE: f64 = 0.85;

fn number(value: &Value) -> u64 {
    value.as_u64().unwrap_or_else(|| panic!("{value}"))
}

#[test]
fn who_drives_without_timely_decisions_is_told_so_at_once_and_in_the_summary() {
    let bench = Bench::new();
    let name = instance("pace");
    let (file, scene) = (bench.path("up.json"), bench.write("fast.toml", FAST));
    let mut command = mirror();
    command
        .args([
            "up",
            "--human",
            "self",
            "--planner",
            "ce",
            "--clock",
            "realtime",
        ])
        .args(["--episodes", "2", "--instance", &name, "--self-model"])
        .arg(bench.path("self.safetensors"))
        .arg("--scene")
        .arg(scene)
        .arg("--summary")
        .arg(&file);
    let output = run(&mut command);
    assert!(output.status.success(), "{}", told(&output));
    assert_nothing_left(&name);

    let said = String::from_utf8_lossy(&output.stdout);
    let live = said.lines().filter(|line| line.contains("NOTE"));
    let live: Vec<_> = live.collect();
    assert_eq!(live.len(), 1, "once when it begins: {said}");
    assert!(live[0].contains("Not assisted: "), "{live:?}");

    let summary = summary(&file);
    let decisions = &summary["decisions"];
    let [steps, in_time, late, none] =
        ["steps", "in_time", "late", "none"].map(|key| number(&decisions[key]));
    assert_eq!(in_time + late + none, steps, "{decisions}");
    assert!(in_time * 2 < steps, "{decisions}");
    // An episode's first step has no decision, and nobody acts on its last outcome.
    assert_eq!(steps, number(&summary["steps"]) - 2, "{decisions}");
    let words = format!("{in_time} of {steps} steps had a decision in time");
    assert!(said.contains(&words), "{words}: {said}");
    assert!(said.contains("NOT ASSISTED IN TIME"), "{said}");
    let episodes = summary["episode_list"].as_array().unwrap().iter();
    let notices: Vec<_> = episodes
        .flat_map(|episode| episode["notices"].as_array().unwrap())
        .collect();
    assert_eq!(notices.len(), 1, "{notices:?}");
    for episode in summary["episode_list"].as_array().unwrap() {
        let said = episode["said"].as_array().unwrap();
        assert_eq!(episode["verbal_items"], said.len(), "a notice is none");
        assert!(said.iter().all(|said| said["item"] != "?"), "{said:?}");
    }
}

#[test]
fn where_every_decision_is_waited_for_nothing_is_said() {
    let bench = Bench::new();
    let file = bench.path("up.json");
    let mut command = bench.up(&instance("pace-lockstep"));
    command.args(["--episodes", "1", "--summary"]).arg(&file);
    let output = run(&mut command);
    assert!(output.status.success(), "{}", told(&output));
    assert_eq!(summary(&file)["decisions"], Value::Null);
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(!said.contains("ASSISTED"), "{said}");
}

#[test]
fn doctor_says_beforehand_whether_this_machine_keeps_up() {
    let output = run(mirror().arg("doctor"));
    let said = String::from_utf8_lossy(&output.stdout);
    for words in [
        "Real time",
        "a plan of the default scene takes",
        "a step lasts 150 ms",
    ] {
        assert!(said.contains(words), "{words}: {}", told(&output));
    }
    // What it concludes is what it measured: "… takes 75 ms (p50), 89 ms (p99, of 20 plans); a step lasts 150 ms".
    let before = |mark: &str| -> f64 {
        let words = said.split(mark).next().unwrap().trim_end_matches(" ms");
        words.rsplit(' ').next().unwrap().parse().unwrap()
    };
    let (p50, p99) = (before(" (p50)"), before(" (p99"));
    let verdict = [
        "keeps up: ",
        "keeps up most of the time only",
        "does NOT keep up",
    ];
    let verdict: Vec<bool> = verdict.iter().map(|words| said.contains(words)).collect();
    // A decision has to be there when a share of the step is over; the figures are rounded to milliseconds.
    let late = |plan: f64| match plan {
        _ if plan > SHARE * 150.0 + 1.0 => Some(true),
        _ if plan < SHARE * 150.0 - 1.0 => Some(false),
        _ => None,
    };
    assert_eq!(verdict.iter().filter(|said| **said).count(), 1, "{said}");
    assert_eq!(late(p99).unwrap_or(!verdict[0]), !verdict[0], "{said}");
    assert_eq!(late(p50).unwrap_or(verdict[2]), verdict[2], "{said}");
}
