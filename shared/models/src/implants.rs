//! Model implants: the few parameters that turn the robot's self-model into a model of a person (paper §III-B and appendix,
//! "MIRROR Implants").
//!
//! *Perceptual implant*: the limits of the domain's [`Perception`]; what is farther than its limit is not seen (paper, figure 4).
//!
//! *Policy implant*, where actions are numbers: a small residual δ(z^H) on the mean of the policy's Gaussian, and noise ν on its
//! deviation, N(μ + δ, σ² + ν²): people are less exact than the robot ("simple implants can simply add noise", ibid.). Without
//! the noise, one moment in which a person brakes a little later than the robot would outweigh everything they saw. Where
//! actions are choices: a residual on the logits, p̂ = softmax(Q/temperature + δ(z^H)), where δ = c · tanh(a small network / c):
//! bounded, because a person who is told something is in a state that no round without an assistant shows, and there an
//! unbounded network shouts down what the robot knows.

use crate::policy::{ActionDistribution, Policy};
use crate::self_model::SelfModel;
use domains::{ActionSpace, Perception};
use nn::{Activation, Mlp, MlpScratch, ParamId, Parameters, Tape, Tensor, Var};
use rand_chacha::ChaCha8Rng;

/// Neurons of the residual's hidden layer.
pub const RESIDUAL_HIDDEN: usize = 16;
/// Factor on the residual network's output where it moves a mean.
pub const RESIDUAL_SCALE: f32 = 0.1;
/// c: the most that the policy implant moves a logit by.
pub const RESIDUAL_BOUND: f32 = 1.5;
/// ν before softplus at the start: 0.3.
const FIRST_NOISE: f32 = -1.05;

/// The parameters χ of both implants, apart from the self-model's, which never move when learning from a person.
#[derive(Clone, Debug)]
pub struct Implants {
    /// `implant.limits` (limits × 1, before the logistic function), `implant.residual.*`, `implant.noise`.
    pub parameters: Parameters,
    /// The perception that the limits belong to.
    pub perception: &'static dyn Perception,
    limits: ParamId,
    /// None for MIRROR-P, which has the perceptual implant only.
    policy: Option<PolicyImplant>,
}

/// The policy implant's parts.
#[derive(Clone, Debug)]
pub struct PolicyImplant {
    /// δ: `z → actions`.
    pub residual: Mlp,
    /// ν before softplus, `actions × 1`; none where actions are choices.
    pub noise: Option<ParamId>,
}

/// The implants' parameters inside a larger set, next to the self-model's, so that one tape reaches both.
#[derive(Clone, Debug)]
pub struct Attached {
    /// Limits before the logistic function.
    pub limits: ParamId,
    /// Policy implant.
    pub policy: Option<PolicyImplant>,
    ids: Vec<ParamId>,
}

impl Attached {
    /// The parameters that may move.
    pub fn ids(&self) -> &[ParamId] {
        &self.ids
    }

    /// Of these, the policy implant's.
    pub fn policy_ids(&self) -> &[ParamId] {
        &self.ids[1..]
    }
}

impl Implants {
    /// Every limit at half of the largest, and a residual of zero (its last layer starts at zero).
    pub fn new(model: &SelfModel, with_policy: bool, rng: &mut ChaCha8Rng) -> Self {
        let perception = model.layout.perception;
        let actions = model.layout.actions;
        let mut parameters = Parameters::default();
        let limits = parameters.add("implant.limits", Tensor::new(perception.limits(), 1));
        let policy = with_policy.then(|| {
            let widths = [model.sizes.latent, RESIDUAL_HIDDEN, actions.rows()];
            let residual = Mlp::new(
                &mut parameters,
                "implant.residual",
                &widths,
                Activation::Identity,
                rng,
            );
            if let Some(last) = residual.layers.last() {
                parameters.get_mut(last.weight).fill(0.0);
                parameters.get_mut(last.bias).fill(0.0);
            }
            let noise = match actions {
                ActionSpace::Discrete(_) => None,
                ActionSpace::Continuous(n) => {
                    let mut noise = Tensor::new(n, 1);
                    noise.fill(FIRST_NOISE);
                    Some(parameters.add("implant.noise", noise))
                }
            };
            PolicyImplant { residual, noise }
        });
        Self {
            parameters,
            perception,
            limits,
            policy,
        }
    }

    /// Whether there is a policy implant.
    pub fn has_policy(&self) -> bool {
        self.policy.is_some()
    }

    /// The limits, in the distance's unit.
    pub fn limits(&self) -> Vec<f32> {
        let largest = self.perception.largest();
        let raw = self.parameters.get(self.limits).data();
        raw.iter()
            .map(|raw| largest / (1.0 + (-raw).exp()))
            .collect()
    }

    /// Sets the limits, in the distance's unit; one past the end stays as it is.
    pub fn set_limits(&mut self, limits: &[f32]) {
        let largest = self.perception.largest();
        let raw = self.parameters.get_mut(self.limits).data_mut();
        for (raw, limit) in raw.iter_mut().zip(limits) {
            let share = (limit / largest).clamp(1e-3, 1.0 - 1e-3);
            *raw = (share / (1.0 - share)).ln();
        }
    }

    /// Sets every limit to the same.
    pub fn set_all_limits(&mut self, limit: f32) {
        self.set_limits(&vec![limit; self.perception.limits()]);
    }

    /// ν of each of an action's numbers, before tanh; none without a policy implant, or where actions are choices.
    pub fn noise(&self) -> Option<Vec<f32>> {
        let raw = self.parameters.get(self.policy.as_ref()?.noise?).data();
        Some(raw.iter().map(|raw| raw.exp().ln_1p()).collect())
    }

    /// Copies the implants' parameters to the end of `parameters`.
    pub fn attach(&self, parameters: &mut Parameters) -> Attached {
        let mut ids = Vec::new();
        let mut copy = |id: ParamId| {
            let new = parameters.add(self.parameters.name(id), self.parameters.get(id).clone());
            ids.push(new);
            new
        };
        let limits = copy(self.limits);
        let policy = self.policy.as_ref().map(|policy| {
            let mut residual = policy.residual.clone();
            for layer in &mut residual.layers {
                layer.weight = copy(layer.weight);
                layer.bias = copy(layer.bias);
            }
            let noise = policy.noise.map(copy);
            PolicyImplant { residual, noise }
        });
        Attached {
            limits,
            policy,
            ids,
        }
    }

    /// Takes learned values back out of `parameters`.
    pub fn detach(&mut self, parameters: &Parameters, attached: &Attached) {
        let own: Vec<ParamId> = self.parameters.ids().collect();
        for (own, learned) in own.into_iter().zip(&attached.ids) {
            self.parameters
                .get_mut(own)
                .copy_from(parameters.get(*learned));
        }
    }

    /// Turns the robot's distribution at `z` into the person's; `delta` is scratch.
    pub(crate) fn shift(
        &self,
        z: &Tensor,
        distribution: &mut ActionDistribution,
        scratch: &mut MlpScratch,
        delta: &mut Tensor,
    ) {
        let Some(policy) = &self.policy else {
            return;
        };
        policy.residual.infer(&self.parameters, z, scratch, delta);
        match distribution {
            ActionDistribution::Gaussian { mean, deviation } => {
                for (mean, delta) in mean.data_mut().iter_mut().zip(delta.data()) {
                    *mean += RESIDUAL_SCALE * delta;
                }
                let Some(noise) = policy.noise else {
                    return;
                };
                let raw = self.parameters.get(noise).data();
                for column in deviation.data_mut().chunks_exact_mut(raw.len()) {
                    for (deviation, raw) in column.iter_mut().zip(raw) {
                        let noise = raw.exp().ln_1p();
                        *deviation = (*deviation * *deviation + noise * noise).sqrt();
                    }
                }
            }
            ActionDistribution::Categorical { log_probability } => {
                let log = log_probability.data_mut();
                for (log, delta) in log.iter_mut().zip(delta.data()) {
                    *log += RESIDUAL_BOUND * (delta / RESIDUAL_BOUND).tanh();
                }
                nn::log_softmax_in_place(log_probability);
            }
        }
    }
}

/// The limits on a tape, `limits × 1`, in the distance's unit.
pub fn limits_on_tape(tape: &mut Tape, attached: &Attached, perception: &dyn Perception) -> Var {
    let raw = tape.param(attached.limits);
    let unit = tape.sigmoid(raw);
    tape.scale(unit, perception.largest())
}

/// What is seen of each region on a tape, `regions × batch` of 0 or 1, differentiable in the limits (straight-through).
/// `visual`: whole; `noise`: `noise_rows × batch` standard normals.
pub fn seen_on_tape(
    tape: &mut Tape,
    attached: &Attached,
    perception: &dyn Perception,
    visual: &Tensor,
    noise: &Tensor,
) -> Var {
    let (regions, limits, batch) = (perception.regions(), perception.limits(), visual.cols());
    let all = limits_on_tape(tape, attached, perception);
    let mut governs = vec![0; regions * batch];
    let distance = tape.input_with(regions, batch, |out| {
        let columns = out.chunks_exact_mut(regions);
        for (j, (out, governs)) in columns.zip(governs.chunks_exact_mut(regions)).enumerate() {
            let noise = (noise.rows() > 0).then(|| noise.column(j));
            for (region, (out, governs)) in out.iter_mut().zip(governs).enumerate() {
                (*out, *governs) = perception.distance(region, visual.column(j), noise);
            }
        }
    });
    let own = governs
        .chunks_exact(regions)
        .all(|governs| governs.iter().copied().eq(0..limits));
    if own {
        // Region k has limit k.
        let limit = tape.broadcast(all, batch);
        return tape.threshold(distance, limit, perception.width());
    }
    // Σ_k [region has limit k] τ_k
    let mut limit: Option<Var> = None;
    for k in 0..limits {
        let has = tape.input_with(regions, batch, |out| {
            for (out, governs) in out.iter_mut().zip(&governs) {
                *out = f32::from(u8::from(*governs == k));
            }
        });
        let one = tape.rows(all, k..k + 1);
        let one = tape.broadcast(one, batch);
        let one = tape.spread(one, regions);
        let term = tape.mul(one, has);
        limit = Some(match limit {
            None => term,
            Some(sum) => tape.add(sum, term),
        });
    }
    match limit {
        Some(limit) => tape.threshold(distance, limit, perception.width()),
        None => tape.constant(regions, batch, 1.0),
    }
}

/// The person's action on a tape.
#[derive(Clone, Copy, Debug)]
pub enum ActionOnTape {
    /// Mean and deviation of the action before tanh, `actions × batch` each.
    Gaussian {
        /// μ + δ(z).
        mean: Var,
        /// √(σ² + ν²).
        deviation: Var,
        /// δ, where there is a policy implant.
        delta: Option<Var>,
    },
    /// Logits, `actions × batch`.
    Categorical(Var),
}

/// The person's action at `z` (`latent × batch`).
pub fn policy_on_tape(
    tape: &mut Tape,
    model: &SelfModel,
    attached: &Attached,
    z: Var,
) -> ActionOnTape {
    let implant = attached.policy.as_ref();
    match &model.policy {
        Policy::Boltzmann { q, temperature } => {
            let q = tape.mlp(q, z);
            let logits = tape.scale(q, 1.0 / temperature);
            let Some(implant) = implant else {
                return ActionOnTape::Categorical(logits);
            };
            let delta = tape.mlp(&implant.residual, z);
            let delta = tape.scale(delta, 1.0 / RESIDUAL_BOUND);
            let delta = tape.tanh(delta);
            let delta = tape.scale(delta, RESIDUAL_BOUND);
            ActionOnTape::Categorical(tape.add(logits, delta))
        }
        Policy::SquashedGaussian { actor, .. } => {
            let output = tape.mlp(actor, z);
            let actions = model.layout.actions;
            let (mut mean, mut deviation) = SelfModel::gaussian(tape, output, actions.rows());
            let delta = implant.map(|implant| {
                let delta = tape.mlp(&implant.residual, z);
                tape.scale(delta, RESIDUAL_SCALE)
            });
            if let Some(noise) = implant.and_then(|implant| implant.noise) {
                deviation = widened(tape, deviation, noise);
            }
            if let Some(delta) = delta {
                mean = tape.add(mean, delta);
            }
            ActionOnTape::Gaussian {
                mean,
                deviation,
                delta,
            }
        }
    }
}

/// √(σ² + ν²).
fn widened(tape: &mut Tape, deviation: Var, noise: ParamId) -> Var {
    let batch = tape.shape(deviation).1;
    let raw = tape.param(noise);
    let noise = tape.softplus(raw);
    let noise = tape.square(noise);
    let noise = tape.broadcast(noise, batch);
    let variance = tape.square(deviation);
    let variance = tape.add(variance, noise);
    // σ = exp(½ ln σ²)
    let log = tape.ln(variance);
    let half = tape.scale(log, 0.5);
    tape.exp(half)
}
