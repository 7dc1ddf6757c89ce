//! Learning implants from a person's demonstrations (paper §III-B, equation 5):
//!
//! ```text
//! argmin_χ  − Σ_t E_{z_t ~ q(z_t | x_{1:t}, a_{1:t−1}, χ)} [log π(a_t | z_t)]  −  λ log p(χ)
//! ```
//!
//! Only χ moves. The rounds are cut into windows; every iteration follows all of them through q_φ and the perceptual
//! implant, and Adam moves χ along the gradient.

use crate::SHARDS;
use crate::config::{self, Checked};
use crate::rounds::Rounds;
use domains::highway::modalities::VISUAL;
use models::implants::{ActionOnTape, Attached, limits_on_tape, policy_on_tape, seen_on_tape};
use models::policy::unsquash;
use models::{Implants, Kind, SelfModel};
use nn::{Adam, Arena, Gradients, Parameters, Tape, Tensor, Var, noise};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Settings; the defaults are the authors' where they gave some.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Adam's rate.
    pub learning_rate: f32,
    /// Steps of Adam.
    pub iterations: usize,
    /// Steps per window.
    pub window: usize,
    /// Steps from one window's start to the next one's: half a window, so that every moment is seen with some history.
    pub stride: usize,
    /// Steps at a round's start that are left out.
    pub skip: usize,
    /// Weights of the action's dimensions: throttle, steer.
    pub weights: [f32; 2],
    /// λ: penalty on the mean square of δ.
    pub residual_penalty: f32,
    /// Prior: standard deviation of the difference between the thresholds of neighbouring azimuths, in metres. Sight
    /// changes little from one direction to the next, and many azimuths never meet a car in a few rounds.
    pub smoothness_m: f32,
    /// Learning starts from each of these thresholds, in metres, and the best fit is kept: the loss has many valleys, since
    /// a threshold that no car ever crosses feels no slope.
    pub starts_m: [f32; 3],
    /// Steps at a window's start that only build up the belief.
    pub warm_up: usize,
    /// Seed of the residual's first weights and of the noise.
    #[serde(default)]
    pub seed: u64,
}

impl Default for Settings {
    /// What ships ([`crate::config`]).
    fn default() -> Self {
        config::highway().implants
    }
}

impl Checked for Settings {
    fn problem(&self) -> Option<String> {
        let Self {
            learning_rate,
            iterations,
            window,
            smoothness_m,
            warm_up,
            ..
        } = *self;
        if iterations == 0 || iterations > 100_000 || window < warm_up + 2 || window > 10_000 {
            return Some(
                "iterations from 1 to 100000; window at least warm_up + 2, at most 10000"
                    .to_owned(),
            );
        }
        let positive = [learning_rate, smoothness_m];
        (!positive.iter().all(|x| *x > 0.0)
            || self.weights.iter().any(|x| *x < 0.0)
            || self.residual_penalty < 0.0)
            .then(|| {
                "learning_rate and smoothness_m are positive, weights and residual_penalty not negative"
                    .to_owned()
            })
    }
}

impl Settings {
    /// Steps that a round of these needs to be learned from: what is left out at its start, and a window, which is as long as
    /// the longest round allows.
    pub fn least_steps(&self, demonstrations: &Rounds) -> usize {
        self.skip + self.window_of(demonstrations)
    }

    fn window_of(&self, demonstrations: &Rounds) -> usize {
        let rounds = demonstrations.rounds.iter();
        let longest = rounds.map(|r| r.len()).max().unwrap_or(0);
        self.window.min(longest.saturating_sub(self.skip))
    }
}

/// Learning is impossible.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum ImplantError {
    /// No round is long enough.
    #[error(
        "no round has {needed} steps after the first {skip}: there is nothing to learn from ({rounds} rounds, longest {longest} steps)"
    )]
    TooShort {
        /// Steps that a window needs at least.
        needed: usize,
        /// Steps left out at the start.
        skip: usize,
        /// Rounds given.
        rounds: usize,
        /// Longest of them.
        longest: usize,
    },
    /// The kind of human model has no implants.
    #[error("a human model of kind `{0}` has no implants to learn")]
    NoImplants(&'static str),
}

/// What learning gave.
#[derive(Clone, Debug)]
pub struct Learned {
    /// The implants.
    pub implants: Implants,
    /// The loss at every iteration.
    pub losses: Vec<f32>,
    /// Names of the self-model's parameters that changed by a single bit on the tape's side: none, or there is a bug.
    pub frozen_moved: Vec<String>,
}

impl Learned {
    /// Mean loss of the last tenth of the iterations, which differ only in the noise of z.
    pub fn last_loss(&self) -> f32 {
        let n = self.losses.len();
        let last = &self.losses[n - (n / 10).max(1).min(n)..];
        last.iter().sum::<f32>() / last.len().max(1) as f32
    }
}

/// One shard's windows, all of equal length: `features × windows` per step.
pub struct Windows {
    /// x^visual_t.
    pub visual: Vec<Tensor>,
    /// a_t before tanh: what the person did having seen x_t.
    pub action: Vec<Tensor>,
    /// a_{t−1}.
    pub previous: Vec<Tensor>,
    /// ε of z_t.
    pub noise: Vec<Tensor>,
}

/// Cuts rounds into windows, in shards.
pub fn windows(
    demonstrations: &Rounds,
    settings: &Settings,
    latent: usize,
) -> Result<Vec<Windows>, ImplantError> {
    let longest = demonstrations.rounds.iter().map(|r| r.len()).max();
    let longest = longest.unwrap_or(0);
    let length = settings.window_of(demonstrations);
    let needed = settings.warm_up + 2;
    if length < needed {
        return Err(ImplantError::TooShort {
            needed,
            skip: settings.skip,
            rounds: demonstrations.rounds.len(),
            longest,
        });
    }
    let mut starts = Vec::new();
    for (r, round) in demonstrations.rounds.iter().enumerate() {
        let n = round.len();
        if n < settings.skip + length {
            continue;
        }
        let last = n - length;
        let mut start = settings.skip;
        while start < last {
            starts.push((r, start));
            start += settings.stride.max(1);
        }
        starts.push((r, last)); // a round's end is where things happen
    }
    let shards = SHARDS.min(starts.len());
    Ok((0..shards)
        .map(|s| {
            let mine = &starts[starts.len() * s / shards..starts.len() * (s + 1) / shards];
            let tensor = |rows| Tensor::new(rows, mine.len());
            let mut windows = Windows {
                visual: vec![tensor(VISUAL); length],
                action: vec![tensor(2); length],
                previous: vec![tensor(2); length],
                noise: vec![tensor(latent); length],
            };
            for (j, &(r, start)) in mine.iter().enumerate() {
                let round = &demonstrations.rounds[r];
                for t in 0..length {
                    let visual = round.visual(start + t);
                    windows.visual[t].column_mut(j).copy_from_slice(visual);
                    let action = round.action(start + t);
                    for (u, a) in windows.action[t].column_mut(j).iter_mut().zip(action) {
                        *u = unsquash(*a);
                    }
                    if start + t > 0 {
                        let before = round.action(start + t - 1);
                        windows.previous[t].column_mut(j).copy_from_slice(before);
                    }
                }
            }
            windows
        })
        .collect())
}

/// Learns implants of `kind` from `demonstrations`, on the unchanged `model`.
pub fn learn(
    model: &SelfModel,
    kind: Kind,
    demonstrations: &Rounds,
    settings: &Settings,
    mut progress: impl FnMut(usize, f32),
) -> Result<Learned, ImplantError> {
    let with_policy = match kind {
        Kind::Mirror => true,
        Kind::MirrorP => false,
        _ => return Err(ImplantError::NoImplants(kind.name())),
    };
    let mut best: Option<Learned> = None;
    for (i, &start_m) in settings.starts_m.iter().enumerate() {
        let done = i * settings.iterations;
        let learned = learn_from(
            model,
            with_policy,
            start_m,
            demonstrations,
            settings,
            &mut |iteration, loss| progress(done + iteration, loss),
        )?;
        if best
            .as_ref()
            .is_none_or(|best| learned.last_loss() < best.last_loss())
        {
            best = Some(learned);
        }
    }
    // `starts_m` is an array with at least one start.
    Ok(best.expect("there is a start"))
}

/// One start of [`learn`].
fn learn_from(
    model: &SelfModel,
    with_policy: bool,
    start_m: f32,
    demonstrations: &Rounds,
    settings: &Settings,
    progress: &mut dyn FnMut(usize, f32),
) -> Result<Learned, ImplantError> {
    let latent = model.sizes.latent;
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    let mut implants = Implants::new(model, with_policy, &mut rng);
    implants.set_all_limits(start_m);
    let mut parameters = model.parameters.clone();
    let attached = implants.attach(&mut parameters);
    let mut shards = windows(demonstrations, settings, latent)?;
    let total: usize = shards.iter().map(|s| s.visual[0].cols()).sum();
    let moments = total * shards[0].visual.len().saturating_sub(settings.warm_up);
    let mut arenas: Vec<Arena> = shards.iter().map(|_| Arena::default()).collect();
    let mut gradients: Vec<Gradients> = shards
        .iter()
        .map(|_| Gradients::for_params(&parameters))
        .collect();
    let mut adam = Adam::new(&parameters, attached.ids().to_vec(), settings.learning_rate);
    let mut losses = Vec::with_capacity(settings.iterations);
    for iteration in 0..settings.iterations {
        for (s, shard) in shards.iter_mut().enumerate() {
            for (t, noise) in shard.noise.iter_mut().enumerate() {
                let stream = ((iteration * 2 + s) * 4096 + t) as u64;
                noise::fill(noise.data_mut(), settings.seed, stream);
            }
        }
        let mut loss = 0.0;
        std::thread::scope(|scope| {
            let jobs: Vec<_> = shards
                .iter()
                .zip(&mut arenas)
                .zip(&mut gradients)
                .map(|((shard, arena), gradients)| {
                    let (parameters, attached) = (&parameters, &attached);
                    scope.spawn(move || {
                        gradients.zero();
                        let mut tape = Tape::new(parameters, arena);
                        let loss =
                            negative_log_likelihood(&mut tape, model, attached, shard, settings);
                        // Every window weighs the same, however the shards were cut.
                        let share = shard.visual[0].cols() as f32 / total as f32;
                        let prior =
                            negative_log_prior(&mut tape, model, attached, settings, moments);
                        let loss = tape.add(loss, prior);
                        let loss = tape.scale(loss, share);
                        let value = tape.value(loss)[0];
                        tape.backward(loss, gradients, &|id| attached.ids().contains(&id));
                        value
                    })
                })
                .collect();
            for job in jobs {
                match job.join() {
                    Ok(value) => loss += value,
                    Err(panic) => std::panic::resume_unwind(panic),
                }
            }
        });
        let (first, rest) = gradients.split_at_mut(1);
        for other in rest {
            first[0].add(other);
        }
        // The rate falls to nothing, so that the noise of sampling z averages out.
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

/// Equation 5's loss over one shard of windows, averaged over windows and steps.
pub fn negative_log_likelihood(
    tape: &mut Tape,
    model: &SelfModel,
    attached: &Attached,
    windows: &Windows,
    settings: &Settings,
) -> Var {
    let steps = windows.visual.len();
    let batch = windows.visual[0].cols();
    let counted = steps - settings.warm_up.min(steps - 1);
    let weights = tape.input_with(2, batch, |out| {
        for pair in out.chunks_exact_mut(2) {
            pair.copy_from_slice(&settings.weights);
        }
    });
    let mut previous: Option<Var> = None;
    let mut sum: Option<Var> = None;
    let (nothing, unheard) = (Tensor::default(), Tensor::new(model.layout.verbal, batch));
    for t in 0..steps {
        let visual = &windows.visual[t];
        let perception = model.layout.perception;
        let seen = seen_on_tape(tape, attached, perception, visual, &nothing);
        let observed = model.view.on_tape(tape, visual, &unheard, seen, 0);
        let action = tape.input(&windows.previous[t]);
        let (mean, deviation) = model.posterior(tape, previous.map(|z| (z, action)), observed);
        let noise = tape.input(&windows.noise[t]);
        let z = tape.gaussian_sample(mean, deviation, noise);
        previous = Some(z);
        if t < steps - counted {
            continue;
        }
        let ActionOnTape::Gaussian {
            mean,
            deviation,
            delta,
        } = policy_on_tape(tape, model, attached, z)
        else {
            unreachable!("the highway's actions are numbers");
        };
        let taken = tape.input(&windows.action[t]);
        let log_density = tape.gaussian_log_density_weighted(taken, mean, deviation, weights);
        let mut term = tape.mean(log_density);
        term = tape.neg(term);
        if let Some(delta) = delta {
            let squared = tape.square(delta);
            let penalty = tape.mean(squared);
            let penalty = tape.scale(penalty, settings.residual_penalty);
            term = tape.add(term, penalty);
        }
        sum = Some(match sum {
            None => term,
            Some(sum) => tape.add(sum, term),
        });
    }
    let sum = sum.expect("windows have at least one counted step");
    tape.scale(sum, 1.0 / counted as f32)
}

/// −λ log p(χ) of the thresholds, on the scale of the mean over `moments`:
/// Σ_a (τ_a − τ_{a+1})² / 2 s², divided by their number.
pub fn negative_log_prior(
    tape: &mut Tape,
    model: &SelfModel,
    attached: &Attached,
    settings: &Settings,
    moments: usize,
) -> Var {
    let limits = limits_on_tape(tape, attached, model.layout.perception);
    let n = tape.shape(limits).0;
    let (first, rest) = (tape.rows(limits, 0..1), tape.rows(limits, 1..n));
    let next = tape.concat(&[rest, first]);
    let difference = tape.sub(limits, next);
    let squared = tape.square(difference);
    let sum = tape.sum(squared);
    let variance = settings.smoothness_m * settings.smoothness_m;
    tape.scale(sum, 0.5 / (variance * moments.max(1) as f32))
}

/// Names of the self-model's parameters that differ in `parameters` by a single bit.
fn moved(model: &SelfModel, parameters: &Parameters) -> Vec<String> {
    let differs = |a: &Tensor, b: &Tensor| {
        a.data()
            .iter()
            .zip(b.data())
            .any(|(a, b)| a.to_bits() != b.to_bits())
    };
    model
        .parameters
        .iter()
        .filter(|(id, _, tensor)| differs(tensor, parameters.get(*id)))
        .map(|(_, name, _)| name.to_owned())
        .collect()
}
