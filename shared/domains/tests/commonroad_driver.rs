//! A simulated driver on real recorded traffic: the three recordings run to their ends.

mod commonroad_data;

use commonroad_data::{FIXTURE_2018B, FIXTURE_2020A, real_files};
use domains::commonroad::Scenario;
use domains::highway::control::Cockpit;
use domains::highway::episode::run_silent;
use domains::highway::{End, Person, SimulatedDriver, World};
use std::sync::Arc;

#[test]
fn a_simulated_driver_runs_to_the_end() {
    let mut scenarios: Vec<Scenario> = real_files()
        .iter()
        .map(|file| Scenario::read(file).unwrap())
        .collect();
    scenarios.push(Scenario::parse(FIXTURE_2018B.as_bytes(), "2018b").unwrap());
    scenarios.push(Scenario::parse(FIXTURE_2020A.as_bytes(), "2020a").unwrap());
    for scenario in scenarios {
        for fog_m in [None, Some(15.0)] {
            let scene = Arc::new(scenario.scene(fog_m, None).unwrap());
            let mut world = World::new(scene.clone()).unwrap();
            let cockpit = Cockpit::new(&scene, world.road(), world.ego().at.s_m);
            let (mut collisions, mut goals, mut steps, mut road_edge) = (0, 0, 0, 0);
            for id in 1..=Person::COUNT {
                let person = Person::builtin(id).unwrap();
                let mut driver = SimulatedDriver::new(&person, &scene.fog(), cockpit);
                let round = run_silent(&mut world, &mut driver, 1, 0);
                assert_ne!(round.end, End::Running);
                assert!(round.steps <= scene.episode.max_steps && round.reward.is_finite());
                collisions += u32::from(round.collided);
                road_edge += u32::from(round.other == domains::highway::world::ROAD_EDGE);
                goals += u32::from(round.end == End::Goal);
                steps += round.steps;
            }
            println!(
                "{} fog {fog_m:?}: {collisions} collisions ({road_edge} with the road's edge), {goals} goals, {} steps a round, limit {:.0} km/h, {} lanes",
                scenario.benchmark_id,
                steps / Person::COUNT,
                scene.ego.throttle_limit_kmh,
                cockpit.lanes,
            );
        }
    }
}
