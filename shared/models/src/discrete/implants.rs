//! The gridworlds' implants: the few parameters that turn the robot's self-model into a model of a person (paper §III-B and
//! appendix, "MIRROR Implants").
//!
//! *Perceptual implant*: the limits of [`Perceiver`]. *Policy implant*: a residual δ(z^H) on the logits of the categorical policy,
//! p̂ = softmax(Q/temperature + δ(z^H)), where δ = c · tanh(a small network / c): bounded, because a person who is told something is in
//! a state that no round without an assistant shows, and there an unbounded network shouts down what the robot knows.

use super::perception::Perceiver;
use super::self_model::DiscreteModel;
use crate::policy::ActionDistribution;
use nn::{Activation, Mlp, MlpScratch, ParamId, Parameters, Tape, Tensor, Var};
use rand_chacha::ChaCha8Rng;

/// Neurons of the residual's hidden layer, as on the highway (DESIGN §11).
pub const RESIDUAL_HIDDEN: usize = 16;

/// c: the most that the policy implant moves a logit by.
pub const RESIDUAL_BOUND: f32 = 1.5;

/// The parameters χ of both implants, apart from the self-model's, which never move when learning from a person.
#[derive(Clone, Debug)]
pub struct Implants {
    /// `implant.limits` (limits × 1, before the logistic function), `implant.residual.*`.
    pub parameters: Parameters,
    /// The perception that they belong to.
    pub perceiver: Perceiver,
    limits: ParamId,
    /// δ: `z → actions`.
    residual: Option<Mlp>,
}

/// The implants' parameters next to the self-model's in a larger set, so that one tape reaches both.
#[derive(Clone, Debug)]
pub struct Attached {
    /// Limits before the logistic function.
    pub limits: ParamId,
    /// δ; none for MIRROR-P, which has the perceptual implant only.
    pub residual: Option<Mlp>,
    ids: Vec<ParamId>,
}

impl Attached {
    /// The parameters that may move.
    pub fn ids(&self) -> &[ParamId] {
        &self.ids
    }

    /// Of these, the residual's.
    pub fn residual_ids(&self) -> &[ParamId] {
        &self.ids[1..]
    }
}

impl Implants {
    /// Every limit at half of the largest, and no residual.
    pub fn new(model: &DiscreteModel, with_policy: bool, rng: &mut ChaCha8Rng) -> Self {
        let perceiver = Perceiver::new(&model.layout);
        let mut parameters = Parameters::default();
        let limits = parameters.add("implant.limits", Tensor::new(perceiver.limits(), 1));
        let residual = with_policy.then(|| {
            let residual = Mlp::new(
                &mut parameters,
                "implant.residual",
                &[
                    model.sizes.latent,
                    RESIDUAL_HIDDEN,
                    model.sizes.shape.action,
                ],
                Activation::Identity,
                rng,
            );
            if let Some(last) = residual.layers.last() {
                parameters.get_mut(last.weight).fill(0.0);
                parameters.get_mut(last.bias).fill(0.0);
            }
            residual
        });
        Self {
            parameters,
            perceiver,
            limits,
            residual,
        }
    }

    /// Whether there is a policy implant.
    pub fn has_policy(&self) -> bool {
        self.residual.is_some()
    }

    /// The limits, in cells or as probabilities.
    pub fn limits(&self) -> Vec<f32> {
        let largest = self.perceiver.largest();
        let raw = self.parameters.get(self.limits).data();
        raw.iter()
            .map(|raw| largest / (1.0 + (-raw).exp()))
            .collect()
    }

    /// Sets the limits, in cells or as probabilities; one past the end stays as it is.
    pub fn set_limits(&mut self, limits: &[f32]) {
        let largest = self.perceiver.largest();
        let raw = self.parameters.get_mut(self.limits).data_mut();
        for (raw, limit) in raw.iter_mut().zip(limits) {
            let share = (limit / largest).clamp(1e-3, 1.0 - 1e-3);
            *raw = (share / (1.0 - share)).ln();
        }
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
        let residual = self.residual.as_ref().map(|residual| {
            let mut residual = residual.clone();
            for layer in &mut residual.layers {
                layer.weight = copy(layer.weight);
                layer.bias = copy(layer.bias);
            }
            residual
        });
        Attached {
            limits,
            residual,
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

    /// Turns the robot's log-probabilities at `z` into the person's.
    pub(super) fn shift(
        &self,
        z: &Tensor,
        distribution: &mut ActionDistribution,
        scratch: &mut MlpScratch,
        delta: &mut Tensor,
    ) {
        let Some(residual) = &self.residual else {
            return;
        };
        residual.infer(&self.parameters, z, scratch, delta);
        let log = distribution.log_probability.data_mut();
        for (log, delta) in log.iter_mut().zip(delta.data()) {
            *log += RESIDUAL_BOUND * (delta / RESIDUAL_BOUND).tanh();
        }
        nn::log_softmax_in_place(&mut distribution.log_probability);
    }
}

/// What is seen of each region on a tape, `regions × batch` of 0 or 1, differentiable in the limits (straight-through).
/// `visual`: whole; `noise`: `noise_rows × batch` standard normals.
pub fn seen_on_tape(
    tape: &mut Tape,
    attached: &Attached,
    perceiver: &Perceiver,
    visual: &Tensor,
    noise: &Tensor,
) -> Var {
    let (regions, limits, batch) = (perceiver.regions(), perceiver.limits(), visual.cols());
    let raw = tape.param(attached.limits);
    let unit = tape.sigmoid(raw);
    let all = tape.scale(unit, perceiver.largest());
    let of = |j: usize, region: usize| {
        let noise = (noise.rows() > 0).then(|| noise.column(j));
        perceiver.distance(region, visual.column(j), noise)
    };
    let distance = tape.input_with(regions, batch, |out| {
        for (j, out) in out.chunks_exact_mut(regions).enumerate() {
            for (region, out) in out.iter_mut().enumerate() {
                *out = of(j, region).0;
            }
        }
    });
    // Σ_k [region has limit k] τ_k
    let mut limit: Option<Var> = None;
    for k in 0..limits {
        let governs = tape.input_with(regions, batch, |out| {
            for (j, out) in out.chunks_exact_mut(regions).enumerate() {
                for (region, out) in out.iter_mut().enumerate() {
                    *out = f32::from(u8::from(of(j, region).1 == k));
                }
            }
        });
        let one = tape.rows(all, k..k + 1);
        let one = tape.broadcast(one, batch);
        let one = tape.spread(one, regions);
        let term = tape.mul(one, governs);
        limit = Some(match limit {
            None => term,
            Some(sum) => tape.add(sum, term),
        });
    }
    match limit {
        Some(limit) => tape.threshold(distance, limit, perceiver.width()),
        None => tape.constant(regions, batch, 1.0),
    }
}

/// Logits of the person's action at `z`, `actions × batch`.
pub fn policy_on_tape(tape: &mut Tape, model: &DiscreteModel, attached: &Attached, z: Var) -> Var {
    let q = tape.mlp(&model.q, z);
    let logits = tape.scale(q, 1.0 / model.sizes.temperature);
    let Some(residual) = &attached.residual else {
        return logits;
    };
    let delta = tape.mlp(residual, z);
    let delta = tape.scale(delta, 1.0 / RESIDUAL_BOUND);
    let delta = tape.tanh(delta);
    let delta = tape.scale(delta, RESIDUAL_BOUND);
    tape.add(logits, delta)
}
