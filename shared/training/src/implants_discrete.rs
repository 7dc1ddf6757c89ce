//! Learning a gridworld's implants from a person's rounds (paper §III-B, equation 5):
//!
//! ```text
//! argmin_χ  − Σ_t E_{z_t ~ q(z_t | x_{1:t}, a_{1:t−1}, χ)} [log π(a_t | z_t)]  −  λ log p(χ)
//! ```
//!
//! Where perception is a matter of chance (bomb defusal), a few people k share a round, each of whom noticed other things, and the
//! loss is −log of their mean likelihood, −Σ_t log (1/K) Σ_k π(a_t | z_t^k), a closer bound (importance weighting; Burda et al.
//! 2016). The mean of the logarithms cannot learn there that whoever sees acts: the person acts when *they* see, the samples see
//! at other times, and so the residual would learn to wait whatever is seen, and told.
//!
//! Only χ moves. Whole rounds are followed through the perceptual implant and q_φ. p(χ) is a standard normal of each weight of the
//! residual and flat in the limits, and λ is one over the number of steps, so that the loss is −log posterior a step: the prior
//! holds the network down while rounds are few and yields as they become many. A penalty on the residual's *output* does not: it
//! taxes a plain habit in every step, until a limit is bent to explain it.

use crate::SHARDS;
use crate::config::{self, Checked};
use crate::rounds::Rounds;
use domains::Perception;
use models::implants::{ActionOnTape, Attached, policy_on_tape, seen_on_tape};
use models::{Implants, SelfModel};
use nn::{Adam, Arena, Gradients, Parameters, Tape, Tensor, Var, noise};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use thiserror::Error;

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Adam's rate at the start; it falls to nothing, so that the noise of sampling z averages out.
    pub learning_rate: f32,
    /// Steps of Adam.
    pub iterations: usize,
    /// Precision of the normal prior on the residual's weights.
    pub residual_precision: f32,
    /// Learning starts with each group of limits ([`Perception::group`]) at each of these shares of the largest, and the most
    /// probable outcome is kept: a limit that nothing ever crosses feels no slope.
    pub starts: [f32; 3],
    /// Rounds are followed as often as makes at least so many columns, with different noise.
    pub least_columns: usize,
    /// K: people who share a round where perception is a matter of chance.
    pub sharing: usize,
    /// Seed of the residual's first weights and of the noise.
    #[serde(default)]
    pub seed: u64,
}

impl Default for Settings {
    /// What ships ([`crate::config`]).
    fn default() -> Self {
        Self::of("driving")
    }
}

impl Settings {
    /// What ships for a domain.
    pub fn of(domain: &str) -> Self {
        config::gridworld(domain).implants
    }
}

impl Checked for Settings {
    fn problem(&self) -> Option<String> {
        let (iterations, sharing) = (self.iterations, self.sharing);
        (!(1..=100_000).contains(&iterations)
            || !(1..=1024).contains(&sharing)
            || !(1..=10_000).contains(&self.least_columns)
            || self.learning_rate <= 0.0
            || self.residual_precision < 0.0
            || self.starts.iter().any(|share| !(0.0..=1.0).contains(share)))
        .then(|| {
            "iterations, sharing and least_columns at least 1; learning_rate positive; starts in [0, 1]"
                .to_owned()
        })
    }
}

impl Settings {
    /// Iterations over all starts: what [`learn`]'s progress counts to.
    pub fn all_iterations(&self, model: &SelfModel) -> usize {
        let groups = model.layout.perception.groups();
        self.iterations * self.starts.len().pow(groups as u32)
    }
}

/// There is nothing to learn from.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error("the rounds hold no step to learn from")]
pub struct NothingToLearn;

/// What learning gave.
#[derive(Clone, Debug)]
pub struct Learned {
    /// The implants.
    pub implants: Implants,
    /// The loss at every iteration.
    pub losses: Vec<f32>,
    /// The loss of what was learned, under noise that every start is compared by.
    pub loss: f32,
    /// Names of the self-model's parameters that changed by a single bit: none, or there is a bug.
    pub frozen_moved: Vec<String>,
}

/// A part of the rounds; tensors are `features × (steps · columns)`, step after step.
#[derive(Clone, Debug)]
pub struct Followed {
    /// Steps of the longest round.
    pub steps: usize,
    /// Rounds, each as often as it is followed.
    pub columns: usize,
    /// How many columns share a round in the loss: columns j, j + columns/sharing, …
    pub sharing: usize,
    /// x^visual.
    pub visual: Tensor,
    /// x^verbal.
    pub verbal: Tensor,
    /// a_{t−1}.
    pub previous: Tensor,
    /// a_t.
    pub taken: Vec<u32>,
    /// 1 where a step counts.
    pub weight: Tensor,
    /// ε of z_t.
    pub noise: Tensor,
    /// Chance of perception.
    pub chance: Tensor,
    /// Utterances that are heard.
    pub heard: u32,
    /// Steps of all rounds, each counted once.
    pub steps_lived: f32,
}

/// Lays rounds side by side, in shards of equal work.
pub fn follow(model: &SelfModel, rounds: &Rounds, settings: &Settings) -> Vec<Followed> {
    let used: Vec<_> = rounds.rounds.iter().filter(|r| !r.is_empty()).collect();
    if used.is_empty() {
        return Vec::new();
    }
    let shape = model.sizes.shape;
    let perception = model.layout.perception;
    let by_chance = perception.noise_rows() > 0;
    let sharing = if by_chance {
        settings.sharing.max(1)
    } else {
        1
    };
    let copies = settings.least_columns.div_ceil(used.len() * sharing).max(1);
    let rounds_followed: Vec<_> = (0..copies).flat_map(|_| used.iter().copied()).collect();
    let of = |s: usize| rounds_followed.len() * s / SHARDS;
    (0..SHARDS)
        .map(|s| rounds_followed[of(s)..of(s + 1)].repeat(sharing))
        .filter(|part| !part.is_empty())
        .map(|part| {
            let steps = part.iter().map(|r| r.len()).max().unwrap_or(0);
            let all = steps * part.len();
            let mut out = Followed {
                steps,
                columns: part.len(),
                sharing,
                visual: Tensor::new(shape.visual, all),
                verbal: Tensor::new(shape.verbal, all),
                previous: Tensor::new(shape.action, all),
                taken: vec![0; all],
                weight: Tensor::new(1, all),
                noise: Tensor::new(model.sizes.latent, all),
                chance: Tensor::new(perception.noise_rows(), all),
                heard: rounds.heard,
                steps_lived: rounds.steps() as f32,
            };
            for (j, round) in part.iter().enumerate() {
                for t in 0..round.len() {
                    let at = t * part.len() + j;
                    out.visual.column_mut(at).copy_from_slice(round.visual(t));
                    out.verbal.column_mut(at).copy_from_slice(round.verbal(t));
                    if t > 0 {
                        let before = round.action(t - 1);
                        out.previous.column_mut(at).copy_from_slice(before);
                    }
                    out.taken[at] = round.choice(t) as u32;
                    out.weight.data_mut()[at] = 1.0;
                }
            }
            out
        })
        .collect()
}

/// Learns the implants of one person, with the policy implant (`mirror`) or without (`mirror-p`), from each of the starts, and
/// keeps the most probable. `progress` hears of iterations over all starts and a loss. The starts are learned from on as many
/// threads as there are cores; the result does not depend on their number.
///
/// # Errors
/// If the rounds are empty.
pub fn learn(
    model: &SelfModel,
    with_policy: bool,
    rounds: &Rounds,
    settings: &Settings,
    progress: &mut dyn FnMut(usize, f32),
) -> Result<Learned, NothingToLearn> {
    let shards = follow(model, rounds, settings);
    if shards.is_empty() {
        return Err(NothingToLearn);
    }
    let starts = starts(model.layout.perception, &settings.starts);
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let next = AtomicUsize::new(0);
    let (sender, receiver) = mpsc::channel();
    let mut learned: Vec<Option<Learned>> = starts.iter().map(|_| None).collect();
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads.min(starts.len()))
            .map(|_| {
                let (starts, shards, next, sender) = (&starts, &shards, &next, sender.clone());
                scope.spawn(move || {
                    let mut own = Vec::new();
                    loop {
                        let s = next.fetch_add(1, Ordering::Relaxed);
                        let Some(start) = starts.get(s) else {
                            return own;
                        };
                        let mut tell = |loss| {
                            // Nobody may be listening any more.
                            let _ = sender.send(loss);
                        };
                        let learned =
                            learn_from(model, with_policy, start, shards, settings, &mut tell);
                        own.push((s, learned));
                    }
                })
            })
            .collect();
        drop(sender);
        for (done, loss) in receiver.iter().enumerate() {
            progress(done + 1, loss);
        }
        for worker in workers {
            match worker.join() {
                Ok(own) => own.into_iter().for_each(|(s, l)| learned[s] = Some(l)),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
    });
    learned
        .into_iter()
        .flatten()
        .min_by(|a, b| a.loss.total_cmp(&b.loss))
        .ok_or(NothingToLearn)
}

/// Where learning starts: every combination of shares over the groups of limits, each as limits.
fn starts(perception: &dyn Perception, shares: &[f32]) -> Vec<Vec<f32>> {
    let groups = perception.groups();
    let combinations = shares.len().pow(groups as u32);
    (0..combinations)
        .map(|combination| {
            let share = |limit: usize| {
                let place = shares.len().pow(perception.group(limit) as u32);
                shares[combination / place % shares.len()]
            };
            let limits = 0..perception.limits();
            limits.map(|k| share(k) * perception.largest()).collect()
        })
        .collect()
}

/// Learns from one start.
fn learn_from(
    model: &SelfModel,
    with_policy: bool,
    start: &[f32],
    shards: &[Followed],
    settings: &Settings,
    tell: &mut dyn FnMut(f32),
) -> Learned {
    let mut shards = shards.to_vec();
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    let mut implants = Implants::new(model, with_policy, &mut rng);
    implants.set_limits(start);
    let mut parameters = model.parameters.clone();
    let attached = implants.attach(&mut parameters);
    let mut arena = Arena::default();
    let mut gradients = Gradients::for_params(&parameters);
    let counted = |shard: &Followed| shard.weight.data().iter().sum::<f32>();
    let total: f32 = shards.iter().map(counted).sum();
    let mut adam = Adam::new(&parameters, attached.ids().to_vec(), settings.learning_rate);
    let mut losses = Vec::with_capacity(settings.iterations);
    // The loss under fresh noise, and its gradients.
    let mut step = |parameters: &Parameters, gradients: &mut Gradients, draw: usize| {
        gradients.zero_only(attached.ids());
        let mut sum = 0.0;
        for (s, shard) in shards.iter_mut().enumerate() {
            let stream = (draw * SHARDS + s) as u64 * 2;
            noise::fill(shard.noise.data_mut(), settings.seed, stream);
            noise::fill(shard.chance.data_mut(), settings.seed, stream + 1);
            let share = counted(shard) / total;
            let mut tape = Tape::new(parameters, &mut arena);
            let loss = negative_log_posterior(&mut tape, model, &attached, shard, settings);
            let loss = tape.scale(loss, share);
            tape.backward(loss, gradients, &|id| attached.ids().contains(&id));
            sum += tape.scalar(loss);
        }
        sum
    };
    for iteration in 0..settings.iterations {
        let loss = step(&parameters, &mut gradients, iteration);
        let left = 1.0 - iteration as f32 / settings.iterations as f32;
        adam.learning_rate = settings.learning_rate * left;
        adam.step(&mut parameters, &gradients);
        losses.push(loss);
        tell(loss);
    }
    let draws = settings.iterations..settings.iterations + COMPARED;
    let compared: f32 = draws.map(|d| step(&parameters, &mut gradients, d)).sum();
    implants.detach(&parameters, &attached);
    Learned {
        implants,
        losses,
        loss: compared / COMPARED as f32,
        frozen_moved: moved(model, &parameters),
    }
}

/// Draws of noise that starts are compared by.
const COMPARED: usize = 8;

/// Equation 5's loss over one shard, averaged over the steps that count: −log posterior a step.
pub fn negative_log_posterior(
    tape: &mut Tape,
    model: &SelfModel,
    attached: &Attached,
    shard: &Followed,
    settings: &Settings,
) -> Var {
    let mut loss = negative_log_likelihood(tape, model, attached, shard);
    for &id in attached.policy_ids() {
        let weights = tape.param(id);
        let squared = tape.square(weights);
        let squared = tape.sum(squared);
        let precision = settings.residual_precision / (2.0 * shard.steps_lived);
        let prior = tape.scale(squared, precision);
        loss = tape.add(loss, prior);
    }
    loss
}

/// −log likelihood of what the person did, averaged over the steps that count.
pub fn negative_log_likelihood(
    tape: &mut Tape,
    model: &SelfModel,
    attached: &Attached,
    shard: &Followed,
) -> Var {
    let perception = model.layout.perception;
    let seen = seen_on_tape(tape, attached, perception, &shard.visual, &shard.chance);
    let observed = model
        .view
        .on_tape(tape, &shard.visual, &shard.verbal, seen, shard.heard);
    let features = model.features(tape, observed);
    let action = tape.input(&shard.previous);
    let noise = tape.input(&shard.noise);
    let mut samples = Vec::with_capacity(shard.steps);
    for t in 0..shard.steps {
        let here = t * shard.columns..(t + 1) * shard.columns;
        let previous = samples.last().map(|&z| {
            let action = tape.columns(action, here.clone());
            (z, action)
        });
        let features = tape.columns(features, here.clone());
        let (mean, deviation) = model.posterior(tape, previous, features);
        let noise = tape.columns(noise, here);
        samples.push(tape.gaussian_sample(mean, deviation, noise));
    }
    let z = tape.join(&samples);
    let ActionOnTape::Categorical(logits) = policy_on_tape(tape, model, attached, z) else {
        unreachable!("a gridworld's actions are choices");
    };
    let nll = tape.categorical_nll(logits, &shard.taken);
    let counted = shard.weight.data().iter().sum::<f32>().max(1.0);
    let mut weight = shard.weight.clone();
    let bound = share(shard, tape.value(nll), weight.data_mut());
    let weight = tape.input(&weight);
    let nll = tape.mul(nll, weight);
    let nll = tape.sum(nll);
    // The weights are constants: Σ_k w_k ∇nll_k is the bound's gradient, and this its value.
    let beside = bound - tape.scalar(nll);
    let nll = tape.offset(nll, beside);
    tape.scale(nll, 1.0 / counted)
}

/// Turns the `weight` of columns that share a round into K · π(a | z^k) / Σ_k π(a | z^k), and gives back the sum over columns
/// that count of −log (1/K) Σ_k π(a | z^k).
fn share(shard: &Followed, nll: &[f32], weight: &mut [f32]) -> f32 {
    let rounds = shard.columns / shard.sharing;
    let mut sum = 0.0;
    for t in 0..shard.steps {
        for round in 0..rounds {
            let first = t * shard.columns + round;
            if weight[first] == 0.0 {
                continue;
            }
            let columns = (0..shard.sharing).map(|k| first + k * rounds);
            let least = columns.clone().map(|j| nll[j]).fold(f32::MAX, f32::min);
            let total: f32 = columns.clone().map(|j| (least - nll[j]).exp()).sum();
            let people = shard.sharing as f32;
            for j in columns {
                weight[j] = people * (least - nll[j]).exp() / total;
            }
            sum += people * (least - (total / people).ln());
        }
    }
    sum
}

/// Names of the self-model's parameters that differ in `parameters` by a single bit.
fn moved(model: &SelfModel, parameters: &Parameters) -> Vec<String> {
    model
        .parameters
        .iter()
        .filter(|(id, _, tensor)| *tensor != parameters.get(*id))
        .map(|(_, name, _)| name.to_owned())
        .collect()
}
