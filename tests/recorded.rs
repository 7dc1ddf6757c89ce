//! Recorded traffic through the whole set: a simulated person in it, and a recorded person's own drive.

mod common;

use common::{Bench, assert_nothing_left, instance, run, summary, told};
use domains::commonroad::Scenario;
use domains::highway::World;
use std::path::Path;
use std::sync::Arc;

const FILE: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../shared/domains/tests/commonroad_data/2020a.xml"
);

#[test]
fn a_simulated_person_drives_in_recorded_traffic() {
    let bench = Bench::new();
    let name = instance("recorded-sim");
    let file = bench.path("summary.json");
    let mut command = bench.up(&name);
    command.args([
        "--scene",
        FILE,
        "--fog",
        "15",
        "--driver",
        "sim:1",
        "--episodes",
        "2",
    ]);
    let output = run(command.arg("--summary").arg(&file));
    assert!(output.status.success(), "{}", told(&output));
    let summary = summary(&file);
    assert_eq!(summary["completed"], true);
    assert_eq!(summary["episodes"], 2);
    assert_nothing_left(&name);
}

#[test]
fn a_recorded_person_drives_as_they_did() {
    let car = Scenario::read(Path::new(FILE)).unwrap().seats()[0];
    let scene = Scenario::read(Path::new(FILE))
        .unwrap()
        .scene(None, Some(car))
        .unwrap();
    let mut world = World::new(Arc::new(scene)).unwrap();
    world.reset(1, 0);
    let (mut steps, mut reward) = (0, 0.0);
    while world.end() == domains::highway::End::Running {
        reward += f64::from(world.step([0.0; 2]).reward);
        steps += 1;
    }

    let bench = Bench::new();
    let name = instance("recorded-own");
    let file = bench.path("summary.json");
    let mut command = bench.up(&name);
    command.args([
        "--scene",
        FILE,
        "--driver",
        &format!("recorded:{car}"),
        "--episodes",
        "1",
    ]);
    let output = run(command.arg("--summary").arg(&file));
    assert!(output.status.success(), "{}", told(&output));
    let summary = summary(&file);
    assert_eq!(summary["steps"], steps);
    assert!((summary["reward_mean"].as_f64().unwrap() - reward).abs() < 1e-6);
    assert_nothing_left(&name);

    let mut command = bench.up(&instance("recorded-none"));
    let output = run(command.args(["--scene", FILE, "--driver", "recorded:999999"]));
    assert_eq!(output.status.code(), Some(2), "{}", told(&output));
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(
        error.contains("2020a.xml") && error.contains("999999"),
        "{error}"
    );
}
