//! Limits of sight mean to models what they mean to the domains' people, and choices are drawn as often as they should be.

mod support;

use domains::discrete::{Discrete, Domain as Gridworld};
use models::ActionDistribution;
use models::policy::largest;
use nn::Tensor;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use support::world;

/// The limits mean to our models what they mean to the domain's people.
#[test]
fn perception_is_the_domains_own() {
    use domains::{driving, search_rescue};
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    for domain in [Gridworld::Driving, Gridworld::SearchRescue] {
        let mut world = world(domain);
        let layout = world.layout().clone();
        let perception = layout.perception;
        let (mut visual, mut verbal) = (vec![0.0; layout.visual], vec![0.0; layout.verbal]);
        for episode in 0..60 {
            world.reset(3, episode, episode);
            for _ in 0..6 {
                world.observe(&mut visual, &mut verbal);
                let limits: Vec<f32> = (0..perception.limits())
                    .map(|_| rng.random_range(0..10) as f32 + 0.25)
                    .collect();
                let theirs = match domain {
                    Gridworld::Driving => {
                        driving::visible(&[limits[0], limits[1], limits[2], limits[3]], &visual)
                    }
                    _ => search_rescue::visible(limits[0], &visual),
                };
                assert_eq!(
                    perception.seen(&limits, &visual, None),
                    theirs,
                    "{domain:?} {limits:?}"
                );
                world.step(rng.random_range(0..layout.actions.rows()));
            }
        }
    }
}

/// With limits as probabilities, a terminal is noticed that often.
#[test]
fn chances_are_probabilities() {
    let layout = world(Gridworld::BombDefusal).layout().clone();
    let perception = layout.perception;
    let visual = vec![0.0; layout.visual];
    let limits = [0.05, 0.2, 0.5, 0.8, 0.95, 0.0];
    let mut noise = vec![0.0; perception.noise_rows()];
    let mut counts = [0_u32; 6];
    for draw in 0..20_000 {
        nn::noise::fill(&mut noise, 11, draw);
        let seen = perception.seen(&limits, &visual, Some(&noise));
        for (terminal, count) in counts.iter_mut().enumerate() {
            *count += (seen >> terminal & 1) as u32;
        }
    }
    for (count, p) in counts.iter().zip(limits) {
        let found = f64::from(*count) / 20_000.0;
        assert!((found - f64::from(p)).abs() < 0.015, "{found} for {p}");
    }
}

#[test]
fn choices_are_drawn_with_their_probabilities() {
    let mut log_probability = Tensor::new(4, 20_000);
    let p = [0.1_f32, 0.6, 0.05, 0.25];
    for column in log_probability.data_mut().chunks_exact_mut(4) {
        for (log, p) in column.iter_mut().zip(p) {
            *log = p.ln();
        }
    }
    let distribution = ActionDistribution::Categorical { log_probability };
    let mut noise = vec![0.0; 80_000];
    nn::noise::fill(&mut noise, 12, 0);
    let mut actions = Tensor::default();
    distribution.sample(Some(&noise), &mut actions);
    for (choice, p) in p.iter().enumerate() {
        let drawn = (0..20_000)
            .filter(|j| actions.column(*j)[choice] == 1.0)
            .count();
        let found = drawn as f32 / 20_000.0;
        assert!((found - p).abs() < 0.015, "{found} for {p}");
    }
    distribution.sample(None, &mut actions);
    assert_eq!(largest(actions.column(0)), 1);
}
