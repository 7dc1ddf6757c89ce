//! What users bring, and what they are told of it: recorded scenes whose reader passed over something, scenes that cannot be
//! driven, demonstrations with rounds that hold nothing.

mod common;
#[path = "../shared/domains/tests/commonroad_data/mini.rs"]
mod mini;

use common::{Bench, assert_nothing_left, instance, mirror, run, summary, told};
use domains::discrete::{Domain, Scene, Setting, SimulatedPerson, World};
use mini::{Mini, car, drive, parked, problem};
use std::path::{Path, PathBuf};
use training::rounds::{Round, Rounds};

/// Drives a scene with a simulated person: what was printed, and the summary.
fn driven(bench: &Bench, scene: &Path, test: &str) -> (String, serde_json::Value) {
    let (name, file) = (instance(test), bench.path("summary.json"));
    let mut command = bench.up(&name);
    command
        .args(["--driver", "sim:1", "--episodes", "1", "--scene"])
        .arg(scene);
    let output = run(command.arg("--summary").arg(&file));
    assert!(
        output.status.success(),
        "{}: {}",
        scene.display(),
        told(&output)
    );
    assert_nothing_left(&name);
    (
        String::from_utf8_lossy(&output.stdout).into_owned(),
        summary(&file),
    )
}

#[test]
fn what_a_scene_leaves_out_is_printed_and_in_the_summary() {
    let bench = Bench::new();
    let light = "<trafficLight id=\"50\"><cycle/></trafficLight>\n";
    let second = problem(901, [80.0, 0.0], [25, 30], "");
    let mini = Mini {
        others: light.to_owned(),
        problems: format!("{}{second}", Mini::default().problems),
        ..Mini::default()
    };
    let scene = bench.write("two.xml", mini.text());
    let (printed, summary) = driven(&bench, &scene, "notes");
    let line = "ZAM_Mini-1_1_T-1: problem 1 of 2; left out: 1 traffic light";
    assert_eq!(
        printed.lines().filter(|printed| *printed == line).count(),
        1,
        "{printed}"
    );
    let notes = serde_json::json!(["problem 1 of 2", "left out: 1 traffic light"]);
    assert_eq!(summary["notes"], notes);
    assert!(summary["steps"].as_u64().unwrap() > 10);
    // Nothing to say, nothing said.
    let scene = bench.write("plain.xml", Mini::default().text());
    let (printed, summary) = driven(&bench, &scene, "plain");
    assert!(
        !printed.contains("left out") && summary["notes"] == serde_json::json!([]),
        "{printed}"
    );
    // Where no car moves, as long as the goal: 3 s in steps of 0.15 s.
    let still = Mini {
        obstacles: parked(10, 120.0),
        ..Mini::default()
    };
    let (_, summary) = driven(&bench, &bench.write("still.xml", still.text()), "still");
    assert_eq!(summary["steps"], 20);
}

#[test]
fn what_cannot_be_driven_is_refused() {
    let bench = Bench::new();
    for (scene, words) in [
        (
            Mini {
                obstacles: car(10, &drive(40.0, 10.0, 2)),
                problems: problem(900, [0.0, 0.0], [60, 70], ""),
                ..Mini::default()
            },
            ["0.1 s is recorded", "the goal opens at 6.0 s"],
        ),
        (
            Mini {
                problems: problem(900, [0.0, 200.0], [25, 30], ""),
                ..Mini::default()
            },
            ["<initialState>", "on no lane"],
        ),
        (
            Mini {
                obstacles: car(10, &drive(1.0, 3.0, 31)),
                ..Mini::default()
            },
            ["<dynamicObstacle>", "where the ego car starts"],
        ),
    ] {
        let file = bench.write("bad.xml", scene.text());
        let mut command = bench.up(&instance("undriveable"));
        let output = run(command
            .args(["--driver", "sim:1", "--episodes", "1", "--scene"])
            .arg(&file));
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{}", told(&output));
        assert!(error.contains("bad.xml:"), "{error}");
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    }
}

/// Recorded traffic: the scene that ships, as a file, and every CommonRoad scenario in the folders that
/// `MIRROR_SCENARIOS` names, with colons between them.
#[test]
fn recorded_scenes_are_driven() {
    let ours = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/commonroad");
    let more = std::env::var_os("MIRROR_SCENARIOS").unwrap_or_default();
    let mut folders = vec![ours];
    folders.extend(std::env::split_paths(&more).filter(|folder| !folder.as_os_str().is_empty()));
    let mut files: Vec<PathBuf> = folders
        .iter()
        .flat_map(|folder| {
            std::fs::read_dir(folder)
                .unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
        })
        .map(|entry| entry.unwrap().path())
        .filter(|file| file.extension().is_some_and(|extension| extension == "xml"))
        .collect();
    files.sort();
    assert!(!files.is_empty(), "the scene that ships is gone");
    let bench = Bench::new();
    for file in files {
        let (printed, summary) = driven(&bench, &file, "scenes");
        println!("{}", printed.lines().next().unwrap_or_default());
        assert!(
            summary["steps"].as_u64().unwrap() > 1,
            "{}: {printed}",
            file.display()
        );
        assert_eq!(summary["episodes"], 1);
    }
}

fn train(demos: &Path, out: &Path) -> std::process::Output {
    let mut command = mirror();
    command.args([
        "train", "human", "--domain", "driving", "--kind", "mirror", "--demos",
    ]);
    run(command.arg(demos).arg("--out").arg(out))
}

#[test]
fn rounds_without_a_step_are_not_learned_from() {
    let scene = Scene::of(Domain::Driving, Setting::Transfer);
    let words = models::words::shipped(Domain::Driving).unwrap();
    let mut world = World::new(&scene, &words).unwrap();
    let mut person = SimulatedPerson::builtin(&scene, 1, &words).unwrap();
    let mut rounds = Rounds::record(&mut world, &mut person, 1, 0, 1);
    rounds
        .rounds
        .extend([Round::default(), Round::default(), Round::default()]);
    rounds.rounds.swap(0, 2);
    let folder = tempfile::tempdir().unwrap();
    let (demos, out) = (
        folder.path().join("rounds.safetensors"),
        folder.path().join("out.safetensors"),
    );
    rounds.save(&demos).unwrap();
    let output = train(&demos, &out);
    assert!(output.status.success(), "{}", told(&output));
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        printed.contains("learned from 1 round, 3 empty;"),
        "{printed}"
    );
    // Rounds without a step say nothing of anybody.
    rounds.rounds = vec![Round::default(); 4];
    rounds.save(&demos).unwrap();
    let output = train(&demos, &out);
    assert_eq!(output.status.code(), Some(2), "{}", told(&output));
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        error.contains("rounds.safetensors") && error.contains("no step"),
        "{error}"
    );
}
