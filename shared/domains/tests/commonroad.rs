//! Recorded traffic through the public interface: the files' cars are where the files say, people can be driven as, and
//! the three real recordings run to their ends.

mod commonroad_data;

use commonroad_data::{FIXTURE_2018B, FIXTURE_2020A, real_files};
use domains::commonroad::{LaneletMap, RecordedSeat, Scenario, box_pose, wrap};
use domains::highway::{End, Fog, Observation, Scene, World};
use std::sync::Arc;

fn scenarios() -> Vec<Scenario> {
    let mut all: Vec<Scenario> = real_files()
        .iter()
        .map(|file| Scenario::read(file).unwrap_or_else(|error| panic!("{error}")))
        .collect();
    for (name, text) in [("2018b", FIXTURE_2018B), ("2020a", FIXTURE_2020A)] {
        all.push(Scenario::parse(text.as_bytes(), name).unwrap_or_else(|error| panic!("{error}")));
    }
    all
}

/// Steps worlds of one tick per control step, so that every recorded instant is visited.
fn by_tick(scenario: &Scenario, seat: Option<i32>) -> World {
    let mut scene = scenario.scene(None, seat).unwrap();
    scene.clock.ticks_per_step = 1;
    scene.episode.max_steps = 1_000_000;
    World::new(Arc::new(scene)).unwrap()
}

#[test]
fn every_recorded_pose_is_replayed_to_the_centimetre() {
    for scenario in scenarios() {
        let mut checked = 0;
        // From a seat that lasts to the end: a world around the problem's car stops where that car collides.
        let last = scenario.last_step();
        let seat = scenario
            .obstacles
            .iter()
            .find(|o| {
                o.moving
                    && o.states.len() >= 3
                    && o.states[0].step == 0
                    && o.states[o.states.len() - 1].step == last
            })
            .expect("a car that is there all the time")
            .id;
        let mut world = by_tick(&scenario, Some(seat));
        let tick_s = 1.0 / world.scene().clock.tick_hz;
        let mut worst: f64 = 0.0;
        loop {
            let step = world.time_s() / scenario.step_s;
            if (step - step.round()).abs() < 1e-6 {
                let step = step.round() as u32;
                for obstacle in scenario.obstacles.iter().filter(|o| o.moving) {
                    let state = obstacle.states.iter().find(|s| s.step == step);
                    let (x, y, sin, cos, present) = if obstacle.id == seat {
                        let pose = world.ego().pose;
                        let (sin, cos) = pose.heading_rad.sin_cos();
                        (pose.x_m, pose.y_m, sin, cos, true)
                    } else {
                        let car = world
                            .objects()
                            .iter()
                            .find(|car| car.id == obstacle.id)
                            .unwrap();
                        (car.x_m, car.y_m, car.sin, car.cos, car.present)
                    };
                    assert_eq!(
                        present,
                        state.is_some(),
                        "{} car {} step {step}",
                        scenario.file,
                        obstacle.id
                    );
                    let Some(state) = state else { continue };
                    let away = (x - state.x_m).hypot(y - state.y_m);
                    let turned = wrap(sin.atan2(cos) - state.heading_rad).abs();
                    assert!(
                        away < 0.01 && turned < 1e-6,
                        "{} car {} step {step}: {away} m",
                        scenario.file,
                        obstacle.id
                    );
                    worst = worst.max(away);
                    checked += 1;
                }
            }
            if world.end() != End::Running {
                break;
            }
            world.step([0.0, 0.0]);
        }
        let states: usize = scenario
            .obstacles
            .iter()
            .filter(|o| o.moving)
            .map(|o| o.states.len())
            .sum();
        // The seat's world ends at the last instant of its record, or one tick before where another car overlaps it.
        println!(
            "{}: {checked} of {states} poses, at most {worst:e} m off (tick {tick_s} s)",
            scenario.file
        );
        assert_eq!(checked, states, "{}", scenario.file);
    }
}

#[test]
fn a_pose_between_recorded_instants_lies_between_them() {
    for scenario in scenarios() {
        let mut world = by_tick(&scenario, None);
        let before: Vec<_> = world.objects().to_vec();
        world.step([0.0, 0.0]);
        let t = 0.05 / scenario.step_s;
        for (obstacle, (now, then)) in scenario
            .obstacles
            .iter()
            .zip(world.objects().iter().zip(&before))
        {
            let (Some(a), Some(b)) = (obstacle.states.first(), obstacle.states.get(1)) else {
                continue;
            };
            if !then.present || a.step != 0 || b.step != 1 {
                continue;
            }
            let (from, to) = (box_pose(obstacle, a), box_pose(obstacle, b));
            assert!((now.x_m - (from.x_m + t * (to.x_m - from.x_m))).abs() < 1e-6);
            assert!((now.y_m - (from.y_m + t * (to.y_m - from.y_m))).abs() < 1e-6);
        }
    }
}

#[test]
fn headings_are_interpolated_along_the_short_way() {
    let scenario = Scenario::parse(FIXTURE_2018B.as_bytes(), "2018b").unwrap();
    // Car 12 turns from 3.1 to −3.1 rad: over π, not back through 0.
    let mut world = by_tick(&scenario, None);
    world.step([0.0, 0.0]);
    let car = world.objects().iter().find(|car| car.id == 12).unwrap();
    assert!(car.cos < -0.99, "heading {}", car.sin.atan2(car.cos));
}

#[test]
fn traffic_moves_from_the_start_and_ends_with_the_recording() {
    for scenario in scenarios() {
        let scene = Arc::new(scenario.scene(None, None).unwrap());
        let mut world = World::new(scene.clone()).unwrap();
        assert!(world.observation().moving);
        let start = scenario.problem().unwrap().start;
        assert_eq!(
            (world.ego().pose.x_m, world.ego().pose.y_m),
            (start.x_m, start.y_m)
        );
        assert_eq!(world.ego().speed_mps, start.speed_mps);
        let mut steps = 0;
        while world.end() == End::Running {
            world.step([-1.0, 0.0]);
            steps += 1;
            assert!(
                steps <= scene.episode.max_steps,
                "{} does not end",
                scenario.file
            );
        }
        println!(
            "{}: braking ends after {steps} steps with {:?}",
            scenario.file,
            world.end()
        );
    }
}

#[test]
fn lane_and_heading_are_those_of_the_lanelet_under_the_car() {
    for scenario in scenarios() {
        let map = LaneletMap::new(&scenario);
        let (mut lane_worst, mut heading_worst, mut count) = (0.0f64, 0.0f64, 0);
        for id in scenario.seats() {
            let mut seat = RecordedSeat::new(&scenario, id).unwrap();
            let mut observation = Observation::default();
            loop {
                let pose = seat.world().ego().pose;
                if seat.advance(&mut observation).is_none() {
                    break;
                }
                let point = [pose.x_m, pose.y_m];
                let under = map.under(point, pose.heading_rad);
                let containing = (0..scenario.lanelets.len())
                    .filter(|l| map.contains(*l, point))
                    .count();
                // On two lanelets at once (a fork), or on none: there is no one answer.
                if containing != 1 {
                    continue;
                }
                let (offset, direction) = map.offset(under, point);
                // Near the border of two lanes, the two answers may name different ones.
                let lane_m = f64::from(observation.ego[2]) * 1.75;
                if offset.abs() > 1.6 {
                    continue;
                }
                let heading = f64::from(observation.ego[0]) * std::f64::consts::PI;
                lane_worst = lane_worst.max((lane_m - offset).abs());
                heading_worst =
                    heading_worst.max(wrap(pose.heading_rad - direction - heading).abs());
                count += 1;
                assert!(
                    (lane_m - offset).abs() < 0.30,
                    "{} car {id}: {lane_m} m, lanelet says {offset} m",
                    scenario.file
                );
            }
        }
        println!(
            "{}: {count} places, lane offset within {lane_worst} m, heading within {heading_worst} rad",
            scenario.file
        );
        assert!(count > 0 && heading_worst < 0.05, "{}", scenario.file);
    }
}

#[test]
fn recorded_people_act_within_the_cars_means() {
    for scenario in scenarios() {
        let scene = scenario.scene(None, None).unwrap();
        for id in scenario.seats() {
            let found = scenario.recorded_actions(id, &scene).unwrap();
            let seated: Vec<_> = RecordedSeat::new(&scenario, id)
                .unwrap()
                .map(|(_, action)| action)
                .collect();
            assert!(
                found
                    .actions
                    .iter()
                    .flatten()
                    .all(|value| (-1.0..=1.0).contains(value))
            );
            assert_eq!(found.actions, seated, "{} car {id}", scenario.file);
            println!(
                "{} car {id}: {} actions, {} cut; residual a step: {:.3} m rms, {:.3} m at most, {:.4} rad, {:.3} m/s",
                scenario.file,
                found.actions.len(),
                found.clamped,
                found.position_rms_m,
                found.position_max_m,
                found.heading_rms_rad,
                found.speed_rms_mps
            );
        }
    }
}

#[test]
fn actions_of_a_car_that_our_bicycle_drove_are_found_again() {
    // Car 11 of the 2020a file accelerates at 1 m/s² on a straight lane.
    let scenario = Scenario::parse(FIXTURE_2020A.as_bytes(), "2020a").unwrap();
    let scene = scenario.scene(None, None).unwrap();
    let found = scenario.recorded_actions(11, &scene).unwrap();
    let spec = &scene.ego;
    for (step, [throttle, steer]) in found.actions.iter().enumerate() {
        let mean_mps = 10.0 + (step as f64 + 0.5) * 0.15;
        let expected = (1.0 + spec.drag_mps2 * mean_mps / 10.0) / spec.acceleration_mps2;
        assert!(
            (f64::from(*throttle) - expected).abs() < 1e-3,
            "{throttle} for {expected}"
        );
        assert_eq!(*steer, 0.0);
    }
    assert!(
        found.position_max_m < 0.01 && found.clamped == 0,
        "{found:?}"
    );
}

#[test]
fn reading_and_running_are_deterministic() {
    for (first, second) in scenarios().iter().zip(scenarios()) {
        assert_eq!(*first, second);
        let run = |scenario: &Scenario| {
            let mut world =
                World::new(Arc::new(scenario.scene(Some(15.0), None).unwrap())).unwrap();
            world.reset(7, 0);
            let mut seen = Vec::new();
            while world.end() == End::Running {
                let outcome = world.step([0.1, 0.0]);
                seen.push((world.observation().clone(), outcome));
            }
            seen
        };
        assert_eq!(run(first), run(&second));
    }
}

#[test]
fn a_scenario_is_usable_where_a_scene_file_is() {
    for file in real_files() {
        let scene = Scene::load(&file).unwrap();
        assert!(scene.course.is_some());
        assert_eq!(scene.fog(), Fog::clear());
        let foggy = Scene::from_commonroad(&file, Some(15.0), None).unwrap();
        assert_eq!(foggy.fog.map(|fog| fog.front_m), Some(15.0));
        assert!(foggy.ego.throttle_limit_kmh >= 37.0);
    }
}
