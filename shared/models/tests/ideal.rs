//! The simulated person's own model: it believes what they believe, and reads no more than they do.

mod support;

use domains::Mask;
use domains::discrete::{Discrete, Domain as Gridworld, Mind};
use models::{ActionDistribution, Beliefs, Communicated, HumanModel, Observations};
use nn::Tensor;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use support::{Domain, follow, world};

/// What chance does not decide, the ideal model believes as the person does, in every step of their rounds.
#[test]
fn the_ideal_model_follows_the_person() {
    for domain in [Gridworld::Driving, Gridworld::SearchRescue] {
        let place = Domain::gridworld(domain);
        let (mut person, mut model) = place.ideal().expect("a gridworld");
        let mut world = world(domain);
        let layout = world.layout().clone();
        let shape = place.shape();
        let mut observations = Observations::new(&shape, 1);
        let mut beliefs = Beliefs::new(model.latent(), 1);
        let mut noise = Tensor::new(model.noise_rows(), 1);
        let mut rng = ChaCha8Rng::seed_from_u64(12);
        let (mut moments, mut known) = (0, 0);
        for episode in 0..12 {
            world.reset(8, episode, episode);
            person.reset(8, episode);
            beliefs.reset();
            let mut actions = Tensor::new(layout.actions.rows(), 1);
            while world.end().is_running() {
                let Observations { visual, verbal } = &mut observations;
                world.observe(visual.column_mut(0), verbal.column_mut(0));
                let all = layout.communicable;
                let told = Mask {
                    visual: all.visual & rng.random::<u64>() & rng.random::<u64>(),
                    verbal: all.verbal & rng.random::<u32>() & rng.random::<u32>(),
                };
                let seen = person.look(visual.column(0));
                person.perceive(visual.column(0), verbal.column(0), seen | told);
                nn::noise::fill(noise.data_mut(), rng.random(), 1);
                let chance = Some(noise.data());
                model.perceive(
                    &mut beliefs,
                    &actions,
                    &observations,
                    &[Communicated::items(told)],
                    chance,
                );
                let mut memory = vec![0.0; person.memory_len()];
                person.write_memory(&mut memory);
                let mut believed = beliefs.z.column(0)[..memory.len()].to_vec();
                if domain == Gridworld::SearchRescue {
                    // Where a searcher is heading, and so came from, is in their head.
                    for chance in [2, 3] {
                        (memory[chance], believed[chance]) = (0.0, 0.0);
                    }
                }
                assert_eq!(believed, memory, "{domain:?}, round {episode}");
                known += usize::from(memory.iter().any(|x| *x != 0.0));
                moments += 1;
                let action = person.act();
                actions.fill(0.0);
                actions.column_mut(0)[action] = 1.0;
                world.step(action);
            }
        }
        assert!(moments > 60 && known > 30, "{domain:?}: {moments} {known}");
    }
}

/// Where chance decides what they notice, and where they are heading is in their head, the model guesses; what they then do corrects it:
/// nobody is long held for impossible.
#[test]
fn the_ideal_model_learns_from_what_people_do() {
    for domain in [Gridworld::SearchRescue, Gridworld::BombDefusal] {
        let place = Domain::gridworld(domain);
        let (mut person, mut model) = place.ideal().expect("a gridworld");
        let mut world = world(domain);
        let layout = world.layout().clone();
        let mut observations = Observations::new(&place.shape(), 1);
        let mut beliefs = Beliefs::new(model.latent(), 1);
        let mut expected = ActionDistribution::new(model.actions(), 1);
        let mut noise = Tensor::new(model.noise_rows(), 1);
        let (mut moments, mut longest) = (0, 0);
        for episode in 0..30 {
            world.reset(4, episode, episode);
            person.reset(4, episode);
            beliefs.reset();
            let mut in_a_row = 0;
            let mut actions = Tensor::new(layout.actions.rows(), 1);
            while world.end().is_running() {
                let Observations { visual, verbal } = &mut observations;
                world.observe(visual.column_mut(0), verbal.column_mut(0));
                let seen = person.look(visual.column(0));
                person.perceive(visual.column(0), verbal.column(0), seen);
                nn::noise::fill(noise.data_mut(), u64::from(episode), moments);
                let nothing = [Communicated::default()];
                let chance = Some(noise.data());
                model.perceive(&mut beliefs, &actions, &observations, &nothing, chance);
                model.act(&beliefs, &mut expected);
                let action = person.act();
                let surprised =
                    expected.log_probability().expect("choices").column(0)[action] < -10.0;
                in_a_row = if surprised { in_a_row + 1 } else { 0 };
                longest = longest.max(in_a_row);
                moments += 1;
                actions.fill(0.0);
                actions.column_mut(0)[action] = 1.0;
                world.step(action);
            }
        }
        // A defuser may be taken to have noticed at one step, and again at the next.
        assert!(
            moments > 100 && longest <= 4,
            "{domain:?}: {longest} of {moments}"
        );
    }
}

/// What the person neither sees nor is told may be anything to their own model, too.
#[test]
fn the_ideal_model_reads_no_more_than_the_person() {
    for domain in [Gridworld::Driving, Gridworld::SearchRescue] {
        let place = Domain::gridworld(domain);
        let (person, mut model) = place.ideal().expect("a gridworld");
        let layout = &place.layout;
        let (perception, limits) = (layout.perception, person.sight().limits.to_vec());
        let original = place.steps(&model, 4, 5, 6);
        let mut changed = place.steps(&model, 4, 5, 6);
        let mut hidden = 0;
        for step in &mut changed {
            for j in 0..4 {
                let told = step.communicated[j].mask();
                let visual = step.observations.visual.column_mut(j);
                let seen = told.visual | perception.seen(&limits, visual, None);
                let mask = Mask {
                    visual: seen,
                    ..told
                };
                for (i, x) in visual.iter_mut().enumerate() {
                    if !layout.is_seen(i, mask) {
                        // Driving's distances are themselves read from what is hidden: stay beyond the limit.
                        *x = if domain == Gridworld::Driving {
                            x.signum()
                        } else {
                            f32::NAN
                        };
                        hidden += 1;
                    }
                }
                let verbal = step.observations.verbal.column_mut(j).iter_mut();
                for (x, utterance) in verbal.zip(&layout.verbal_utterance) {
                    if !mask.hears((*utterance).into()) {
                        *x = f32::NAN;
                        hidden += 1;
                    }
                }
            }
        }
        assert!(hidden > 100);
        assert_eq!(follow(&mut model, &original), follow(&mut model, &changed));
    }
}
