//! Following one real person by several hypotheses about them, in every domain.

mod support;

use models::{Beliefs, Communicated, FollowedPerson, HumanModel, Posterior, SelfHuman, SelfModel};
use std::sync::Arc;
use support::{Domain, allocations, posterior};

fn human(model: &Arc<SelfModel>, posterior: &Posterior) -> SelfHuman {
    SelfHuman::new(Arc::clone(model), Some(posterior.clone()), 0)
}

/// One hypothesis of a posterior, held for certain.
fn only(posterior: &Posterior, h: usize) -> Posterior {
    Posterior {
        hypotheses: vec![posterior.hypotheses[h].clone()],
        weights: vec![1.0],
        ..posterior.clone()
    }
}

/// Lets a person live through `steps` and gives the log-probabilities of what they did.
fn live(human: &mut SelfHuman, domain: &Domain, steps: usize) -> (FollowedPerson, Vec<f32>) {
    let mut person = FollowedPerson::new(human, &domain.shape());
    let inputs = domain.steps(human, 1, steps, 4);
    let mut densities = Vec::new();
    for (t, input) in inputs.iter().enumerate() {
        let sensed = (
            input.observations.visual.column(0),
            input.observations.verbal.column(0),
        );
        let taken = input.actions.column(0);
        if t > 0 {
            densities.push(person.expected().log_density(0, taken));
        }
        let told = Communicated::default();
        person.perceive(human, sensed, told, taken, [1, 2, t as u64]);
    }
    (person, densities)
}

#[test]
fn each_hypothesis_is_followed_as_if_it_were_the_only_one() {
    for domain in Domain::all() {
        let model = Arc::new(domain.self_model(1));
        let all = posterior(&model, true, 4);
        let mut together = human(&model, &all);
        if together.samples() > 1 {
            continue; // samples of different hypotheses are drawn with different chance
        }
        let (person, _) = live(&mut together, &domain, 5);
        assert_eq!(person.beliefs.hypothesis, [0, 1, 2, 3]);
        assert_eq!(person.beliefs.weight, all.weights);
        for h in 0..4 {
            let (alone, _) = live(&mut human(&model, &only(&all, h)), &domain, 5);
            let (own, other) = (person.beliefs.mean.column(h), alone.beliefs.mean.column(0));
            for (own, other) in own.iter().zip(other) {
                let what = domain.name();
                assert!((own - other).abs() < 1e-4 * (1.0 + own.abs()), "{what} {h}");
            }
        }
    }
}

/// What is expected of the person is the mixture of what the hypotheses expect.
#[test]
fn expectations_are_mixed_by_probability() {
    for domain in Domain::all() {
        let model = Arc::new(domain.self_model(1));
        let all = posterior(&model, true, 3);
        let mut together = human(&model, &all);
        if together.samples() > 1 {
            continue;
        }
        let (person, _) = live(&mut together, &domain, 3);
        let each: Vec<_> = (0..3)
            .map(|h| live(&mut human(&model, &only(&all, h)), &domain, 3).0)
            .collect();
        if let Some(log) = person.expected().log_probability() {
            for (a, log) in log.column(0).iter().enumerate() {
                let mixed: f32 = each
                    .iter()
                    .zip(&all.weights)
                    .map(|(p, w)| w * p.expected().log_probability().unwrap().column(0)[a].exp())
                    .sum();
                assert!((log.exp() - mixed).abs() < 1e-4, "{}", domain.name());
            }
        } else {
            let (mean, deviation) = person.expected().gaussian().unwrap();
            let of = |p: &FollowedPerson| {
                let (mean, deviation) = p.expected().gaussian().unwrap();
                (mean.column(0)[0], deviation.column(0)[0])
            };
            let mixed: f32 = each
                .iter()
                .zip(&all.weights)
                .map(|(p, w)| w * of(p).0)
                .sum();
            let square: f32 = each
                .iter()
                .zip(&all.weights)
                .map(|(p, w)| w * (of(p).0.powi(2) + of(p).1.powi(2)))
                .sum();
            assert!((mean.column(0)[0] - mixed).abs() < 1e-4);
            let expected = (square - mixed * mixed).sqrt();
            assert!((deviation.column(0)[0] - expected).abs() < 1e-3);
        }
    }
}

/// Where it is chance what is noticed, each hypothesis has samples, which what the person does tells apart; the hypotheses themselves
/// stay as probable as they were.
#[test]
fn samples_are_weighed_within_their_hypothesis() {
    let mut checked = 0;
    for domain in Domain::all() {
        let model = Arc::new(domain.self_model(1));
        let all = posterior(&model, true, 3);
        let mut together = human(&model, &all);
        let samples = together.samples();
        if samples == 1 {
            continue;
        }
        checked += 1;
        let (person, _) = live(&mut together, &domain, 6);
        let weights = &person.beliefs.weight;
        assert_eq!(weights.len(), 3 * samples);
        for (own, whole) in weights.chunks_exact(samples).zip(&all.weights) {
            let sum: f32 = own.iter().sum();
            assert!((sum - whole).abs() < 1e-5, "{sum} of {whole}");
            assert!(own.iter().any(|w| (w - own[0]).abs() > 1e-6), "all alike");
        }
    }
    assert_eq!(
        checked, 1,
        "bomb defusal's perception is a matter of chance"
    );
}

/// Imagined people go by hypotheses as often as these are probable.
#[test]
fn imagined_people_are_drawn_by_probability() {
    let domain = Domain::highway();
    let model = Arc::new(domain.self_model(1));
    let all = posterior(&model, true, 4);
    let (person, _) = live(&mut human(&model, &all), &domain, 2);
    let mut imagined = Beliefs::new(model.sizes.latent, 0);
    for count in [10, 100, 1000] {
        let noise = vec![0.0; model.sizes.latent * count];
        imagined.spread(&person.beliefs, count, &noise, |j| j);
        for (h, weight) in all.weights.iter().enumerate() {
            let drawn = imagined.hypothesis.iter().filter(|d| **d as usize == h);
            let off = drawn.count() as f32 - weight * count as f32;
            assert!(
                off.abs() <= 2.0,
                "hypothesis {h} of {count} people: off by {off}"
            );
        }
        for (j, h) in imagined.hypothesis.iter().enumerate() {
            assert_eq!(
                imagined.z.column(j),
                person.beliefs.mean.column(*h as usize)
            );
        }
    }
}

#[test]
fn nothing_allocates_after_the_first_steps() {
    for domain in Domain::all() {
        let model = Arc::new(domain.self_model(1));
        let mut human = human(&model, &posterior(&model, true, 6));
        let mut person = FollowedPerson::new(&human, &domain.shape());
        let inputs = domain.steps(&human, 1, 4, 4);
        let mut before = 0;
        for round in 0..3 {
            if round == 2 {
                before = allocations();
            }
            person.reset(&human);
            for (t, input) in inputs.iter().enumerate() {
                let sensed = (
                    input.observations.visual.column(0),
                    input.observations.verbal.column(0),
                );
                let (told, taken) = (Communicated::default(), input.actions.column(0));
                person.perceive(&mut human, sensed, told, taken, [1, 2, t as u64]);
            }
        }
        assert_eq!(allocations() - before, 0, "{}", domain.name());
    }
}
