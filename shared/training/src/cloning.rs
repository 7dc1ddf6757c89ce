//! Behavioural cloning (`bc`): a recurrent policy by maximum likelihood, stopped early on validation rounds, with the number
//! of dense layers varied and the best kept (paper §IV-A and appendix "CARLA").
//!
//! ```text
//! min  − Σ_t log N(u_t; μ(h_t), σ(h_t)²),   u = atanh a
//! ```
//!
//! Every round is a column of the batch; the columns go forward together in windows, and h is carried from one window to
//! the next without its gradient (truncated back-propagation through time).

use crate::config::{self, Checked};
use crate::lessons::{Lesson, hold_out, sizes};
use domains::highway::modalities::layout;
use models::policy::{HeadScratch, unsquash};
use models::{ActionDistribution, RecurrentPolicy, RecurrentSizes};
use nn::{Adam, Arena, Gradients, GruScratch, Tape, Tensor, Var};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Features of h and of the hidden layers.
    pub hidden: usize,
    /// Numbers of dense layers to try; three is the paper's last word for CARLA.
    pub layers: [usize; 3],
    /// Rounds of the expert in clear weather beside the person's own: two of each case.
    pub expert_rounds: usize,
    /// Steps of a window.
    pub window: usize,
    /// Adam's rate, the paper's for its networks times three: the data are a few thousand steps.
    pub learning_rate: f32,
    /// Largest norm of a gradient.
    pub gradient_clip: f32,
    /// Most passes over the data.
    pub epochs: usize,
    /// Passes without a better validation before learning stops.
    pub patience: usize,
    /// Seed of the first weights.
    #[serde(default)]
    pub seed: u64,
}

impl Default for Settings {
    /// What ships ([`crate::config`]).
    fn default() -> Self {
        config::highway().cloning
    }
}

impl Checked for Settings {
    fn problem(&self) -> Option<String> {
        let sizes = [self.hidden, self.window, self.epochs];
        let layers = self.layers.iter().all(|n| (1..=8).contains(n));
        (!layers
            || sizes.iter().any(|n| !(1..=100_000).contains(n))
            || self.hidden > 1024
            || self.learning_rate <= 0.0
            || self.gradient_clip <= 0.0)
            .then(|| {
                "layers from 1 to 8; hidden from 1 to 1024; window and epochs at least 1; rates positive"
                    .to_owned()
            })
    }
}

/// Learning is impossible.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum CloningError {
    /// Nobody drove.
    #[error(
        "there is no step to learn from ({rounds} rounds of the person, {expert} of the expert)"
    )]
    Nothing {
        /// The person's rounds.
        rounds: usize,
        /// The expert's.
        expert: usize,
    },
    /// It is not known what the person could see.
    #[error(
        "the file does not say what the person could see, which `{0}` has to be told; record the rounds anew with `mirror demos`"
    )]
    Unseen(&'static str),
}

/// One number of layers, learned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trial {
    /// Dense layers.
    pub layers: usize,
    /// Best mean −log π(a | h) per step of the validation rounds.
    pub validation: f32,
    /// Pass that gave it, from 1.
    pub epoch: usize,
    /// Passes made.
    pub epochs: usize,
}

/// What learning gave.
#[derive(Clone, Debug)]
pub struct Learned {
    /// The policy of the best trial.
    pub policy: RecurrentPolicy,
    /// The best trial.
    pub best: Trial,
    /// Every trial.
    pub trials: Vec<Trial>,
}

/// Learns from a person's rounds, `own`, and from the expert's. Stopping is judged on rounds of the person that were held
/// out; with a single round, on rounds of the expert. `progress` hears of every pass: (layers, pass, validation).
///
/// # Errors
/// If there is no step to learn from.
pub fn learn(
    own: Vec<Lesson>,
    expert: Vec<Lesson>,
    settings: &Settings,
    progress: &(dyn Fn(usize, usize, f32) + Sync),
) -> Result<Learned, CloningError> {
    let counts = (own.len(), expert.len());
    let (mut train, mut validation) = hold_out(own);
    if validation.is_empty() {
        let (rest, held) = hold_out(expert);
        train.extend(rest);
        validation = held;
    } else {
        train.extend(expert);
    }
    train.retain(|lesson| lesson.steps() > 0);
    validation.retain(|lesson| lesson.steps() > 0);
    if train.is_empty() || validation.is_empty() {
        return Err(CloningError::Nothing {
            rounds: counts.0,
            expert: counts.1,
        });
    }
    let mut results = Vec::new();
    std::thread::scope(|scope| {
        let (train, validation) = (&train, &validation);
        let jobs = settings.layers.map(|layers| {
            scope.spawn(move || learn_layers(layers, train, validation, settings, progress))
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
    let (policy, best) = results
        .into_iter()
        .reduce(|a, b| {
            if b.1.validation < a.1.validation {
                b
            } else {
                a
            }
        })
        .expect("there is a trial");
    Ok(Learned {
        policy,
        best,
        trials,
    })
}

/// One number of layers, up to its best pass.
fn learn_layers(
    layers: usize,
    train: &[Lesson],
    validation: &[Lesson],
    settings: &Settings,
    progress: &dyn Fn(usize, usize, f32),
) -> (RecurrentPolicy, Trial) {
    let sizes = RecurrentSizes {
        hidden: settings.hidden,
        dense: settings.hidden,
        ..sizes(layers)
    };
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    let mut policy = RecurrentPolicy::new(sizes, &layout(), &mut rng);
    let ids: Vec<_> = policy.parameters.ids().collect();
    let mut adam = Adam::new(&policy.parameters, ids.clone(), settings.learning_rate);
    let mut gradients = Gradients::for_params(&policy.parameters);
    let mut arena = Arena::new();
    let longest = train.iter().map(Lesson::steps).max().unwrap_or(0);
    let mut best = (
        policy.clone(),
        Trial {
            layers,
            validation: f32::INFINITY,
            epoch: 0,
            epochs: 0,
        },
    );
    let mut hidden = Tensor::new(sizes.hidden, train.len());
    for epoch in 1..=settings.epochs {
        hidden.fill(0.0);
        for start in (0..longest).step_by(settings.window.max(1)) {
            let steps = settings.window.min(longest - start);
            gradients.zero();
            {
                let mut tape = Tape::new(&policy.parameters, &mut arena);
                let (loss, last) =
                    negative_log_likelihood(&mut tape, &policy, train, &hidden, start, steps);
                tape.backward(loss, &mut gradients, &|_| true);
                hidden.data_mut().copy_from_slice(tape.value(last));
            }
            gradients.clip(&ids, settings.gradient_clip);
            adam.step(&mut policy.parameters, &gradients);
        }
        let nll = mean_nll(&policy, validation);
        progress(layers, epoch, nll);
        best.1.epochs = epoch;
        if nll < best.1.validation {
            best.0.parameters.copy_from(&policy.parameters);
            best.1.validation = nll;
            best.1.epoch = epoch;
        } else if epoch >= best.1.epoch + settings.patience {
            break;
        }
    }
    best
}

/// The loss over steps `start .. start + steps` of every round that lasts that long, averaged over them, and h after the
/// last. Rounds that are over weigh nothing.
pub fn negative_log_likelihood(
    tape: &mut Tape,
    policy: &RecurrentPolicy,
    lessons: &[Lesson],
    hidden: &Tensor,
    start: usize,
    steps: usize,
) -> (Var, Var) {
    let (rows, batch) = (policy.sizes.input(), lessons.len());
    let mut h = tape.input(hidden);
    let mut sum: Option<Var> = None;
    let mut counted = 0;
    for t in start..start + steps {
        let input = tape.input_with(rows, batch, |out| {
            for (out, lesson) in out.chunks_exact_mut(rows).zip(lessons) {
                match t < lesson.steps() {
                    true => out.copy_from_slice(lesson.input.column(t)),
                    false => out.fill(0.0),
                }
            }
        });
        h = tape.gru(&policy.gru, input, h);
        let (mean, deviation) = policy.gaussian(tape, h);
        let taken = tape.input_with(2, batch, |out| {
            for (out, lesson) in out.chunks_exact_mut(2).zip(lessons) {
                match t < lesson.steps() {
                    true => {
                        for (u, a) in out.iter_mut().zip(lesson.action.column(t)) {
                            *u = unsquash(*a);
                        }
                    }
                    false => out.fill(0.0),
                }
            }
        });
        let weights = tape.input_with(2, batch, |out| {
            for (out, lesson) in out.chunks_exact_mut(2).zip(lessons) {
                out.fill(f32::from(u8::from(t < lesson.steps())));
            }
        });
        counted += lessons.iter().filter(|l| t < l.steps()).count();
        let density = tape.gaussian_log_density_weighted(taken, mean, deviation, weights);
        let total = tape.sum(density);
        sum = Some(match sum {
            None => total,
            Some(sum) => tape.add(sum, total),
        });
    }
    let sum = sum.unwrap_or_else(|| tape.constant(1, 1, 0.0));
    (tape.scale(sum, -1.0 / counted.max(1) as f32), h)
}

/// Mean −log π(a | h) per step over rounds, as a density over the action.
pub fn mean_nll(policy: &RecurrentPolicy, lessons: &[Lesson]) -> f32 {
    let sizes = policy.sizes;
    let (mut scratch, mut head) = (GruScratch::default(), HeadScratch::default());
    let mut distribution = ActionDistribution::new(policy.actions, 1);
    let (mut hidden, mut next) = (Tensor::new(sizes.hidden, 1), Tensor::new(sizes.hidden, 1));
    let mut input = Tensor::new(sizes.input(), 1);
    let (mut sum, mut steps) = (0.0_f64, 0_usize);
    for lesson in lessons {
        hidden.fill(0.0);
        for t in 0..lesson.steps() {
            input.column_mut(0).copy_from_slice(lesson.input.column(t));
            policy
                .gru
                .infer(&policy.parameters, &input, &hidden, &mut scratch, &mut next);
            std::mem::swap(&mut hidden, &mut next);
            distribution.infer(&policy.head, 1.0, &policy.parameters, &hidden, &mut head);
            sum -= f64::from(distribution.log_density(0, lesson.action.column(t)));
            steps += 1;
        }
    }
    (sum / steps.max(1) as f64) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;

    /// Rounds whose person brakes the step after a number in the input was high, and otherwise not.
    fn rounds(count: usize, seed: u64) -> Vec<Lesson> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        (0..count)
            .map(|n| {
                let steps = 30 + 7 * n;
                let mut input = Tensor::new(sizes(3).input(), steps);
                let mut action = Tensor::new(2, steps);
                let mut danger = false;
                for t in 0..steps {
                    let brake = if danger { -0.6 } else { 0.3 };
                    danger = rng.random::<f32>() < 0.3;
                    input.column_mut(t)[5] = f32::from(u8::from(danger));
                    action.column_mut(t).copy_from_slice(&[
                        brake + rng.random_range(-0.02..0.02),
                        rng.random_range(-0.02..0.02),
                    ]);
                }
                Lesson { input, action }
            })
            .collect()
    }

    fn settings() -> Settings {
        Settings {
            hidden: 24,
            epochs: 150,
            learning_rate: 5e-3,
            ..Settings::default()
        }
    }

    #[test]
    fn it_learns_what_only_memory_can_tell() {
        let learned = learn(rounds(8, 1), Vec::new(), &settings(), &|_, _, _| {}).expect("learned");
        // Without memory the best is a Gaussian around both pedals: about 0.4 nats a step more than −1.
        let unseen = mean_nll(&learned.policy, &rounds(3, 2));
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
        let few = Settings {
            epochs: 3,
            ..settings()
        };
        let run = || learn(rounds(4, 1), rounds(2, 5), &few, &|_, _, _| {}).expect("learned");
        let (a, b) = (run(), run());
        assert_eq!(a.policy.parameters, b.policy.parameters);
        assert_eq!(a.trials, b.trials);
        let other = learn(rounds(4, 2), rounds(2, 5), &few, &|_, _, _| {}).expect("learned");
        assert_ne!(a.policy.parameters, other.policy.parameters);
    }

    /// The tape's loss and the density that scores are the same number.
    #[test]
    fn the_loss_is_the_score() {
        let lessons = rounds(3, 4);
        let sizes = sizes(3);
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let policy = RecurrentPolicy::new(sizes, &layout(), &mut rng);
        let mut arena = Arena::new();
        let mut tape = Tape::new(&policy.parameters, &mut arena);
        let longest = lessons.iter().map(Lesson::steps).max().unwrap_or(0);
        let hidden = Tensor::new(sizes.hidden, lessons.len());
        let (loss, _) = negative_log_likelihood(&mut tape, &policy, &lessons, &hidden, 0, longest);
        let steps: usize = lessons.iter().map(Lesson::steps).sum();
        let jacobian: f32 = lessons
            .iter()
            .flat_map(|lesson| lesson.action.data())
            .map(|a| (1.0 - a * a).ln())
            .sum();
        let scored = mean_nll(&policy, &lessons) - jacobian / steps as f32;
        let loss = tape.scalar(loss);
        assert!((loss - scored).abs() < 1e-4, "{loss} and {scored}");
    }

    #[test]
    fn nothing_to_learn_from_is_an_error() {
        let error = learn(Vec::new(), Vec::new(), &settings(), &|_, _, _| {}).expect_err("nothing");
        assert_eq!(
            error,
            CloningError::Nothing {
                rounds: 0,
                expert: 0
            }
        );
    }
}
