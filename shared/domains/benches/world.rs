//! Speed of the highway world: `cargo bench -p domains`. The budget is 50,000 steps a second with 50 cars.

use std::hint::black_box;
use std::sync::Arc;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use domains::highway::scene::ExtraCar;
use domains::highway::{Expert, Observation, Person, Scene, Shown, SimulatedDriver, World};

/// The shipped road with 46 more cars around the ego car, all as fast as it: they stay in LIDAR range.
fn crowded() -> Scene {
    let mut scene = Scene::default();
    scene.road.lanes = 4;
    scene.road.segments = vec![domains::highway::road::Segment {
        length_m: 20_000.0,
        curvature_per_m: 0.0,
    }];
    scene.episode.goal_s_m = 1e6;
    scene.episode.max_steps = 1_000_000;
    scene.ego.start_s_m = 200.0;
    let place = |index: usize| (index % 4, 120.0 + 14.0 * (index / 4) as f64);
    let free = |&(lane, s): &(usize, f64)| lane > 1 || (s - 200.0f64).abs() > 10.0;
    scene.traffic.extra = (0..)
        .map(place)
        .filter(free)
        .take(46)
        .map(|(lane, start_s_m)| ExtraCar {
            lane,
            start_s_m,
            speed_kmh: 30.0,
        })
        .collect();
    scene
}

/// One step and its observation, keeping a steady 30 km/h in the lane.
fn step(world: &mut World, observation: &mut Observation) {
    let speed = observation.ego[1] * 40.0;
    let steer = -0.5 * observation.ego[2] - 10.0 * observation.ego[0];
    black_box(world.step([0.5 * (30.0 - speed), 0.1 * steer]));
    world.observe(observation);
    if world.end() != domains::highway::End::Running {
        world.reset(1, 0);
    }
}

fn highway(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("highway");
    group.throughput(Throughput::Elements(1));
    for (name, scene) in [
        ("step, 50 cars", crowded()),
        ("step, 4 cars", Scene::default()),
    ] {
        let mut world = World::new(Arc::new(scene)).expect("a road");
        let mut observation = Observation::default();
        world.reset(1, 0);
        for _ in 0..40 {
            step(&mut world, &mut observation);
        }
        group.bench_function(name, |bencher| {
            bencher.iter(|| step(&mut world, &mut observation))
        });
        println!("{name}: {} cars", world.objects().len());
    }
    let scene = Scene::builtin("highway-fog").expect("it ships");
    let mut world = World::new(Arc::new(scene.clone())).expect("a road");
    world.reset(1, 0);
    for _ in 0..20 {
        world.step([1.0, 0.0]);
    }
    let mut driver = SimulatedDriver::new(
        &Person::builtin(1).expect("it ships"),
        &scene.fog(),
        world.cockpit(),
    );
    driver.reset(1, 0);
    group.bench_function("simulated driver", |bencher| {
        bencher.iter(|| black_box(driver.act(world.observation(), &Shown::default())));
    });
    let mut expert = Expert::new(&world);
    group.bench_function("expert", |bencher| {
        bencher.iter(|| black_box(expert.act(&world)))
    });
    group.finish();
}

criterion_group!(benches, highway);
criterion_main!(benches);
