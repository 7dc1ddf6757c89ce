//! Maximum-entropy IRL recovers the weights of a known soft-optimal agent.

use domains::discrete::{Discrete, Scene, Words, World};
use domains::driving::{FEATURES, VERBAL, VISUAL};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use training::irl::{IrlError, IrlSettings, Lattice, driving_lattice, learn};

const TRUE: [f64; FEATURES] = [0.6, -5.0, -4.0, -6.0, -3.0, -1.2];

/// Rounds of gridworld driving, with nobody at the wheel yet.
fn roads(rounds: u32) -> Vec<Lattice> {
    let scene = Scene::builtin("driving").unwrap();
    let mut world = World::new(&scene, &Words::none()).unwrap();
    let mut row = [0.0; VISUAL];
    (0..rounds)
        .map(|round| {
            world.reset(3, round, round);
            let (mut visual, mut actions) = (Vec::new(), Vec::new());
            loop {
                world.observe(&mut row, &mut [0.0; VERBAL]);
                visual.extend(row);
                if !world.end().is_running() {
                    break driving_lattice(&visual, &actions).unwrap();
                }
                actions.push(world.expert());
                world.step(world.expert());
            }
        })
        .collect()
}

fn played(rounds: u32, discount: f64) -> Vec<Lattice> {
    let mut lattices = roads(rounds);
    let mut random = ChaCha8Rng::seed_from_u64(5);
    for lattice in &mut lattices {
        lattice.play(&TRUE, discount, &mut random);
    }
    lattices
}

#[test]
fn known_weights_come_back() {
    for discount in [1.0, 0.9] {
        let settings = IrlSettings {
            prior: 1e-3,
            discount,
            ..IrlSettings::default()
        };
        let rounds = played(1000, discount);
        let learned = learn(&rounds, &settings).unwrap();
        assert!(learned.gradient < 1e-5, "{learned:?}");
        for k in 0..FEATURES {
            let away = (learned.weights[k] - TRUE[k]).abs();
            assert!(learned.error[k] < 0.7, "{learned:?}");
            assert!(away < 4.0 * learned.error[k], "weight {k}: {learned:?}");
        }
        // More rounds, smaller errors: a twentieth of the rounds is farther off.
        let error = |weights: &[f64]| -> f64 {
            let pairs = weights.iter().zip(TRUE);
            pairs.map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
        };
        let few = learn(&rounds[..50], &settings).unwrap();
        assert!(error(&learned.weights) < error(&few.weights));
    }
}

#[test]
fn the_learned_weights_are_the_likeliest() {
    let rounds = played(200, 1.0);
    let settings = IrlSettings {
        prior: 0.0,
        ..IrlSettings::default()
    };
    let learned = learn(&rounds, &settings).unwrap();
    let log_likelihood = |weights: &[f64]| -> f64 {
        let mut sum = 0.0;
        for round in &rounds {
            let policy = round.soft_policy(weights, 1.0);
            let mut state = round.start;
            for (step, action) in round.taken.iter().enumerate() {
                let choice = (step * round.states + state) * round.actions + action;
                sum += policy[choice].ln();
                state = round.next[choice];
            }
        }
        sum / learned.actions as f64
    };
    let best = log_likelihood(&learned.weights);
    assert!((best - learned.log_likelihood).abs() < 1e-12);
    assert!(best >= log_likelihood(&TRUE));
    for k in 0..FEATURES {
        for step in [-0.05, 0.05] {
            let mut moved = learned.weights.clone();
            moved[k] += step;
            assert!(log_likelihood(&moved) < best, "weight {k}");
        }
    }
}

#[test]
fn a_policy_is_a_distribution() {
    for round in played(5, 1.0) {
        let policy = round.soft_policy(&TRUE, 1.0);
        for choice in policy.chunks(round.actions) {
            assert!((choice.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
    }
}

#[test]
fn bad_recordings_are_refused() {
    let settings = IrlSettings::default();
    assert_eq!(learn(&[], &settings), Err(IrlError::Empty));
    let good = played(2, 1.0);
    let mut bad = good.clone();
    bad[1].phi[7] = f64::NAN;
    let message = learn(&bad, &settings).unwrap_err().to_string();
    assert!(
        message.starts_with("round 1: a feature of NaN at step 0"),
        "{message}"
    );
    let mut bad = good.clone();
    bad[1].taken[3] = 2;
    let message = learn(&bad, &settings).unwrap_err().to_string();
    assert!(
        message.contains("round 1: action 2 of 2 at step 3"),
        "{message}"
    );
    let mut bad = good;
    bad[0].next.pop();
    assert!(learn(&bad, &settings).is_err());
    assert!(driving_lattice(&[0.0; 7], &[0]).is_err());
    assert!(driving_lattice(&[0.0; VISUAL], &[0, 1]).is_err());
    assert!(driving_lattice(&[0.0; VISUAL], &[2]).is_err());
}
