//! The gridworlds' implants: the few parameters that turn the robot's self-model into a model of a person (paper §III-B and
//! appendix, "MIRROR Implants").
//!
//! *Perceptual implant*: the limits of [`Perceiver`]. *Policy implant*: a residual δ(z^H) on the logits of the categorical policy,
//! p̂ = softmax(Q/temperature · e^s + δ(z^H)); the sharpness s lets people be more or less sure than the robot everywhere, as the
//! highway's implant does with noise.

use super::perception::Perceiver;
use super::self_model::DiscreteModel;
use crate::policy::ActionDistribution;
use nn::{Activation, Mlp, MlpScratch, ParamId, Parameters, Tape, Tensor, Var};
use rand_chacha::ChaCha8Rng;

/// Neurons of the residual's hidden layer, as on the highway (DESIGN §11).
pub const RESIDUAL_HIDDEN: usize = 16;

/// The parameters χ of both implants, apart from the self-model's, which never move when learning from a person.
#[derive(Clone, Debug)]
pub struct Implants {
    /// `implant.limits` (limits × 1, before the logistic function), `implant.residual.*`, `implant.sharpness`.
    pub parameters: Parameters,
    /// The perception that they belong to.
    pub perceiver: Perceiver,
    limits: ParamId,
    policy: Option<PolicyImplant>,
}

/// The policy implant's parts.
#[derive(Clone, Debug)]
pub struct PolicyImplant {
    /// δ: `z → actions`.
    pub residual: Mlp,
    /// s, 1 × 1.
    pub sharpness: ParamId,
}

/// The implants' parameters next to the self-model's in a larger set, so that one tape reaches both.
#[derive(Clone, Debug)]
pub struct Attached {
    /// Limits before the logistic function.
    pub limits: ParamId,
    /// None for MIRROR-P, which has the perceptual implant only.
    pub policy: Option<PolicyImplant>,
    ids: Vec<ParamId>,
}

impl Attached {
    /// The parameters that may move.
    pub fn ids(&self) -> &[ParamId] {
        &self.ids
    }
}

impl Implants {
    /// Every limit at half of the largest, and no residual.
    pub fn new(model: &DiscreteModel, with_policy: bool, rng: &mut ChaCha8Rng) -> Self {
        let perceiver = Perceiver::new(&model.layout);
        let mut parameters = Parameters::default();
        let limits = parameters.add("implant.limits", Tensor::new(perceiver.limits(), 1));
        let policy = with_policy.then(|| {
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
            let sharpness = parameters.add("implant.sharpness", Tensor::new(1, 1));
            PolicyImplant {
                residual,
                sharpness,
            }
        });
        Self {
            parameters,
            perceiver,
            limits,
            policy,
        }
    }

    /// Whether there is a policy implant.
    pub fn has_policy(&self) -> bool {
        self.policy.is_some()
    }

    /// The limits, in cells or as probabilities.
    pub fn limits(&self) -> Vec<f32> {
        let largest = self.perceiver.largest();
        let raw = self.parameters.get(self.limits).data();
        raw.iter()
            .map(|raw| largest / (1.0 + (-raw).exp()))
            .collect()
    }

    /// Sets every limit to this share of the largest.
    pub fn set_limits(&mut self, share: f32) {
        let share = share.clamp(1e-3, 1.0 - 1e-3);
        self.parameters
            .get_mut(self.limits)
            .fill((share / (1.0 - share)).ln());
    }

    /// s; 0 without a policy implant.
    pub fn sharpness(&self) -> f32 {
        self.policy
            .as_ref()
            .map_or(0.0, |p| self.parameters.get(p.sharpness).data()[0])
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
            let sharpness = copy(policy.sharpness);
            PolicyImplant {
                residual,
                sharpness,
            }
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

    /// Turns the robot's log-probabilities at `z` into the person's.
    pub(super) fn shift(
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
        let sharpness = self.sharpness().exp();
        let log = distribution.log_probability.data_mut();
        for (log, delta) in log.iter_mut().zip(delta.data()) {
            *log = *log * sharpness + delta;
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

/// Logits of the person's action at `z`, `actions × batch`, and δ.
pub fn policy_on_tape(
    tape: &mut Tape,
    model: &DiscreteModel,
    attached: &Attached,
    z: Var,
) -> (Var, Option<Var>) {
    let q = tape.mlp(&model.q, z);
    let logits = tape.scale(q, 1.0 / model.sizes.temperature);
    let Some(policy) = &attached.policy else {
        return (logits, None);
    };
    let (actions, batch) = tape.shape(logits);
    let sharpness = tape.param(policy.sharpness);
    let sharpness = tape.exp(sharpness);
    let sharpness = tape.broadcast(sharpness, batch);
    let sharpness = tape.spread(sharpness, actions);
    let sharpened = tape.mul(logits, sharpness);
    let delta = tape.mlp(&policy.residual, z);
    (tape.add(sharpened, delta), Some(delta))
}
