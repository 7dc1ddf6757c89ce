//! Soft actor-critic on the self-model's latent states (paper §III-A "Policy learning", after SLAC), with a decaying
//! share of imitation of an expert that sees as much as the policy does: imitating one who sees more would teach the policy to act on
//! what it cannot know (the imitation gap; Weihs et al. 2021).
//!
//! ```text
//! y      = r_{t+1} + γ (1 − end) (min_i Q'_i(z_{t+1}, a') − α log π(a' | z_{t+1})),   a' ~ π(· | z_{t+1})
//! L_Q    = ½ Σ_i (Q_i(z_t, a_t) − y)²
//! L_π    = (1 − β) (α log π(a | z_t) − min_i Q_i(z_t, a)) + β [an expert sees as much] |μ(z_t) − u_expert|² / 2 s²,   a = tanh(u) ~ π
//! L_α    = −α (log π(a | z_t) + target)
//! Q'_i  ← (1 − τ) Q'_i + τ Q_i
//! ```

use crate::batches::Shard;
use crate::config::Checked;
use crate::self_model::{Losses, Schedule};
use domains::ActionSpace;
use models::policy::unsquash;
use models::self_model::ElboTerms;
use models::{ActionDistribution, Scratch, SelfModel};
use nn::{Arena, Gradients, Mlp, ParamId, Parameters, Tape, Tensor, Var, noise};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SacSettings {
    /// γ.
    pub discount: f32,
    /// τ.
    pub target_rate: f32,
    /// α at the start.
    pub initial_temperature: f32,
    /// Entropy that α aims at: −|A|.
    pub entropy_target: f32,
    /// The actor's share β of imitation falls no lower than this, while the expert's share of the driving goes on falling. With
    /// the paper's schedule alone, the few hundred rounds that a training of minutes has end with a policy that keeps its lane
    /// but has not yet found that changing it pays.
    pub imitation_floor: f32,
    /// s: deviation of the expert's action, before tanh, in the imitation term. Fixed: with the policy's own deviation, a
    /// likelihood that sharpens on the many moments of cruising explodes on the few in which the expert taps the brake.
    pub imitation_deviation: f32,
}

impl Checked for SacSettings {
    fn problem(&self) -> Option<String> {
        let shares = [self.discount, self.target_rate, self.imitation_floor];
        let positive = [self.initial_temperature, self.imitation_deviation];
        (!shares.iter().all(|x| (0.0..=1.0).contains(x))
            || !positive.iter().all(|x| x.is_finite() && *x > 0.0))
        .then(|| {
            "sac: discount, target_rate and imitation_floor lie in [0, 1], initial_temperature and imitation_deviation are \
             positive"
                .to_owned()
        })
    }
}

/// Target critics and temperature of a run, and what moves them.
pub(crate) struct Sac {
    settings: SacSettings,
    pub targets: TargetCritics,
    /// log α, and Adam's moments of it: first, second, steps.
    pub temperature: [f32; 4],
    /// World model, critics, actor.
    pub parts: Vec<Vec<ParamId>>,
}

/// One shard's memory.
pub(crate) struct SacScratch {
    transitions: Transitions,
    targets: TargetScratch,
}

impl SacScratch {
    pub fn new(model: &SelfModel, shard: &Shard) -> Self {
        let batch = shard.batch.columns * (shard.batch.steps - 1);
        let actions = model.sizes.shape.action;
        Self {
            transitions: Transitions::new(model.sizes.latent, actions, batch),
            targets: TargetScratch::new(actions, batch),
        }
    }

    /// Draws the noise of a gradient step.
    pub fn draw(&mut self, rng: &mut ChaCha8Rng) {
        let Transitions {
            noise, next_noise, ..
        } = &mut self.transitions;
        noise::fill(noise.data_mut(), rng.random(), 0);
        noise::fill(next_noise.data_mut(), rng.random(), 0);
    }
}

impl Sac {
    pub fn new(model: &SelfModel, settings: SacSettings) -> Self {
        let ids = |prefix: &str| model.parameters.ids_with_prefix(prefix);
        let (critics, actor) = (ids("critic"), ids("policy"));
        let world = model.parameters.ids();
        let world = world.filter(|id| !critics.contains(id) && !actor.contains(id));
        Self {
            targets: TargetCritics::new(&model.parameters, model.policy.actor_critic().1),
            temperature: [settings.initial_temperature.ln(), 0.0, 0.0, 0.0],
            parts: vec![world.collect(), critics, actor],
            settings,
        }
    }

    /// α.
    pub fn temperature(&self) -> f32 {
        self.temperature[0].exp()
    }

    /// Losses and gradients of one shard.
    pub fn step(
        &self,
        model: &SelfModel,
        shard: &Shard,
        schedule: Schedule,
        scratch: &mut SacScratch,
        arena: &mut Arena,
        gradients: &mut Gradients,
    ) -> Losses {
        let SacScratch {
            transitions,
            targets,
        } = scratch;
        let [world, critics, actor] = [0, 1, 2].map(|part| &self.parts[part]);
        let temperature = self.temperature();
        let mut losses = Losses::default();
        {
            let mut tape = Tape::new(&model.parameters, arena);
            let elbo = model.negative_elbo(&mut tape, &shard.batch);
            losses.loss = tape.scalar(elbo.loss);
            losses.reconstruction = tape.scalar(elbo.reconstruction);
            losses.reward = tape.scalar(elbo.reward);
            losses.divergence = tape.scalar(elbo.divergence);
            losses.ending = tape.scalar(elbo.ending);
            transitions.collect(tape.value(elbo.z), shard);
            let total = lighter(&mut tape, &elbo, schedule.divergence);
            let (total, foresight) = foreseeing(&mut tape, model, shard, &elbo, schedule, total);
            losses.foresight = foresight;
            tape.backward(total, gradients, &|id| world.contains(&id));
        }
        targets.compute(
            model,
            &self.targets,
            transitions,
            temperature,
            self.settings,
        );
        {
            let mut tape = Tape::new(&model.parameters, arena);
            let loss = critic_loss(&mut tape, model, transitions, &targets.y);
            losses.value = tape.scalar(loss);
            tape.backward(loss, gradients, &|id| critics.contains(&id));
        }
        let imitation = schedule.expert.max(self.settings.imitation_floor);
        let deviation = self.settings.imitation_deviation;
        let weights = [1.0 - imitation, 0.5 * imitation / (deviation * deviation)];
        let mut tape = Tape::new(&model.parameters, arena);
        let (loss, log_density) = actor_loss(&mut tape, model, transitions, temperature, weights);
        losses.policy = tape.scalar(loss);
        losses.log_density = tape.scalar(log_density);
        tape.backward(loss, gradients, &|id| actor.contains(&id));
        losses
    }

    /// Moves the targets, and α by a step of Adam on log α, a single number.
    pub fn follow(&mut self, online: &Parameters, log_density: f32, learning_rate: f32) {
        self.targets.follow(online, self.settings.target_rate);
        let gradient = temperature_gradient(self.temperature(), log_density, self.settings);
        let [log, first, second, steps] = &mut self.temperature;
        *steps += 1.0;
        *first = 0.9 * *first + 0.1 * gradient;
        *second = 0.999 * *second + 0.001 * gradient * gradient;
        let mean = *first / (1.0 - 0.9_f32.powf(*steps));
        let square = *second / (1.0 - 0.999_f32.powf(*steps));
        *log -= learning_rate * mean / (square.sqrt() + 1e-8);
        // Imitation narrows the policy below the entropy that α aims at. Left alone, α would grow until entropy outweighed
        // everything else; so it may only fall.
        *log = log.min(self.settings.initial_temperature.ln());
    }
}

/// −ELBO with another weight of its divergence.
pub(crate) fn lighter(tape: &mut Tape, elbo: &ElboTerms, divergence: f32) -> Var {
    let less = tape.scale(elbo.divergence, divergence - 1.0);
    tape.add(elbo.loss, less)
}

/// Adds the loss of foresight ([`SelfModel::foresight`]) from a sixth into the sequences, unless it has no weight; and its value.
pub(crate) fn foreseeing(
    tape: &mut Tape,
    model: &SelfModel,
    shard: &Shard,
    elbo: &ElboTerms,
    schedule: Schedule,
    total: Var,
) -> (Var, f32) {
    if schedule.foresight == 0.0 {
        return (total, 0.0);
    }
    let foresight = model.foresight(tape, &shard.batch, elbo.z, shard.batch.steps / 6);
    let weighted = tape.scale(foresight, schedule.foresight);
    (tape.add(total, weighted), tape.scalar(foresight))
}

/// One shard's transitions in latent space; all `rows × batch`.
#[derive(Clone, Debug)]
pub struct Transitions {
    /// z_t.
    pub z: Tensor,
    /// a_t.
    pub action: Tensor,
    /// The a_t of an expert who sees as much.
    pub expert: Tensor,
    /// 1 where there is one.
    pub imitated: Tensor,
    /// r_{t+1}.
    pub reward: Tensor,
    /// 1 where t + 1 has no future.
    pub terminal: Tensor,
    /// z_{t+1}.
    pub next: Tensor,
    /// Noise of a ~ π(z_t).
    pub noise: Tensor,
    /// Noise of a' ~ π(z_{t+1}).
    pub next_noise: Tensor,
}

impl Transitions {
    /// Room for `batch` transitions.
    pub fn new(latent: usize, actions: usize, batch: usize) -> Self {
        Self {
            z: Tensor::new(latent, batch),
            action: Tensor::new(actions, batch),
            expert: Tensor::new(actions, batch),
            imitated: Tensor::from_slice(1, batch, &vec![1.0; batch]),
            reward: Tensor::new(1, batch),
            terminal: Tensor::new(1, batch),
            next: Tensor::new(latent, batch),
            noise: Tensor::new(actions, batch),
            next_noise: Tensor::new(actions, batch),
        }
    }
}

impl Transitions {
    /// Gathers (z_t, a_t, r_{t+1}, z_{t+1}) of all steps of a shard, side by side. `z`: `latent × (steps · columns)`.
    fn collect(&mut self, z: &[f32], shard: &Shard) {
        let (batch, columns) = (&shard.batch, shard.batch.columns);
        let earlier = |to: &mut Tensor, from: &[f32]| {
            let n = to.data().len();
            to.data_mut().copy_from_slice(&from[..n]);
        };
        let later = |to: &mut Tensor, from: &[f32]| {
            let first = to.rows() * columns;
            to.data_mut().copy_from_slice(&from[first..]);
        };
        earlier(&mut self.z, z);
        later(&mut self.next, z);
        later(&mut self.action, batch.action.data());
        later(&mut self.reward, batch.reward.data());
        earlier(&mut self.expert, shard.expert.data());
        earlier(&mut self.imitated, shard.imitated.data());
        later(&mut self.terminal, shard.batch.ended.data());
    }
}

/// Target critics Q', which follow two critics slowly.
#[derive(Clone, Debug)]
pub struct TargetCritics {
    /// Their parameters.
    pub parameters: Parameters,
    networks: [Mlp; 2],
    pairs: Vec<(ParamId, ParamId)>,
}

impl TargetCritics {
    /// Copies of `critics`, whose parameters stand in `online`.
    pub fn new(online: &Parameters, critics: &[Mlp; 2]) -> Self {
        let mut parameters = Parameters::default();
        let mut pairs = Vec::new();
        let networks = critics.clone().map(|mut network| {
            for layer in &mut network.layers {
                for id in [&mut layer.weight, &mut layer.bias] {
                    let name = format!("target.{}", online.name(*id));
                    let own = parameters.add(&name, online.get(*id).clone());
                    pairs.push((own, *id));
                    *id = own;
                }
            }
            network
        });
        Self {
            parameters,
            networks,
            pairs,
        }
    }

    /// Q' ← (1 − τ) Q' + τ Q.
    pub fn follow(&mut self, online: &Parameters, rate: f32) {
        for &(own, source) in &self.pairs {
            let own = self.parameters.get_mut(own).data_mut();
            for (own, source) in own.iter_mut().zip(online.get(source).data()) {
                *own += rate * (source - *own);
            }
        }
    }
}

/// The soft values of a batch of states, in memory that is reused.
pub struct SoftValues {
    /// π(· | s).
    pub distribution: ActionDistribution,
    action: Tensor,
    mlp: nn::MlpScratch,
    q: [Tensor; 2],
    /// V of each state.
    pub values: Vec<f32>,
}

impl SoftValues {
    /// Memory for actions of so many numbers.
    pub fn new(actions: usize) -> Self {
        Self {
            distribution: ActionDistribution::new(ActionSpace::Continuous(actions), 1),
            action: Tensor::default(),
            mlp: nn::MlpScratch::default(),
            q: [Tensor::default(), Tensor::default()],
            values: Vec::new(),
        }
    }

    /// V(s) = min_i Q'_i(s, a) − α log π(a | s) of every column of `states`, a = tanh(μ + σ ε) by [`Self::distribution`], which
    /// has to be known; `noise`: ε, as many standard normals as the actions have numbers.
    pub fn compute(
        &mut self,
        states: &Tensor,
        targets: &TargetCritics,
        noise: &[f32],
        temperature: f32,
    ) {
        self.distribution.sample(Some(noise), &mut self.action);
        for (network, q) in targets.networks.iter().zip(&mut self.q) {
            let input = [states, &self.action];
            network.infer_stacked(&targets.parameters, &input, &mut self.mlp, q);
        }
        self.values.clear();
        let Some((mean, std)) = self.distribution.gaussian() else {
            return; // made for numbers in `new`
        };
        let actions = self.action.rows();
        for j in 0..states.cols() {
            let mut log_density = 0.0;
            for i in 0..actions {
                let (noise, std) = (noise[j * actions + i], std.column(j)[i]);
                let u = mean.column(j)[i] + std * noise;
                log_density += -0.5 * noise * noise - std.ln() - HALF_LOG_TAU - log_det(u);
            }
            let q = self.q[0].data()[j].min(self.q[1].data()[j]);
            self.values.push(q - temperature * log_density);
        }
    }
}

/// Scratch for the targets of one shard.
pub struct TargetScratch {
    soft: SoftValues,
    scratch: Scratch,
    /// y, `1 × batch`.
    pub y: Tensor,
}

impl TargetScratch {
    /// Room for `batch` transitions.
    pub fn new(actions: usize, batch: usize) -> Self {
        Self {
            soft: SoftValues::new(actions),
            scratch: Scratch::default(),
            y: Tensor::new(1, batch),
        }
    }

    /// Computes y.
    pub fn compute(
        &mut self,
        model: &SelfModel,
        targets: &TargetCritics,
        transitions: &Transitions,
        temperature: f32,
        settings: SacSettings,
    ) {
        let (next, noise) = (&transitions.next, transitions.next_noise.data());
        let soft = &mut self.soft;
        model.act(&mut self.scratch, next, &mut soft.distribution);
        soft.compute(next, targets, noise, temperature);
        for (j, future) in soft.values.iter().enumerate() {
            self.y.data_mut()[j] = transitions.reward.data()[j]
                + settings.discount * (1.0 - transitions.terminal.data()[j]) * future;
        }
    }
}

/// ½ ln 2π.
const HALF_LOG_TAU: f32 = 0.918_938_5;

/// log(1 − tanh²u), stable for large |u|.
fn log_det(u: f32) -> f32 {
    let x = -2.0 * u;
    let softplus = x.max(0.0) + (-x.abs()).exp().ln_1p();
    2.0 * (core::f32::consts::LN_2 - u - softplus)
}

/// L_Q of a shard. `y`: `1 × batch`.
pub fn critic_loss(tape: &mut Tape, model: &SelfModel, shard: &Transitions, y: &Tensor) -> Var {
    let z = tape.input(&shard.z);
    let action = tape.input(&shard.action);
    let input = tape.concat(&[z, action]);
    let y = tape.input(y);
    let (_, [first, second]) = model.policy.actor_critic();
    let mut half = |critic: &Mlp| {
        let q = tape.mlp(critic, input);
        let error = tape.sub(q, y);
        let squared = tape.square(error);
        let mean = tape.mean(squared);
        tape.scale(mean, 0.5)
    };
    let (first, second) = (half(first), half(second));
    tape.add(first, second)
}

/// α log π(a | s) − min_i Q_i(s, a) of every state, `1 × batch`, and log π(a | s), for a = tanh(μ + σ ε). `output`: the actor's
/// at `states`; `noise`: ε, `actions × batch`.
pub fn soft_policy_terms(
    tape: &mut Tape,
    (states, output): (Var, Var),
    critics: &[Mlp; 2],
    noise: &Tensor,
    temperature: f32,
) -> SoftPolicy {
    let (mean, std) = SelfModel::gaussian(tape, output, noise.rows());
    let noise = tape.input(noise);
    let u = tape.gaussian_sample(mean, std, noise);
    let density = tape.gaussian_log_density(u, mean, std);
    let squash = tape.tanh_log_det(u);
    let log_density = tape.sub(density, squash);
    let action = tape.tanh(u);
    let input = tape.concat(&[states, action]);
    let first = tape.mlp(&critics[0], input);
    let second = tape.mlp(&critics[1], input);
    let q = tape.min(first, second);
    let entropy = tape.scale(log_density, temperature);
    SoftPolicy {
        loss: tape.sub(entropy, q),
        log_density,
        mean,
    }
}

/// See [`soft_policy_terms`].
pub struct SoftPolicy {
    /// α log π(a | s) − min_i Q_i(s, a).
    pub loss: Var,
    /// log π(a | s).
    pub log_density: Var,
    /// μ(s).
    pub mean: Var,
}

/// L_π of a shard with weights (1 − β, β / 2 s²), and the mean of log π(a | z) for the temperature.
pub fn actor_loss(
    tape: &mut Tape,
    model: &SelfModel,
    shard: &Transitions,
    temperature: f32,
    [reinforcement, imitation]: [f32; 2],
) -> (Var, Var) {
    let actions = shard.action.rows();
    let z = tape.input(&shard.z);
    let (actor, critics) = model.policy.actor_critic();
    let output = tape.mlp(actor, z);
    let SoftPolicy {
        loss,
        log_density,
        mean,
    } = soft_policy_terms(tape, (z, output), critics, &shard.noise, temperature);
    let soft = tape.mean(loss);
    let soft = tape.scale(soft, reinforcement);

    let expert = tape.input_with(actions, shard.expert.cols(), |out| {
        for (u, a) in out.iter_mut().zip(shard.expert.data()) {
            *u = unsquash(*a);
        }
    });
    let difference = tape.sub(mean, expert);
    let squared = tape.square(difference);
    let squared = tape.sum_rows(squared);
    let counts = tape.input(&shard.imitated);
    let squared = tape.mul(squared, counts);
    let squared = tape.mean(squared);
    let imitated = tape.scale(squared, imitation);
    let mean_log_density = tape.mean(log_density);
    (tape.add(soft, imitated), mean_log_density)
}

/// Gradient of L_α with respect to log α, given the batch's mean log π: −α (log π + target).
pub fn temperature_gradient(temperature: f32, mean_log_density: f32, settings: SacSettings) -> f32 {
    -temperature * (mean_log_density + settings.entropy_target)
}
