//! Behavioural cloning (`bc`): a recurrent policy by maximum likelihood, stopped early on validation rounds, with the number
//! of dense layers varied and the best kept (paper §IV-A and appendix).
//!
//! ```text
//! min  − Σ_t log π(a_t | h_t)        numbers: N(u_t; μ(h_t), σ(h_t)²), u = atanh a;   choices: softmax of the logits
//! ```
//!
//! Every round is a column of the batch; the columns go forward together in windows, and h is carried from one window to
//! the next without its gradient (truncated back-propagation through time).

use crate::config::{self, Checked};
use crate::trajectory::{Sequences, Trajectory};
use domains::{ActionSpace, Layout};
use models::policy::{ACTION_EDGE, unsquash};
use models::{RecurrentPolicy, RecurrentSizes, SelfModel};
use nn::{Adam, Arena, Gradients, Tape, Tensor, Var};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CloningSettings {
    /// Numbers of dense layers to try.
    pub layers: [usize; 3],
    /// Steps of a window.
    pub window: usize,
    /// Adam's rate.
    pub learning_rate: f32,
    /// Largest norm of a gradient.
    pub gradient_clip: f32,
    /// Most passes over the data, with a step of Adam for each window.
    pub iterations: usize,
    /// Passes between validations.
    pub every: usize,
    /// Validations without a new best after which learning stops.
    pub patience: usize,
    /// Seed of the first weights.
    #[serde(default)]
    pub seed: u64,
}

impl CloningSettings {
    /// What ships for a domain ([`crate::config`]).
    pub fn of(domain: &str) -> Self {
        config::policies(domain).cloning
    }
}

impl Checked for CloningSettings {
    fn problem(&self) -> Option<String> {
        let counts = [self.window, self.iterations, self.every];
        (!self.layers.iter().all(|n| (1..=8).contains(n))
            || !counts.iter().all(|n| (1..=100_000).contains(n))
            || self.learning_rate <= 0.0
            || self.gradient_clip <= 0.0)
            .then(|| {
                "layers from 1 to 8; window, iterations and every at least 1; rates positive"
                    .to_owned()
            })
    }
}

/// There is no step to learn from, or none to validate on.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error(
    "there is no step to learn from ({learned} rounds to learn from, {validated} to validate on)"
)]
pub struct NothingToClone {
    /// Rounds to learn from.
    pub learned: usize,
    /// Rounds to validate on.
    pub validated: usize,
}

/// One number of layers, learned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trial {
    /// Dense layers.
    pub layers: usize,
    /// Best mean −log π(a | h) per step of the validation rounds.
    pub validation: f32,
    /// Pass that gave it; 0 is before the first.
    pub iteration: usize,
    /// Passes made.
    pub iterations: usize,
}

/// What learning gave.
#[derive(Clone, Debug)]
pub struct Cloned {
    /// The policy of the best trial, as it was when it did best on the validation rounds.
    pub policy: RecurrentPolicy,
    /// The best trial.
    pub best: Trial,
    /// Every trial.
    pub trials: Vec<Trial>,
}

/// Learns a policy of `sizes`, but for its layers, from `train`; stops by `held`. `progress` hears of every validation:
/// (layers, pass, −log likelihood).
///
/// # Errors
/// If there is no step to learn from, or to validate on.
pub fn learn(
    layout: &Layout,
    sizes: RecurrentSizes,
    train: &[Trajectory],
    held: &[Trajectory],
    settings: &CloningSettings,
    progress: &(dyn Fn(usize, usize, f32) + Sync),
) -> Result<Cloned, NothingToClone> {
    let windows = Sequences::windows(train, settings.window);
    let (Some(held_batch), false) = (Sequences::whole(held), windows.is_empty()) else {
        return Err(NothingToClone {
            learned: train.len(),
            validated: held.len(),
        });
    };
    let mut results = Vec::new();
    std::thread::scope(|scope| {
        let (windows, held) = (&windows, &held_batch);
        let jobs = settings.layers.map(|layers| {
            scope.spawn(move || {
                let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
                let policy = RecurrentPolicy::new(sizes.with_layers(layers), layout, &mut rng);
                learn_layers(policy, windows, held, settings, progress)
            })
        });
        for job in jobs {
            match job.join() {
                Ok(result) => results.push(result),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
    });
    let trials: Vec<Trial> = results.iter().map(|(_, trial)| *trial).collect();
    // At a tie the fewer layers win; there is at least one trial, as `layers` is an array of three.
    let better = |a: (RecurrentPolicy, Trial), b: (RecurrentPolicy, Trial)| match b.1.validation
        < a.1.validation
    {
        true => b,
        false => a,
    };
    let (policy, best) = results
        .into_iter()
        .reduce(better)
        .expect("there is a trial");
    Ok(Cloned {
        policy,
        best,
        trials,
    })
}

/// One number of layers, up to its best pass.
fn learn_layers(
    mut policy: RecurrentPolicy,
    windows: &[Sequences],
    held: &Sequences,
    settings: &CloningSettings,
    progress: &dyn Fn(usize, usize, f32),
) -> (RecurrentPolicy, Trial) {
    let ids: Vec<_> = policy.parameters.ids().collect();
    let mut adam = Adam::new(&policy.parameters, ids.clone(), settings.learning_rate);
    let mut gradients = Gradients::for_params(&policy.parameters);
    let mut arena = Arena::new();
    let mut hidden = Tensor::new(policy.sizes.hidden, windows[0].columns);
    let mut best = policy.parameters.clone();
    let mut trial = Trial {
        layers: policy.sizes.layers,
        validation: mean_nll(&policy, held, &mut arena),
        iteration: 0,
        iterations: 0,
    };
    let mut waited = 0;
    for iteration in 1..=settings.iterations {
        hidden.fill(0.0);
        for window in windows {
            gradients.zero();
            {
                let mut tape = Tape::new(&policy.parameters, &mut arena);
                let (loss, h) = negative_log_likelihood(&mut tape, &policy, window, &hidden);
                tape.backward(loss, &mut gradients, &|_| true);
                let h = tape.value(h);
                let last = h.len() - hidden.data().len();
                hidden.data_mut().copy_from_slice(&h[last..]);
            }
            gradients.clip(&ids, settings.gradient_clip);
            adam.step(&mut policy.parameters, &gradients);
        }
        trial.iterations = iteration;
        if !iteration.is_multiple_of(settings.every) {
            continue;
        }
        let validation = mean_nll(&policy, held, &mut arena);
        progress(trial.layers, iteration, validation);
        if validation < trial.validation {
            best.copy_from(&policy.parameters);
            (trial.validation, trial.iteration) = (validation, iteration);
            waited = 0;
        } else {
            waited += 1;
            if waited >= settings.patience {
                break;
            }
        }
    }
    policy.parameters = best;
    (policy, trial)
}

/// −log π(a_t | h_t), averaged over the steps that there are, and h after every step. Of numbers, the density of u.
/// `hidden`: h before the first step, `hidden × columns`.
pub fn negative_log_likelihood(
    tape: &mut Tape,
    policy: &RecurrentPolicy,
    batch: &Sequences,
    hidden: &Tensor,
) -> (Var, Var) {
    let h = policy.follow(tape, &batch.observed, &batch.previous, hidden);
    let output = tape.mlp(&policy.head, h);
    let nll = match policy.actions {
        ActionSpace::Discrete(_) => tape.categorical_nll(output, &batch.taken),
        ActionSpace::Continuous(n) => {
            let (mean, std) = SelfModel::gaussian(tape, output, n);
            let taken = tape.input_with(n, batch.action.cols(), |out| {
                for (u, a) in out.iter_mut().zip(batch.action.data()) {
                    *u = unsquash(*a);
                }
            });
            let density = tape.gaussian_log_density(taken, mean, std);
            tape.neg(density)
        }
    };
    let weight = tape.input(&batch.weight);
    let nll = tape.mul(nll, weight);
    let sum = tape.sum(nll);
    (tape.scale(sum, 1.0 / batch.counted().max(1.0)), h)
}

/// Mean −log π(a | h) per step of whole rounds: a probability of choices, a density of the action where that is numbers.
pub fn mean_nll(policy: &RecurrentPolicy, batch: &Sequences, arena: &mut Arena) -> f32 {
    let mut tape = Tape::new(&policy.parameters, arena);
    let hidden = Tensor::new(policy.sizes.hidden, batch.columns);
    let (loss, _) = negative_log_likelihood(&mut tape, policy, batch, &hidden);
    let loss = tape.scalar(loss);
    match policy.actions {
        ActionSpace::Discrete(_) => loss,
        // The density of a = tanh u has the slope of tanh in it.
        ActionSpace::Continuous(_) => loss + batch.log_slope(),
    }
}

impl Sequences {
    /// Mean over steps of Σ_d ln(1 − a_d²), as [`unsquash`] takes actions.
    fn log_slope(&self) -> f32 {
        let slope = |a: &f32| {
            let a = a.clamp(-ACTION_EDGE, ACTION_EDGE);
            f64::from(1.0 - a * a).ln()
        };
        let weights = self.weight.data().iter().enumerate();
        let sum: f64 = weights
            .filter(|(_, weight)| **weight > 0.0)
            .map(|(at, _)| self.action.column(at).iter().map(slope).sum::<f64>())
            .sum();
        (sum / f64::from(self.counted().max(1.0))) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use domains::highway::modalities::layout;
    use models::policy::HeadScratch;
    use models::{ActionDistribution, View};
    use nn::GruScratch;
    use rand::RngExt;

    /// Rounds whose person brakes the step after a number in the input was high, and otherwise not.
    fn rounds(count: usize, seed: u64) -> Vec<Trajectory> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        (0..count)
            .map(|n| {
                let steps = 30 + 7 * n;
                let mut observed = Tensor::new(View::new(&layout()).rows(), steps);
                let mut action = Tensor::new(2, steps);
                let mut danger = false;
                for t in 0..steps {
                    let brake = if danger { -0.6 } else { 0.3 };
                    danger = rng.random::<f32>() < 0.3;
                    observed.column_mut(t)[5] = f32::from(u8::from(danger));
                    action.column_mut(t).copy_from_slice(&[
                        brake + rng.random_range(-0.02..0.02),
                        rng.random_range(-0.02..0.02),
                    ]);
                }
                Trajectory {
                    observed,
                    action,
                    ended: false,
                }
            })
            .collect()
    }

    fn sizes() -> RecurrentSizes {
        RecurrentSizes {
            hidden: 24,
            dense: 24,
            ..RecurrentSizes::of(&layout(), 1)
        }
    }

    fn settings() -> CloningSettings {
        CloningSettings {
            iterations: 150,
            learning_rate: 5e-3,
            ..CloningSettings::of("highway")
        }
    }

    fn learned(train: &[Trajectory], held: &[Trajectory], settings: &CloningSettings) -> Cloned {
        learn(&layout(), sizes(), train, held, settings, &|_, _, _| {}).expect("learned")
    }

    #[test]
    fn it_learns_what_only_memory_can_tell() {
        let learned = learned(&rounds(6, 1), &rounds(2, 3), &settings());
        // Without memory the best is a Gaussian around both pedals: about 0.4 nats a step more than −1.
        let unseen = Sequences::whole(&rounds(3, 2)).expect("steps");
        let unseen = mean_nll(&learned.policy, &unseen, &mut Arena::new());
        assert!(unseen < -3.0, "{unseen}, {:?}", learned.trials);
        assert_eq!(learned.trials.len(), 3);
        assert!(
            learned
                .trials
                .iter()
                .all(|trial| trial.validation >= learned.best.validation)
        );
    }

    #[test]
    fn same_seed_same_bytes() {
        let few = CloningSettings {
            iterations: 3,
            ..settings()
        };
        let run = |seed| learned(&rounds(4, seed), &rounds(2, 5), &few);
        let (a, b) = (run(1), run(1));
        assert_eq!(a.policy.parameters, b.policy.parameters);
        assert_eq!(a.trials, b.trials);
        assert_ne!(a.policy.parameters, run(2).policy.parameters);
    }

    /// What is learned by, step for step what the policy says when it drives.
    #[test]
    fn the_loss_is_the_score() {
        let rounds = rounds(3, 4);
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let policy = RecurrentPolicy::new(sizes().with_layers(3), &layout(), &mut rng);
        let (mut scratch, mut head) = (GruScratch::default(), HeadScratch::default());
        let mut distribution = ActionDistribution::new(policy.actions, 1);
        let (mut h, mut next) = (Tensor::new(24, 1), Tensor::new(24, 1));
        let mut input = Tensor::new(policy.sizes.input(), 1);
        let (mut sum, mut steps) = (0.0, 0.0);
        for round in &rounds {
            h.fill(0.0);
            input.fill(0.0);
            for t in 0..round.steps() {
                let p = &policy.parameters;
                let seen = round.observed.column(t);
                input.column_mut(0)[..seen.len()].copy_from_slice(seen);
                policy.gru.infer(p, &input, &h, &mut scratch, &mut next);
                std::mem::swap(&mut h, &mut next);
                distribution.infer(&policy.head, 1.0, p, &h, &mut head);
                let action = round.action.column(t);
                sum -= distribution.log_density(0, action);
                steps += 1.0;
                input.column_mut(0)[seen.len()..].copy_from_slice(action);
            }
        }
        let batch = Sequences::whole(&rounds).expect("steps");
        let scored = mean_nll(&policy, &batch, &mut Arena::new());
        assert!(
            (scored - sum / steps).abs() < 1e-4,
            "{scored} and {}",
            sum / steps
        );
    }

    #[test]
    fn nothing_to_learn_from_is_an_error() {
        let nothing = learn(&layout(), sizes(), &[], &[], &settings(), &|_, _, _| {});
        let expected = NothingToClone {
            learned: 0,
            validated: 0,
        };
        assert_eq!(nothing.err(), Some(expected));
    }
}
