//! The suite that every human model has to pass to be swappable (DESIGN §5), run over every kind.

mod support;

use models::observation::{
    AZIMUTHS, BANDS, EGO, PER_SECTOR, RANGE_M, SECTORS, on_display, sector_of,
};
use models::policy::ActionDistribution;
use models::{Beliefs, Communicated, HumanModel, Kind, Observations, Shape};
use nn::Tensor;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use support::{allocations, human_model};

/// Calls `check` with a model of every kind. Every test of this suite goes through here. `ideal` is for the gridworlds: `discrete.rs`
/// has it.
fn every_kind(check: impl Fn(&mut dyn HumanModel)) {
    for kind in Kind::ALL.into_iter().filter(|kind| *kind != Kind::Ideal) {
        let mut model = human_model(kind);
        assert_eq!(model.kind(), kind.name());
        check(&mut *model);
    }
}

/// One step's inputs for a batch of people.
struct Step {
    actions: Tensor,
    observations: Observations,
    communicated: Vec<Communicated>,
    noise: Vec<f32>,
}

/// Plausible steps: a third of the beams hit something, some sectors are shown or spoken of.
fn steps(latent: usize, batch: usize, count: usize, seed: u64) -> Vec<Step> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut random = |_| {
        let mut step = Step {
            actions: Tensor::new(2, batch),
            observations: Observations::new(&Shape::HIGHWAY, batch),
            communicated: vec![Communicated::default(); batch],
            noise: vec![0.0; latent * batch],
        };
        for j in 0..batch {
            for a in step.actions.column_mut(j) {
                *a = rng.random_range(-1.0..1.0);
            }
            let visual = step.observations.visual.column_mut(j);
            for (i, x) in visual.iter_mut().enumerate() {
                let hit = rng.random::<f32>() < 1.0 / 3.0;
                *x = match i < AZIMUTHS * BANDS {
                    true if hit => rng.random_range(0.1..1.0),
                    true => 0.0,
                    false => rng.random_range(-1.0..1.0),
                };
            }
            for x in step.observations.verbal.column_mut(j) {
                *x = rng.random_range(-2.0..2.0);
            }
            step.communicated[j] =
                Communicated::new(rng.random_range(0..64), rng.random_range(0..64));
        }
        nn::noise::fill(&mut step.noise, rng.random(), 1);
        step
    };
    (0..count).map(&mut random).collect()
}

/// Beliefs and action distributions after each step, as one long row of numbers a person.
fn follow(model: &mut dyn HumanModel, steps: &[Step], sampled: bool) -> Vec<Vec<f32>> {
    let batch = steps[0].communicated.len();
    let mut beliefs = Beliefs::new(model.latent(), batch);
    let mut distribution = ActionDistribution::new(2, batch);
    let mut rows = vec![Vec::new(); batch];
    for step in steps {
        let noise = sampled.then_some(&step.noise[..]);
        model.perceive(
            &mut beliefs,
            &step.actions,
            &step.observations,
            &step.communicated,
            noise,
        );
        model.act(&beliefs, &mut distribution);
        for (j, row) in rows.iter_mut().enumerate() {
            let tensors = [
                &beliefs.mean,
                &beliefs.deviation,
                &beliefs.z,
                &distribution.mean,
                &distribution.deviation,
            ];
            for tensor in tensors {
                row.extend_from_slice(tensor.column(j));
            }
        }
    }
    rows
}

/// The step as one of its people sees it.
fn alone(step: &Step, j: usize, latent: usize) -> Step {
    let one = |t: &Tensor| Tensor::from_slice(t.rows(), 1, t.column(j));
    Step {
        actions: one(&step.actions),
        observations: Observations {
            visual: one(&step.observations.visual),
            verbal: one(&step.observations.verbal),
        },
        communicated: vec![step.communicated[j]],
        noise: step.noise[j * latent..(j + 1) * latent].to_vec(),
    }
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
    every_kind(|model| {
        let latent = model.latent();
        for batch in [2, 7, 33] {
            let steps = steps(latent, batch, 4, 1);
            let together = follow(model, &steps, true);
            for (j, row) in together.iter().enumerate() {
                let own: Vec<Step> = steps.iter().map(|step| alone(step, j, latent)).collect();
                // Products sum in another order for one column than for many.
                assert_close(
                    &follow(model, &own, true)[0],
                    row,
                    &format!("person {j} of {batch}"),
                );
            }
        }
    });
}

#[test]
fn people_of_a_batch_do_not_know_of_each_other() {
    every_kind(|model| {
        let latent = model.latent();
        let steps = steps(latent, 5, 3, 2);
        let mut changed = self::steps(latent, 5, 3, 2);
        for step in &mut changed {
            step.actions.column_mut(1).fill(0.9);
            step.observations.visual.column_mut(1).fill(0.5);
            step.communicated[1] = Communicated::new(63, 63);
        }
        let (before, after) = (follow(model, &steps, true), follow(model, &changed, true));
        for j in [0, 2, 3, 4] {
            assert_eq!(before[j], after[j], "person {j}");
        }
        assert_ne!(before[1], after[1]);
    });
}

/// Azimuths that person `j` does not perceive: everything there lies beyond what they see, and nothing shows it.
fn unseen(model: &dyn HumanModel, step: &Step, j: usize) -> Vec<usize> {
    let limits = model.visible_m();
    let visual = step.observations.visual.column(j);
    let is_unseen = |azimuth: &usize| {
        let a = *azimuth;
        let nearest = (0..BANDS)
            .map(|band| visual[band * AZIMUTHS + a])
            .fold(0.0, f32::max);
        let shown = on_display(a) && step.communicated[j].visual(sector_of(a));
        RANGE_M * (1.0 - nearest) > limits[a] && !shown
    };
    (0..AZIMUTHS).filter(is_unseen).collect()
}

#[test]
fn what_is_masked_cannot_change_a_belief() {
    every_kind(|model| {
        let latent = model.latent();
        let batch = 6;
        let original = steps(latent, batch, 4, 3);
        let mut changed = steps(latent, batch, 4, 3);
        let limits = model.visible_m();
        let mut hidden = 0;
        for step in &mut changed {
            for j in 0..batch {
                for azimuth in unseen(model, step, j) {
                    // Any other place beyond the threshold looks the same.
                    let beyond = 0.9 * (1.0 - limits[azimuth] / RANGE_M);
                    for band in 0..BANDS {
                        let value =
                            beyond * (band as f32 + azimuth as f32) / (BANDS + AZIMUTHS) as f32;
                        step.observations.visual.column_mut(j)[band * AZIMUTHS + azimuth] = value;
                    }
                    hidden += 1;
                }
                for sector in (0..SECTORS).filter(|s| !step.communicated[j].verbal(*s)) {
                    // What is not spoken is not heard, whatever it would have been.
                    let words = sector * PER_SECTOR..(sector + 1) * PER_SECTOR;
                    step.observations.verbal.column_mut(j)[words].fill(f32::NAN);
                    hidden += 1;
                }
            }
        }
        assert!(hidden > 0, "the test hides something from {}", model.kind());
        assert_eq!(
            follow(model, &original, true),
            follow(model, &changed, true),
            "{}",
            model.kind()
        );
    });
}

#[test]
fn what_is_communicated_changes_a_belief() {
    every_kind(|model| {
        let latent = model.latent();
        let silent = |steps: &mut Vec<Step>| {
            for step in steps {
                step.communicated.fill(Communicated::default());
            }
        };
        let mut quiet = steps(latent, 3, 1, 4);
        silent(&mut quiet);
        for sector in 0..SECTORS {
            let mut spoken = steps(latent, 3, 1, 4);
            silent(&mut spoken);
            spoken[0].communicated[1] = Communicated::new(0, 1 << sector);
            let (before, after) = (follow(model, &quiet, false), follow(model, &spoken, false));
            assert_ne!(
                before[1],
                after[1],
                "{}: words about sector {sector}",
                model.kind()
            );
            assert_eq!([&before[0], &before[2]], [&after[0], &after[2]]);
        }
        // A highlight shows what is beyond the thresholds, and only where the display reaches.
        for azimuth in 0..AZIMUTHS {
            let step = |visual: u32| {
                let mut step = alone(&quiet[0], 0, latent);
                let column = step.observations.visual.column_mut(0);
                column[..AZIMUTHS * BANDS].fill(0.0);
                column[azimuth] = 0.3; // 28 m away
                step.communicated[0] = Communicated::new(visual, 0);
                vec![step]
            };
            let limit_m = model.visible_m()[azimuth];
            let differs = follow(model, &step(0), false) != follow(model, &step(63), false);
            assert_eq!(
                differs,
                limit_m < 28.0 && on_display(azimuth),
                "{}: azimuth {azimuth}",
                model.kind()
            );
        }
    });
}

#[test]
fn same_seed_same_bytes() {
    every_kind(|model| {
        let latent = model.latent();
        let kind = Kind::parse(model.kind()).expect("a kind of ours");
        let steps = steps(latent, 9, 5, 5);
        let first = follow(model, &steps, true);
        // Neither the scratch memory of earlier calls nor other batch sizes in between may leave a trace.
        follow(model, &self::steps(latent, 17, 2, 6), true);
        assert_eq!(first, follow(model, &steps, true));
        assert_eq!(first, follow(&mut *human_model(kind), &steps, true));
        assert_ne!(first, follow(model, &self::steps(latent, 9, 5, 7), true));
    });
}

#[test]
fn outputs_are_finite_at_extreme_inputs() {
    every_kind(|model| {
        let latent = model.latent();
        let extremes = [0.0, -0.0, 1.0, -1.0, 1e6, -1e6, 1e-30, f32::MIN_POSITIVE];
        for (i, value) in extremes.into_iter().enumerate() {
            for communicated in [
                Communicated::default(),
                Communicated::new(63, 63),
                Communicated(u32::MAX),
            ] {
                let mut extreme = steps(latent, 2, 3, i as u64);
                for step in &mut extreme {
                    step.observations.visual.fill(value);
                    step.observations.verbal.fill(value);
                    step.actions.fill(value.clamp(-1.0, 1.0));
                    step.communicated.fill(communicated);
                }
                for row in follow(model, &extreme, true) {
                    assert!(
                        row.iter().all(|x| x.is_finite()),
                        "{} at {value}",
                        model.kind()
                    );
                }
            }
        }
    });
}

#[test]
fn deviations_are_positive_and_the_mean_is_carried_without_noise() {
    every_kind(|model| {
        let latent = model.latent();
        let steps = steps(latent, 4, 3, 8);
        let mut beliefs = Beliefs::new(model.latent(), 4);
        let mut distribution = ActionDistribution::new(2, 4);
        for step in &steps {
            model.perceive(
                &mut beliefs,
                &step.actions,
                &step.observations,
                &step.communicated,
                None,
            );
            model.act(&beliefs, &mut distribution);
            assert_eq!(beliefs.z, beliefs.mean);
            assert!(!beliefs.fresh);
            assert!(distribution.deviation.data().iter().all(|d| *d > 0.0));
            assert!(beliefs.deviation.data().iter().all(|d| *d >= 0.0));
        }
    });
}

#[test]
fn a_new_episode_forgets_the_last() {
    every_kind(|model| {
        let latent = model.latent();
        let steps = steps(latent, 3, 2, 9);
        let mut beliefs = Beliefs::new(model.latent(), 3);
        let mut perceive = |beliefs: &mut Beliefs, step: &Step| {
            let Step {
                actions,
                observations,
                communicated,
                noise,
            } = step;
            model.perceive(beliefs, actions, observations, communicated, Some(noise));
            beliefs.z.clone()
        };
        let first = perceive(&mut beliefs, &steps[0]);
        assert_ne!(first, perceive(&mut beliefs, &steps[1]));
        beliefs.reset();
        assert_eq!(first, perceive(&mut beliefs, &steps[0]));
    });
}

#[test]
fn nothing_allocates_after_the_first_call() {
    every_kind(|model| {
        let latent = model.latent();
        let steps = steps(latent, 64, 3, 10);
        let mut beliefs = Beliefs::new(model.latent(), 64);
        let mut distribution = ActionDistribution::new(2, 64);
        let mut actions = Tensor::new(2, 64);
        let mut before = 0;
        // The first step of an episode has its own network: two rounds warm both up.
        for round in 0..3 {
            if round == 2 {
                before = allocations();
            }
            beliefs.reset();
            for step in &steps {
                model.perceive(
                    &mut beliefs,
                    &step.actions,
                    &step.observations,
                    &step.communicated,
                    Some(&step.noise),
                );
                model.act(&beliefs, &mut distribution);
                distribution.sample(Some(&step.noise), &mut actions);
            }
        }
        assert_eq!(allocations() - before, 0, "{}", model.kind());
    });
}

#[test]
fn what_a_model_thinks_is_visible_lies_within_the_lidars_range() {
    every_kind(|model| {
        let visible = model.visible_m();
        assert!(
            visible.iter().all(|m| (0.0..=RANGE_M).contains(m)),
            "{visible:?}"
        );
    });
    assert_eq!(human_model(Kind::Myself).visible_m(), [RANGE_M; AZIMUTHS]);
    assert_ne!(human_model(Kind::Mirror).visible_m(), [RANGE_M; AZIMUTHS]);
    assert_eq!(EGO + AZIMUTHS * BANDS, Shape::HIGHWAY.visual);
}
