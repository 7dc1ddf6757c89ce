//! Recorded traffic through the whole set: a simulated person in it, and a recorded person's own drive.

mod common;
#[path = "../examples/commonroad/highway_recorded.rs"]
mod highway_recorded;

use common::{Bench, assert_nothing_left, instance, mirror, run, summary, told};
use domains::commonroad::{Scenario, box_pose};
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

/// The scene that ships, as a file.
const SHIPPED: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../examples/commonroad/highway-recorded.xml"
);

#[test]
fn the_scene_that_ships_is_what_its_program_writes() {
    let file = std::fs::read_to_string(SHIPPED).unwrap();
    assert!(
        file == highway_recorded::scenario(),
        "made anew, {SHIPPED} is another"
    );
}

#[test]
fn everybody_in_the_scene_that_ships_can_be_driven_as_and_nobody_touches_anybody() {
    let scenario = Scenario::read(Path::new(SHIPPED)).unwrap();
    assert!(scenario.left_out.is_empty(), "{:?}", scenario.left_out);
    let seats = scenario.seats();
    assert_eq!(seats.len(), 10);
    for id in seats {
        let scene = scenario.scene(None, Some(id)).unwrap();
        let found = scenario.recorded_actions(id, &scene).unwrap();
        assert!(found.actions.len() >= 79, "{id}: {}", found.actions.len());
        // One who brakes for a car that cuts in may brake as hard as the car can, and no more.
        assert!(found.clamped * 10 <= found.actions.len(), "{id}: {found:?}");
        assert!(found.position_rms_m < 0.1, "{id}: {found:?}");
    }
    let cars = &scenario.obstacles;
    for step in 0..=scenario.last_step() as usize {
        for (at, car) in cars.iter().enumerate() {
            for other in &cars[..at] {
                let [a, b] = [car, other].map(|car| {
                    let outline = car.shape.local_box();
                    (box_pose(car, &car.states[step]), outline)
                });
                // Nobody is turned by more than a few degrees.
                let along = (a.0.x_m - b.0.x_m).abs() - (a.1.length_m + b.1.length_m) / 2.0;
                let across = (a.0.y_m - b.0.y_m).abs() - (a.1.width_m + b.1.width_m) / 2.0;
                assert!(
                    along > 1.0 || across > 0.5,
                    "{} and {} at step {step}: {along} {across}",
                    car.id,
                    other.id
                );
            }
        }
    }
}

#[test]
fn the_scene_that_ships_is_driven_by_name_and_replayed() {
    let bench = Bench::new();
    let drive = |name: &str, scene: &str, more: &[&str]| {
        let (instance, file) = (instance(name), bench.path(&format!("{name}.json")));
        let mut command = bench.up(&instance);
        command
            .args(["--episodes", "1", "--scene", scene])
            .args(more);
        // Not where its file lies.
        command.current_dir("/").arg("--summary").arg(&file);
        let output = run(&mut command);
        assert!(output.status.success(), "{}", told(&output));
        assert_nothing_left(&instance);
        summary(&file)
    };
    let recording = bench.path("drive.mcap");
    let record = [
        "--driver",
        "recorded:17",
        "--record",
        recording.to_str().unwrap(),
    ];
    let by_name = drive("shipped-name", "highway-recorded", &record);
    assert_eq!(by_name["scene"], "highway-recorded");
    assert_eq!(by_name["driver"], "recorded:17");
    // Twelve seconds: each step but the last has a recorded one after it.
    assert_eq!(by_name["steps"], 80);
    assert_eq!(by_name["collisions"], 0);
    let by_file = drive("shipped-file", SHIPPED, &record[..2]);
    assert_eq!(by_name["digest"], by_file["digest"]);
    let output = run(mirror().arg("replay").arg(&recording));
    assert!(output.status.success(), "{}", told(&output));

    let simulated = drive("shipped-sim", "highway-recorded", &["--driver", "sim:3"]);
    assert_eq!(simulated["completed"], true);
    assert_ne!(simulated["digest"], by_name["digest"]);

    let mut command = bench.up(&instance("shipped-nobody"));
    let output = run(command.args(["--scene", "highway-recorded", "--driver", "recorded:99"]));
    assert_eq!(output.status.code(), Some(2), "{}", told(&output));
    let error = String::from_utf8_lossy(&output.stderr);
    for part in ["highway-recorded", "99", "11, 12"] {
        assert!(error.contains(part), "no {part:?} in {error}");
    }
}
