//! Soft actor-critic on the self-model's latent states (paper §III-A "Policy learning", after SLAC), with a decaying
//! share of imitation of an expert that sees everything.
//!
//! ```text
//! y      = r_{t+1} + γ (1 − end) (min_i Q'_i(z_{t+1}, a') − α log π(a' | z_{t+1})),   a' ~ π(· | z_{t+1})
//! L_Q    = ½ Σ_i (Q_i(z_t, a_t) − y)²
//! L_π    = (1 − β) (α log π(a | z_t) − min_i Q_i(z_t, a)) + β |μ(z_t) − u_expert|² / 2 s²,   a = tanh(u) ~ π
//! L_α    = −α (log π(a | z_t) + target)
//! Q'_i  ← (1 − τ) Q'_i + τ Q_i
//! ```

use domains::ActionSpace;
use models::policy::unsquash;
use models::{ActionDistribution, Scratch, SelfModel};
use nn::{Mlp, ParamId, Parameters, Tape, Tensor, Var};
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
}

impl SacSettings {
    /// Whether these make sense.
    pub(crate) fn is_sound(&self) -> bool {
        let shares = [self.discount, self.target_rate];
        shares.iter().all(|x| (0.0..=1.0).contains(x))
            && self.initial_temperature > 0.0
            && self.initial_temperature.is_finite()
    }
}

/// One shard's transitions in latent space; all `rows × batch`.
#[derive(Clone, Debug)]
pub struct Transitions {
    /// z_t.
    pub z: Tensor,
    /// a_t.
    pub action: Tensor,
    /// The expert's a_t.
    pub expert: Tensor,
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
            reward: Tensor::new(1, batch),
            terminal: Tensor::new(1, batch),
            next: Tensor::new(latent, batch),
            noise: Tensor::new(actions, batch),
            next_noise: Tensor::new(actions, batch),
        }
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
    let squared = tape.mean(squared);
    let imitated = tape.scale(squared, imitation);
    let mean_log_density = tape.mean(log_density);
    (tape.add(soft, imitated), mean_log_density)
}

/// Gradient of L_α with respect to log α, given the batch's mean log π: −α (log π + target).
pub fn temperature_gradient(temperature: f32, mean_log_density: f32, settings: SacSettings) -> f32 {
    -temperature * (mean_log_density + settings.entropy_target)
}
