//! Learning a gridworld's implants from a person's rounds (paper §III-B, equation 5):
//!
//! ```text
//! argmin_χ  − Σ_t E_{z_t ~ q(z_t | x_{1:t}, a_{1:t−1}, χ)} [log π(a_t | z_t)]  −  λ log p(χ)
//! ```
//!
//! Only χ moves. Whole rounds are followed through the perceptual implant and q_φ; for −λ log p(χ) stands a penalty on the
//! residual's square.

use super::rounds::Rounds;
use crate::SHARDS;
use models::discrete::{
    Attached, DiscreteModel, Implants, Perceiver, policy_on_tape, seen_on_tape,
};
use nn::{Adam, Arena, Gradients, Parameters, Tape, Tensor, Var, noise};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use thiserror::Error;

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Adam's rate at the start; it falls to nothing, so that the noise of sampling z averages out.
    pub learning_rate: f32,
    /// Steps of Adam.
    pub iterations: usize,
    /// λ: penalty on the mean square of δ.
    pub residual_penalty: f32,
    /// Learning starts with every limit at each of these shares of the largest, and the best fit is kept: a limit that
    /// nothing ever crosses feels no slope.
    pub starts: [f32; 3],
    /// Each round is followed at least so many times at once, with different noise.
    pub least_columns: usize,
    /// Seed of the residual's first weights and of the noise.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            learning_rate: 0.1,
            iterations: 80,
            residual_penalty: 0.1,
            starts: [0.1, 0.4, 0.9],
            least_columns: 16,
            seed: 0,
        }
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
    /// Names of the self-model's parameters that changed by a single bit: none, or there is a bug.
    pub frozen_moved: Vec<String>,
}

impl Learned {
    /// Mean loss of the last fifth of the iterations, which differ in little but the noise.
    pub fn last_loss(&self) -> f32 {
        let n = self.losses.len();
        let last = &self.losses[n - (n / 5).max(1).min(n)..];
        last.iter().sum::<f32>() / last.len().max(1) as f32
    }
}

/// A part of the rounds; tensors are `features × (steps · columns)`, step after step.
pub struct Followed {
    /// Steps of the longest round.
    pub steps: usize,
    /// Rounds, each as often as it is followed.
    pub columns: usize,
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
}

/// Lays rounds side by side, in shards of equal work.
pub fn follow(model: &DiscreteModel, rounds: &Rounds, settings: &Settings) -> Vec<Followed> {
    let used: Vec<_> = rounds.rounds.iter().filter(|r| !r.is_empty()).collect();
    if used.is_empty() {
        return Vec::new();
    }
    let copies = settings.least_columns.div_ceil(used.len()).max(1);
    let columns: Vec<_> = (0..copies).flat_map(|_| used.iter().copied()).collect();
    let shape = model.sizes.shape;
    let perceiver = Perceiver::new(&model.layout);
    (0..SHARDS)
        .map(|s| &columns[columns.len() * s / SHARDS..columns.len() * (s + 1) / SHARDS])
        .filter(|part| !part.is_empty())
        .map(|part| {
            let steps = part.iter().map(|r| r.len()).max().unwrap_or(0);
            let all = steps * part.len();
            let mut out = Followed {
                steps,
                columns: part.len(),
                visual: Tensor::new(shape.visual, all),
                verbal: Tensor::new(shape.verbal, all),
                previous: Tensor::new(shape.action, all),
                taken: vec![0; all],
                weight: Tensor::new(1, all),
                noise: Tensor::new(model.sizes.latent, all),
                chance: Tensor::new(perceiver.noise_rows(), all),
                heard: rounds.heard,
            };
            for (j, round) in part.iter().enumerate() {
                for t in 0..round.len() {
                    let at = t * part.len() + j;
                    let visual = &round.visual[t * shape.visual..(t + 1) * shape.visual];
                    let verbal = &round.verbal[t * shape.verbal..(t + 1) * shape.verbal];
                    out.visual.column_mut(at).copy_from_slice(visual);
                    out.verbal.column_mut(at).copy_from_slice(verbal);
                    if t > 0 {
                        let before = usize::from(round.action[t - 1]);
                        out.previous.column_mut(at)[before] = 1.0;
                    }
                    out.taken[at] = round.action[t].into();
                    out.weight.data_mut()[at] = 1.0;
                }
            }
            out
        })
        .collect()
}

/// Learns the implants of one person, with the policy implant (`mirror`) or without (`mirror-p`), from each of the starts, and
/// keeps the best. `progress` hears of each iteration over all starts and its loss.
///
/// # Errors
/// If the rounds are empty.
pub fn learn(
    model: &DiscreteModel,
    with_policy: bool,
    rounds: &Rounds,
    settings: &Settings,
    progress: &mut dyn FnMut(usize, f32),
) -> Result<Learned, NothingToLearn> {
    let mut best: Option<Learned> = None;
    for (s, start) in settings.starts.into_iter().enumerate() {
        let before = s * settings.iterations;
        let learned = learn_from(
            model,
            with_policy,
            start,
            rounds,
            settings,
            &mut |i, loss| {
                progress(before + i, loss);
            },
        )?;
        if best
            .as_ref()
            .is_none_or(|best| learned.last_loss() < best.last_loss())
        {
            best = Some(learned);
        }
    }
    best.ok_or(NothingToLearn)
}

/// One start of [`learn`].
fn learn_from(
    model: &DiscreteModel,
    with_policy: bool,
    start: f32,
    rounds: &Rounds,
    settings: &Settings,
    progress: &mut dyn FnMut(usize, f32),
) -> Result<Learned, NothingToLearn> {
    let mut shards = follow(model, rounds, settings);
    if shards.is_empty() {
        return Err(NothingToLearn);
    }
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    let mut implants = Implants::new(model, with_policy, &mut rng);
    let perceiver = implants.perceiver;
    implants.set_limits(&vec![start * perceiver.largest(); perceiver.limits()]);
    let mut parameters = model.parameters.clone();
    let attached = implants.attach(&mut parameters);
    let mut arenas: Vec<Arena> = shards.iter().map(|_| Arena::default()).collect();
    let mut gradients: Vec<Gradients> = shards
        .iter()
        .map(|_| Gradients::for_params(&parameters))
        .collect();
    let counted = |shard: &Followed| shard.weight.data().iter().sum::<f32>();
    let total: f32 = shards.iter().map(counted).sum();
    let mut adam = Adam::new(&parameters, attached.ids().to_vec(), settings.learning_rate);
    let mut losses = Vec::with_capacity(settings.iterations);
    for iteration in 0..settings.iterations {
        for (s, shard) in shards.iter_mut().enumerate() {
            let stream = (iteration * SHARDS + s) as u64 * 2;
            noise::fill(shard.noise.data_mut(), settings.seed, stream);
            noise::fill(shard.chance.data_mut(), settings.seed, stream + 1);
        }
        let mut loss = 0.0;
        let one = |shard: &Followed, arena: &mut Arena, gradients: &mut Gradients| {
            gradients.zero_only(attached.ids());
            let mut tape = Tape::new(&parameters, arena);
            let loss = negative_log_likelihood(&mut tape, model, &attached, shard, settings);
            let loss = tape.scale(loss, counted(shard) / total);
            tape.backward(loss, gradients, &|id| attached.ids().contains(&id));
            tape.scalar(loss)
        };
        std::thread::scope(|scope| {
            let mut jobs = shards.iter().zip(&mut arenas).zip(&mut gradients);
            let own = jobs.next();
            let one = &one;
            let others: Vec<_> = jobs
                .map(|((shard, arena), gradients)| {
                    scope.spawn(move || one(shard, arena, gradients))
                })
                .collect();
            if let Some(((shard, arena), gradients)) = own {
                loss += one(shard, arena, gradients);
            }
            for job in others {
                match job.join() {
                    Ok(value) => loss += value,
                    Err(panic) => std::panic::resume_unwind(panic),
                }
            }
        });
        let (first, rest) = gradients.split_at_mut(1);
        for other in rest {
            first[0].add_only(other, attached.ids());
        }
        let left = 1.0 - iteration as f32 / settings.iterations as f32;
        adam.learning_rate = settings.learning_rate * left;
        adam.step(&mut parameters, &first[0]);
        losses.push(loss);
        progress(iteration + 1, loss);
    }
    implants.detach(&parameters, &attached);
    Ok(Learned {
        implants,
        losses,
        frozen_moved: moved(model, &parameters),
    })
}

/// Equation 5's loss over one shard, averaged over the steps that count, with the residual's penalty.
pub fn negative_log_likelihood(
    tape: &mut Tape,
    model: &DiscreteModel,
    attached: &Attached,
    shard: &Followed,
    settings: &Settings,
) -> Var {
    let perceiver = Perceiver::new(&model.layout);
    let seen = seen_on_tape(tape, attached, &perceiver, &shard.visual, &shard.chance);
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
    let (logits, delta) = policy_on_tape(tape, model, attached, z);
    let weight = tape.input(&shard.weight);
    let counted = shard.weight.data().iter().sum::<f32>().max(1.0);
    let nll = tape.categorical_nll(logits, &shard.taken);
    let nll = tape.mul(nll, weight);
    let nll = tape.sum(nll);
    let loss = tape.scale(nll, 1.0 / counted);
    let Some(delta) = delta else { return loss };
    let squared = tape.square(delta);
    let squared = tape.sum_rows(squared);
    let squared = tape.mul(squared, weight);
    let sum = tape.sum(squared);
    let actions = model.sizes.shape.action as f32;
    let penalty = tape.scale(sum, settings.residual_penalty / (counted * actions));
    tape.add(loss, penalty)
}

/// Names of the self-model's parameters that differ in `parameters` by a single bit.
fn moved(model: &DiscreteModel, parameters: &Parameters) -> Vec<String> {
    model
        .parameters
        .iter()
        .filter(|(id, _, tensor)| *tensor != parameters.get(*id))
        .map(|(_, name, _)| name.to_owned())
        .collect()
}
