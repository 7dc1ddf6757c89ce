//! What the highway world promises: cases, waiting for the driver, determinism, reward, ends.

use std::sync::Arc;

use domains::highway::traffic::Motion;
use domains::highway::world::{Misbehaviour, NOTHING, ROAD_EDGE};
use domains::highway::{
    Case, End, Expert, Fog, Observation, Person, Scene, Shown, SimulatedDriver, World, episode,
};

fn world() -> World {
    World::new(Arc::new(Scene::builtin("highway-clear").unwrap())).unwrap()
}

#[test]
fn cars_wait_for_the_first_throttle() {
    let mut world = world();
    world.reset(1, 0);
    let before = world.objects().to_vec();
    for _ in 0..10 {
        let outcome = world.step([-0.5, 0.3]);
        assert_eq!(outcome.end, End::Running);
    }
    assert_eq!(world.objects(), before);
    assert!(!world.observation().moving);
    world.step([0.2, 0.0]);
    world.step([0.0, 0.0]);
    assert!(world.observation().moving);
    for (car, before) in world.objects().iter().zip(&before) {
        assert!(car.at.s_m > before.at.s_m);
    }
}

#[test]
fn the_six_cases_are_designs() {
    let mut world = world();
    for (episode, case) in Case::ALL.into_iter().enumerate() {
        world.reset(9, episode as u32 + 6);
        assert_eq!(world.case(), case);
        let lane = usize::from(case.ego_left());
        assert_eq!(world.ego().lane, lane);
        assert_eq!(world.ego().at.s_m, 30.0);
        let cars = world.objects();
        assert_eq!(cars.len(), 4);
        for car in cars {
            let rear = car.id < 2;
            let range = if rear { 0.0..=10.0 } else { 115.0..=125.0 };
            assert!(range.contains(&car.at.s_m));
            assert_eq!(car.lane, 1 - car.id as usize % 2);
        }
        let reference = 30.0 / 3.6;
        for (car, participant) in world.objects().iter().zip(world.participants()) {
            let Motion::Lane(motion) = &participant.motion else {
                panic!("cars of a case keep their lane");
            };
            let (rear, own) = (car.id < 2, car.lane == lane);
            let factor = motion.speed_mps / reference;
            let rushes = match case.misbehaviour() {
                Misbehaviour::FrontSlows => false,
                Misbehaviour::RearRushes => rear && own,
                Misbehaviour::OtherRearRushes => rear && !own,
            };
            match (rear, rushes) {
                (true, true) => assert!((2.2..=2.3).contains(&factor)),
                (true, false) => assert!((factor - 1.35).abs() < 1e-9),
                (false, _) => assert!((factor - 1.64).abs() < 1e-9),
            }
            let slows = case.misbehaviour() == Misbehaviour::FrontSlows && !rear && own;
            assert_eq!(motion.slows_at_m.is_finite(), slows);
            if slows {
                assert!((0.1..=0.2).contains(&(motion.slow_speed_mps / reference)));
                assert!((185.0..=195.0).contains(&motion.slows_at_m));
            }
        }
    }
}

#[test]
fn a_slowing_front_car_slows_where_it_should() {
    let mut world = world();
    world.reset_case(3, 0, Case::new(1).unwrap());
    let mut expert = Expert::new(&world);
    let mut slow = None;
    while world.end() == End::Running {
        let action = expert.act(&world);
        world.step(action);
        let front = world.objects().iter().find(|car| car.id == 2).unwrap();
        if front.at.s_m > 100.0 && world.time_s() > 12.0 && front.speed_mps < 2.0 {
            slow.get_or_insert((front.at.s_m, front.speed_mps));
        }
    }
    let (s, speed) = slow.unwrap();
    assert!((185.0..225.0).contains(&s), "{s}");
    assert!(speed > 0.8, "{speed}");
}

/// Every bit that a round shows.
fn digest(seed: u64, episode: u32) -> Vec<u32> {
    let mut world = world();
    world.reset(seed, episode);
    let mut expert = Expert::new(&world);
    let mut bits = Vec::new();
    let mut observation = Observation::default();
    while world.end() == End::Running {
        world.observe(&mut observation);
        bits.extend(observation.range.map(f32::to_bits));
        bits.extend(observation.ego.map(f32::to_bits));
        let action = expert.act(&world);
        bits.push(world.step(action).reward.to_bits());
    }
    bits
}

#[test]
fn the_same_seed_gives_the_same_bits() {
    assert_eq!(digest(5, 1), digest(5, 1));
    assert_ne!(digest(5, 1), digest(6, 1));
    assert_ne!(digest(5, 1), digest(5, 7));
}

#[test]
fn leaving_the_road_ends_the_round() {
    let mut world = world();
    world.reset_case(1, 0, Case::new(4).unwrap());
    let mut last = None;
    for _ in 0..100 {
        let outcome = world.step([1.0, -0.3]);
        if outcome.end != End::Running {
            last = Some(outcome);
            break;
        }
    }
    let outcome = last.unwrap();
    assert_eq!(
        (outcome.end, outcome.other, outcome.collision),
        (End::Collision, ROAD_EDGE, -10.0)
    );
    assert!(outcome.collided);
    // Afterwards nothing moves and nothing is earned.
    let still = world.step([1.0, 0.0]);
    assert_eq!(
        (still.reward, still.collided, still.end),
        (0.0, false, End::Collision)
    );
}

#[test]
fn a_rusher_hits_who_stays() {
    let mut world = world();
    world.reset_case(1, 0, Case::new(5).unwrap());
    // Straight on slowly; the first bend comes later.
    let mut outcome = world.step([0.3, 0.0]);
    while outcome.end == End::Running {
        outcome = world.step([0.0, 0.0]);
    }
    assert_eq!((outcome.end, outcome.other), (End::Collision, 1));
}

#[test]
fn time_runs_out_and_the_goal_is_reached() {
    let mut world = world();
    world.reset(1, 0);
    let mut outcome = world.step([-1.0, 0.0]);
    while outcome.end == End::Running {
        outcome = world.step([-1.0, 0.0]);
    }
    assert_eq!(
        (outcome.end, world.steps(), outcome.other),
        (End::OutOfTime, 250, NOTHING)
    );
    world.reset(1, 2);
    let mut expert = Expert::new(&world);
    while world.end() == End::Running {
        let action = expert.act(&world);
        world.step(action);
    }
    assert_eq!(world.end(), End::Goal);
    assert!(world.ego().at.s_m >= 360.0);
}

#[test]
fn reward_terms_are_the_papers() {
    let mut world = world();
    world.reset_case(1, 0, Case::new(4).unwrap());
    let standing = world.step([-1.0, 0.5]);
    assert_eq!(
        (standing.speed, standing.brake, standing.steer),
        (0.0, -0.3, -0.05)
    );
    assert_eq!(
        (standing.change, standing.road, standing.collision),
        (0.0, 0.0, 0.0)
    );
    assert!(standing.center.abs() < 1e-6);
    let mut changes = 0.0;
    let mut reached = 0.0f32;
    for _ in 0..25 {
        let outcome = world.step([1.0, 0.08]);
        changes += outcome.change;
        reached = reached.max(outcome.speed);
        let ego = world.observation().ego;
        assert!((outcome.center + ego[2].abs()).abs() < 1e-5);
        assert!((outcome.speed - ego[1]).abs() < 1e-6);
        let sum = outcome.speed
            + outcome.brake
            + outcome.steer
            + outcome.change
            + outcome.center
            + outcome.proximity
            + outcome.road
            + outcome.collision;
        assert!((outcome.reward - sum).abs() < 1e-5);
        let near = world
            .observation()
            .nearest_m(0)
            .min(world.observation().nearest_m(18))
            < 20.0;
        assert_eq!(outcome.proximity, if near { -2.0 } else { 0.0 });
    }
    assert_eq!(changes, -1.0, "one lane change");
    assert!(reached > 0.5);
    // Farther left lies the shoulder.
    let mut shoulder = 0.0;
    while world.end() == End::Running {
        shoulder = world.step([0.0, 0.05]).road;
        if shoulder != 0.0 {
            break;
        }
    }
    assert_eq!(shoulder, -4.0);
}

#[test]
fn no_throttle_above_37_kmh() {
    let mut world = world();
    world.reset_case(1, 0, Case::new(6).unwrap());
    let mut fastest = 0.0f64;
    for _ in 0..40 {
        let outcome = world.step([1.0, 0.0]);
        fastest = fastest.max(world.ego().speed_mps);
        if outcome.end != End::Running {
            break;
        }
    }
    assert!(fastest > 36.0 / 3.6 && fastest < 38.0 / 3.6, "{fastest}");
}

#[test]
fn the_expert_avoids_collisions() {
    let mut world = world();
    let mut hits = 0;
    for case in Case::ALL {
        for episode in 0..25 {
            world.reset_case(11, episode, case);
            let mut expert = Expert::new(&world);
            while world.end() == End::Running {
                let action = expert.act(&world);
                world.step(action);
            }
            hits += u32::from(world.end() != End::Goal);
        }
    }
    assert!(hits <= 3, "{hits} of 150 rounds miss the goal");
}

#[test]
fn people_are_safe_in_clear_weather_and_not_in_fog() {
    let scene = Scene::builtin("highway-fog").unwrap();
    let mut world = world();
    let mut hits = [0; 2];
    for (weather, fog) in [Fog::clear(), scene.fog()].into_iter().enumerate() {
        for id in 1..=Person::COUNT {
            let mut driver =
                SimulatedDriver::new(&Person::builtin(id).unwrap(), &fog, world.cockpit());
            for episode in 0..6 {
                let round = episode::run_silent(&mut world, &mut driver, 77, episode + 6 * id);
                hits[weather] += u32::from(round.collided);
            }
        }
    }
    assert!(hits[0] <= 6, "{} of 126 rounds in clear weather", hits[0]);
    assert!(hits[1] >= 50, "{} of 126 rounds in fog", hits[1]);
}

#[test]
fn a_trace_holds_every_step() {
    let mut world = world();
    let mut driver =
        SimulatedDriver::new(&Person::builtin(2).unwrap(), &Fog::clear(), world.cockpit());
    world.reset(1, 4);
    driver.reset(1, 4);
    let mut trace = Vec::new();
    let round = episode::run(
        &mut world,
        &mut driver,
        |_, _| Shown::default(),
        Some(&mut trace),
    );
    assert_eq!(trace.len(), round.steps as usize);
    let reward: f64 = trace
        .iter()
        .map(|step| f64::from(step.outcome.reward))
        .sum();
    assert!((reward - round.reward).abs() < 1e-9);
    assert_eq!(trace.last().unwrap().outcome.end, round.end);
}

/// An expert who sees nothing goes on as if the road were empty, whatever comes; one who sees as far as the LIDAR gets around it.
#[test]
fn an_expert_knows_only_what_is_in_its_sight() {
    let drive = |visible_m: f32| {
        let mut world = world();
        let mut expert = Expert::new(&world);
        let (mut collisions, mut actions) = (0, Vec::new());
        for case in Case::ALL {
            world.reset_case(11, case.number(), case);
            expert.reset(&world);
            while world.end() == End::Running {
                let action = expert.act_within(&world, &[visible_m; domains::highway::AZIMUTHS]);
                if world.steps() < 10 {
                    actions.push(action);
                }
                world.step(action);
            }
            collisions += usize::from(world.end() == End::Collision);
        }
        (collisions, actions)
    };
    let (blind, of_blind) = drive(0.0);
    let (seeing, _) = drive(domains::highway::LIDAR_RANGE_M);
    assert!(blind >= 4, "{blind} collisions of 6 with eyes shut");
    assert!(
        seeing + 3 <= blind,
        "{seeing} collisions seeing, {blind} blind"
    );
    // In the first second and a half every case of one seed looks alike to it, but for the lane.
    let (left, right) = of_blind.split_at(of_blind.len() / 2);
    for half in [left, right] {
        for own in half.chunks(10) {
            assert_eq!(own, &half[..10]);
        }
    }
}
