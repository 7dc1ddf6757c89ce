//! Speed of the gridworlds and of their people: `cargo bench -p domains --bench gridworlds`.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use domains::discrete::{Discrete, Domain, Mind, Scene, Setting, SimulatedPerson, Words, World};

fn gridworlds(criterion: &mut Criterion) {
    for domain in Domain::ALL {
        let scene = Scene::of(domain, Setting::Transfer);
        let words = Words::indicator(scene.sentences().len());
        let mut world = World::new(&scene, &words).unwrap();
        let mut person = SimulatedPerson::builtin(&scene, 1, &words).unwrap();
        let (mut visual, mut verbal) = (
            vec![0.0; world.layout().visual],
            vec![0.0; world.layout().verbal],
        );
        let mut group = criterion.benchmark_group(domain.name());
        group.throughput(Throughput::Elements(1));
        let mut round = 0;
        group.bench_function("step and observation", |bencher| {
            bencher.iter(|| {
                if !world.end().is_running() {
                    round += 1;
                    world.reset(1, round, round);
                }
                black_box(world.step((round % 2) as usize));
                world.observe(&mut visual, &mut verbal);
                black_box(visual[0])
            });
        });
        group.bench_function("expert", |bencher| {
            bencher.iter(|| black_box(world.expert()))
        });
        group.bench_function("clone of the world", |bencher| {
            bencher.iter(|| world.clone())
        });
        group.bench_function("person", |bencher| {
            bencher.iter(|| {
                if !world.end().is_running() {
                    round += 1;
                    world.reset(1, round, round);
                    person.reset(1, round);
                }
                let seen = person.look(&visual);
                person.perceive(&visual, &verbal, seen);
                black_box(person.act())
            });
        });
        group.finish();
    }
}

criterion_group!(benches, gridworlds);
criterion_main!(benches);
