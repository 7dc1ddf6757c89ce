//! One ELBO step of each gridworld's self-model: batch 32, 16 steps, forward, backward and Adam, in one thread; `python
//! tools/pytorch_bench.py --only gridworld_elbo_step` times driving's in PyTorch.
//!
//! `cargo bench -p training --bench elbo`

use criterion::{Criterion, criterion_group, criterion_main};
use domains::discrete::{Discrete, Domain, Scene, Setting, Words, World};
use models::self_model::Batch;
use models::{SelfModel, Sizes};
use nn::{Adam, Arena, Gradients, Tape, noise};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

fn elbo(c: &mut Criterion) {
    for domain in Domain::ALL {
        let scene = Scene::of(domain, Setting::Original);
        let words = Words::indicator(scene.sentences().len());
        let mut world = World::new(&scene, &words).expect("as many words as sentences");
        let layout = Arc::new(world.layout().clone());
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut model = SelfModel::new(Sizes::of(&layout), Arc::clone(&layout), &mut rng);
        let mut batch = Batch::new(&model, 16, 32);
        noise::fill(batch.noise.data_mut(), 1, 2);
        batch.weight.fill(1.0);
        for at in 0..16 * 32 {
            if at % 16 == 0 {
                world.reset(1, at as u32, at as u32);
            }
            let (visual, verbal) = (batch.visual.column_mut(at), batch.verbal.column_mut(at));
            world.observe(visual, verbal);
            let out = batch.observed.column_mut(at);
            model.view.write(visual, verbal, layout.everything(), out);
            let action = world.expert();
            batch.action.column_mut(at)[action] = 1.0;
            batch.reward.data_mut()[at] = world.step(action).reward;
        }
        let ids = model.parameters.ids().collect();
        let mut adam = Adam::new(&model.parameters, ids, 3e-4);
        let mut gradients = Gradients::for_params(&model.parameters);
        let mut arena = Arena::new();
        c.bench_function(&format!("ELBO step, {}", domain.name()), |b| {
            b.iter(|| {
                gradients.zero();
                let mut tape = Tape::new(&model.parameters, &mut arena);
                let terms = model.negative_elbo(&mut tape, &batch);
                tape.backward(terms.loss, &mut gradients, &|_| true);
                adam.step(&mut model.parameters, &gradients);
            });
        });
    }
}

criterion_group!(benches, elbo);
criterion_main!(benches);
