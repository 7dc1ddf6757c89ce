//! The suite that every human model has to pass to be swappable, over every kind in every domain.

mod support;

use domains::highway::speech::{displayable, sector_of};
use domains::highway::{AZIMUTHS, BEAMS, LIDAR_RANGE_M};
use models::{ActionDistribution, Beliefs, Communicated, HumanModel, Kind, Observations};
use nn::Tensor;
use support::{Domain, Step, allocations, follow};

/// Calls `check` with a model of every kind that a domain has. Every test of this suite goes through here.
fn every_model(check: impl Fn(&mut dyn HumanModel, &Domain)) {
    let mut checked = 0;
    for domain in Domain::all() {
        for kind in Kind::ALL {
            let Some(mut model) = domain.human(kind) else {
                assert_eq!((kind, domain.name()), (Kind::Ideal, "highway"));
                continue;
            };
            assert_eq!(model.kind(), kind.name());
            check(&mut *model, &domain);
            checked += 1;
        }
    }
    assert_eq!(checked, 4 * Kind::ALL.len() - 1);
}

fn assert_close(a: &[f32], b: &[f32], what: &str) {
    assert_eq!(a.len(), b.len());
    for (i, (a, b)) in a.iter().zip(b).enumerate() {
        assert!(
            (a - b).abs() <= 2e-5 * (1.0 + a.abs()),
            "{what}: number {i} is {a} and {b}"
        );
    }
}

#[test]
fn a_batch_is_the_same_as_one_by_one() {
    every_model(|model, domain| {
        for batch in [2, 7, 33] {
            let steps = domain.steps(model, batch, 4, 1);
            let together = follow(model, &steps);
            for (j, row) in together.iter().enumerate() {
                let own: Vec<Step> = steps.iter().map(|step| step.alone(j)).collect();
                // Products sum in another order for one column than for many.
                let what = format!(
                    "{} in {}: person {j} of {batch}",
                    model.kind(),
                    domain.name()
                );
                assert_close(&follow(model, &own)[0], row, &what);
            }
        }
    });
}

#[test]
fn people_of_a_batch_do_not_know_of_each_other() {
    every_model(|model, domain| {
        let steps = domain.steps(model, 5, 3, 2);
        let mut changed = domain.steps(model, 5, 3, 2);
        for step in &mut changed {
            step.observations.visual.column_mut(1).fill(0.5);
            step.communicated[1] = Communicated::items(domain.layout.communicable);
        }
        let (before, after) = (follow(model, &steps), follow(model, &changed));
        for j in [0, 2, 3, 4] {
            assert_eq!(before[j], after[j], "{}: person {j}", model.kind());
        }
        assert_ne!(before[1], after[1]);
    });
}

/// What a person of the model's limits does not see, hear or get told may be anything.
#[test]
fn what_is_masked_cannot_change_a_belief() {
    every_model(|model, domain| {
        let layout = &domain.layout;
        let limits = model.limits().to_vec();
        if limits.is_empty() {
            return; // `ideal` perceives by itself: tests/ideal.rs
        }
        let original = domain.steps(model, 6, 4, 3);
        let mut changed = domain.steps(model, 6, 4, 3);
        let mut hidden = 0;
        for step in &mut changed {
            for j in 0..6 {
                let chance = (step.chance.rows() > 0).then(|| step.chance.column(j));
                let visual = step.observations.visual.column_mut(j);
                let seen = layout.perception.seen(&limits, visual, chance);
                // Whatever a highlight might show stays as it is.
                let full = vec![1.0; visual.len()];
                let mask = layout.overlay(seen, 0, step.communicated[j].bits(), &full);
                for (i, x) in visual.iter_mut().enumerate() {
                    if !layout.is_seen(i, mask) {
                        *x = domain.elsewhere(i, *x, &limits);
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
        assert!(hidden > 0, "something is hidden from {}", model.kind());
        let (before, after) = (follow(model, &original), follow(model, &changed));
        assert!(before == after, "{} in {}", model.kind(), domain.name());
    });
}

#[test]
fn what_is_said_changes_a_belief() {
    every_model(|model, domain| {
        let mut quiet = domain.steps(model, 3, 1, 4);
        quiet[0].communicated.fill(Communicated::default());
        let before = follow(model, &quiet);
        for utterance in 0..domain.layout.utterances {
            let mut spoken = domain.steps(model, 3, 1, 4);
            spoken[0].communicated.fill(Communicated::default());
            spoken[0].communicated[1] = Communicated::new(0, 1 << utterance);
            let after = follow(model, &spoken);
            assert_ne!(before[1], after[1], "{} {utterance}", model.kind());
            assert_eq!([&before[0], &before[2]], [&after[0], &after[2]]);
        }
    });
}

/// A highlight shows what is beyond the limits, and only where the display reaches and there is a car.
#[test]
fn highlights_show_what_the_display_reaches() {
    every_model(|model, domain| {
        if domain.gridworld.is_some() {
            return;
        }
        let quiet = domain.steps(model, 1, 1, 4);
        for azimuth in 0..AZIMUTHS {
            for nearness in [0.3, 0.04] {
                let step = |visual: u32| {
                    let mut step = quiet[0].alone(0);
                    let column = step.observations.visual.column_mut(0);
                    column[..BEAMS].fill(0.0);
                    column[azimuth] = nearness;
                    step.communicated[0] = Communicated::new(visual, 0);
                    vec![step]
                };
                let is_seen = model.limits()[azimuth] >= LIDAR_RANGE_M * (1.0 - nearness);
                let differs =
                    follow(model, &step(0)) != follow(model, &step(1 << sector_of(azimuth)));
                let shown = !is_seen && displayable(azimuth) && nearness > 0.05;
                assert_eq!(differs, shown, "{}: azimuth {azimuth}", model.kind());
            }
        }
    });
}

#[test]
fn same_inputs_same_bytes_and_nothing_left_over() {
    every_model(|model, domain| {
        let kind = Kind::parse(model.kind()).expect("a kind of ours");
        let steps = domain.steps(model, 9, 5, 5);
        let first = follow(model, &steps);
        // Neither the scratch memory of earlier calls nor other batch sizes in between may leave a trace.
        let others = domain.steps(model, 17, 2, 6);
        follow(model, &others);
        assert_eq!(first, follow(model, &steps));
        let mut fresh = domain.human(kind).expect("as before");
        assert_eq!(first, follow(&mut *fresh, &steps));
        let different = domain.steps(model, 9, 5, 7);
        assert_ne!(first, follow(model, &different));
    });
}

#[test]
fn outputs_are_finite_at_extreme_inputs() {
    every_model(|model, domain| {
        let extremes = [0.0, -0.0, 1.0, -1.0, 1e6, -1e6, 1e-30, f32::MIN_POSITIVE];
        for (i, value) in extremes.into_iter().enumerate() {
            let all = Communicated::items(domain.layout.communicable);
            for told in [Communicated::default(), all, Communicated(u32::MAX)] {
                let mut extreme = domain.steps(model, 2, 3, i as u64);
                for step in &mut extreme {
                    step.observations.visual.fill(value);
                    step.observations.verbal.fill(value);
                    step.communicated.fill(told);
                }
                for row in follow(model, &extreme) {
                    let what = (model.kind(), domain.name(), value);
                    assert!(row.iter().all(|x| x.is_finite()), "{what:?}");
                }
            }
        }
    });
}

#[test]
fn the_mean_is_carried_without_noise() {
    every_model(|model, domain| {
        let steps = domain.steps(model, 4, 3, 8);
        let mut beliefs = Beliefs::new(model.latent(), 4);
        for step in &steps {
            let (actions, observations) = (&step.actions, &step.observations);
            model.perceive(
                &mut beliefs,
                actions,
                observations,
                &step.communicated,
                None,
            );
            assert_eq!(beliefs.z, beliefs.mean);
            assert!(!beliefs.fresh);
            assert!(beliefs.deviation.data().iter().all(|d| *d >= 0.0));
        }
    });
}

#[test]
fn a_new_episode_forgets_the_last_and_nothing_allocates_after_the_first() {
    every_model(|model, domain| {
        let steps = domain.steps(model, 64, 3, 9);
        let noise: Vec<Vec<f32>> = steps.iter().map(Step::noise).collect();
        let mut beliefs = Beliefs::new(model.latent(), 64);
        let mut distribution = ActionDistribution::new(model.actions(), 64);
        let mut actions = Tensor::new(model.actions().rows(), 64);
        let (mut before, mut first) = (0, None);
        // The first step of an episode has its own network: two rounds warm both up.
        for round in 0..3 {
            if round == 2 {
                before = allocations();
            }
            beliefs.reset();
            for (step, noise) in steps.iter().zip(&noise) {
                let (acted, observations) = (&step.actions, &step.observations);
                let told = &step.communicated;
                model.perceive(&mut beliefs, acted, observations, told, Some(noise));
                model.act(&beliefs, &mut distribution);
                distribution.sample(Some(noise), &mut actions);
            }
            if round < 2 {
                let again = beliefs.mean.clone();
                assert_eq!(first.get_or_insert(again.clone()), &again);
            }
        }
        let what = (model.kind(), domain.name());
        assert_eq!(allocations() - before, 0, "{what:?}");
    });
}

/// What a model says of the person's sight fits the domain.
#[test]
fn limits_are_the_domains() {
    every_model(|model, domain| {
        let (limits, perception) = (model.limits(), domain.layout.perception);
        if model.kind() == Kind::Ideal.name() {
            assert!(limits.is_empty());
            return;
        }
        assert_eq!(limits.len(), perception.limits());
        let unlimited = model.kind() == Kind::Myself.name();
        assert_eq!(limits.iter().all(|limit| limit.is_infinite()), unlimited);
        assert!(limits.iter().all(|limit| *limit >= 0.0));
    });
}

/// An observation of the wrong shape cannot be made by mistake.
#[test]
fn shapes_follow_from_layouts() {
    for domain in Domain::all() {
        let shape = domain.shape();
        let observations = Observations::new(&shape, 3);
        assert_eq!(observations.batch(), 3);
        assert_eq!(domain.layout.visual_region.len(), shape.visual);
        assert_eq!(domain.layout.verbal_utterance.len(), shape.verbal);
        assert_eq!(domain.self_model(1).view.rows(), shape.encoded());
    }
}
