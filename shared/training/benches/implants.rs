//! Implants of a simulated person in each gridworld, from 4 and from 20 of their rounds. The self-model is untrained: how
//! long learning takes depends on its sizes and on the rounds, not on what it knows.
//!
//! `cargo bench -p training --bench implants`

use criterion::{Criterion, criterion_group, criterion_main};
use domains::discrete::{Discrete, Domain, Scene, Setting, SimulatedPerson, World};
use models::{Kind, SelfModel, Sizes};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use std::time::Duration;
use training::implants::{self, ImplantSettings};
use training::rounds::Rounds;

fn learn(c: &mut Criterion) {
    let mut group = c.benchmark_group("implants");
    group.sample_size(10).warm_up_time(Duration::from_millis(1));
    for domain in Domain::ALL {
        let scene = Scene::of(domain, Setting::Transfer);
        let words = models::words::shipped(domain).expect("shipped words");
        let mut world = World::new(&scene, &words).expect("as many words as sentences");
        let layout = Arc::new(world.layout().clone());
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let model = Arc::new(SelfModel::new(Sizes::of(&layout), layout, &mut rng));
        let mut person = SimulatedPerson::builtin(&scene, 1, &words).expect("a builtin person");
        for count in [4, 20] {
            let rounds = Rounds::record(&mut world, &mut person, 1, 0, count);
            let settings = ImplantSettings::of(domain.name());
            group.bench_function(format!("{}, {count} rounds", domain.name()), |b| {
                b.iter(|| {
                    implants::learn(&model, Kind::Mirror, &rounds, &settings, &mut |_, _| {})
                });
            });
        }
    }
}

criterion_group!(benches, learn);
criterion_main!(benches);
