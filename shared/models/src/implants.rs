//! Model implants: the few parameters that turn the robot's self-model into a model of a person (paper §III-B).
//!
//! *Perceptual implant*: a threshold per azimuth; what is farther than τ_a is not seen (paper, figure 4).
//! *Policy implant*: a small residual δ(z^H) on the mean of the policy's Gaussian, and noise ν on its deviation,
//! N(μ + δ, σ² + ν²): people are less exact than the robot ("simple implants can simply add noise", ibid.). Without the
//! noise, one moment in which a person brakes a little later than the robot would outweigh everything they saw.

use crate::observation::{AZIMUTHS, BANDS, EGO, RANGE_M, Shape, nearest, nearest_of_all};
use crate::policy::ActionDistribution;
use crate::self_model::SelfModel;
use nn::{Activation, Mlp, MlpScratch, ParamId, Parameters, Tape, Tensor, Var};
use rand_chacha::ChaCha8Rng;

/// Largest threshold: one metre beyond the LIDAR's range, so that "sees that nothing is there" can be represented.
pub const MAX_THRESHOLD_M: f32 = RANGE_M + 1.0;
/// Neurons of the residual's hidden layer (DESIGN §11).
pub const RESIDUAL_HIDDEN: usize = 16;
/// Factor on the residual network's output (DESIGN §11).
pub const RESIDUAL_SCALE: f32 = 0.1;

/// ν before softplus at the start: 0.3.
const FIRST_NOISE: f32 = -1.05;

/// The parameters χ of both implants, apart from the self-model's, which never move when learning from a person.
#[derive(Clone, Debug)]
pub struct Implants {
    /// Thresholds (`36 × 1`, before the logistic function) and the residual's weights.
    pub parameters: Parameters,
    thresholds: ParamId,
    /// None for MIRROR-P, which has the perceptual implant only.
    policy: Option<PolicyImplant>,
    latent: usize,
}

/// The policy implant's parts.
#[derive(Clone, Debug)]
pub struct PolicyImplant {
    /// δ: `z → 2`.
    pub residual: Mlp,
    /// ν before softplus, `2 × 1`.
    pub noise: ParamId,
}

/// The implants' parameters inside a larger set, next to the self-model's, so that one tape reaches both.
#[derive(Clone, Debug)]
pub struct Attached {
    /// Thresholds before the logistic function.
    pub thresholds: ParamId,
    /// Policy implant.
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
    /// Thresholds at half the LIDAR's range, and a residual of zero (its last layer starts at zero).
    pub fn new(latent: usize, actions: usize, with_policy: bool, rng: &mut ChaCha8Rng) -> Self {
        let mut parameters = Parameters::default();
        let thresholds = parameters.add("implant.thresholds", Tensor::new(AZIMUTHS, 1));
        let policy = with_policy.then(|| {
            let residual = Mlp::new(
                &mut parameters,
                "implant.residual",
                &[latent, RESIDUAL_HIDDEN, actions],
                Activation::Identity,
                rng,
            );
            if let Some(last) = residual.layers.last() {
                parameters.get_mut(last.weight).fill(0.0);
                parameters.get_mut(last.bias).fill(0.0);
            }
            let mut noise = Tensor::new(actions, 1);
            noise.fill(FIRST_NOISE);
            let noise = parameters.add("implant.noise", noise);
            PolicyImplant { residual, noise }
        });
        Self {
            parameters,
            thresholds,
            policy,
            latent,
        }
    }

    /// Sets every threshold, in metres between 0 and [`MAX_THRESHOLD_M`].
    pub fn set_thresholds_m(&mut self, threshold_m: f32) {
        let unit = (threshold_m / MAX_THRESHOLD_M).clamp(1e-3, 1.0 - 1e-3);
        let raw = (unit / (1.0 - unit)).ln();
        self.parameters.get_mut(self.thresholds).fill(raw);
    }

    /// Whether there is a policy implant.
    pub fn has_policy(&self) -> bool {
        self.policy.is_some()
    }

    /// Dimensions of the latent that the residual reads.
    pub fn latent(&self) -> usize {
        self.latent
    }

    /// τ_a in metres.
    pub fn thresholds_m(&self) -> [f32; AZIMUTHS] {
        let raw = self.parameters.get(self.thresholds).data();
        core::array::from_fn(|a| MAX_THRESHOLD_M / (1.0 + (-raw[a]).exp()))
    }

    /// Copies the implants' parameters to the end of `parameters`.
    pub fn attach(&self, parameters: &mut Parameters) -> Attached {
        let mut ids = Vec::new();
        let mut copy = |id: ParamId| {
            let new = parameters.add(self.parameters.name(id), self.parameters.get(id).clone());
            ids.push(new);
            new
        };
        let thresholds = copy(self.thresholds);
        let policy = self.policy.as_ref().map(|policy| {
            let mut residual = policy.residual.clone();
            for layer in &mut residual.layers {
                layer.weight = copy(layer.weight);
                layer.bias = copy(layer.bias);
            }
            let noise = copy(policy.noise);
            PolicyImplant { residual, noise }
        });
        Attached {
            thresholds,
            policy,
            ids,
        }
    }

    /// Takes learned values back out of `parameters`.
    pub fn detach(&mut self, parameters: &Parameters, attached: &Attached) {
        let own: Vec<ParamId> = self.parameters.iter().map(|(id, _, _)| id).collect();
        for (own, learned) in own.into_iter().zip(&attached.ids) {
            self.parameters
                .get_mut(own)
                .copy_from(parameters.get(*learned));
        }
    }

    /// Writes what a person with these implants sees of one visual column into `mask` (36 entries of 0 or 1).
    pub fn visible(thresholds_m: &[f32; AZIMUTHS], visual: &[f32], mask: &mut [f32]) {
        let nearest = nearest_of_all(visual);
        for ((mask, nearest), threshold_m) in mask.iter_mut().zip(nearest).zip(thresholds_m) {
            *mask = if range_m(nearest) <= *threshold_m {
                1.0
            } else {
                0.0
            };
        }
    }

    /// Adds δ(z) to the mean of a batch of action distributions and ν to their deviation; `delta` is `2 × batch` scratch.
    pub fn shift(
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
        for (mean, delta) in distribution.mean.data_mut().iter_mut().zip(delta.data()) {
            *mean += RESIDUAL_SCALE * delta;
        }
        let raw = self.parameters.get(policy.noise).data();
        let rows = raw.len();
        for column in distribution.deviation.data_mut().chunks_exact_mut(rows) {
            for (deviation, raw) in column.iter_mut().zip(raw) {
                let noise = raw.exp().ln_1p();
                *deviation = (*deviation * *deviation + noise * noise).sqrt();
            }
        }
    }

    /// ν of throttle and steer, before tanh; none without a policy implant.
    pub fn noise(&self) -> Option<[f32; 2]> {
        let raw = self.parameters.get(self.policy.as_ref()?.noise).data();
        Some([raw[0].exp().ln_1p(), raw[1].exp().ln_1p()])
    }
}

/// Range in metres of an azimuth's nearest return. Decoders may imagine nearness outside [0, 1].
pub fn range_of(visual: &[f32], azimuth: usize) -> f32 {
    range_m(nearest(visual, azimuth))
}

fn range_m(nearness: f32) -> f32 {
    RANGE_M * (1.0 - nearness.clamp(0.0, 1.0))
}

/// How softly the straight-through threshold passes gradients, in metres: wide enough that a car several metres beyond
/// the threshold still pulls at it.
pub const THRESHOLD_WIDTH_M: f32 = 4.0;

/// τ in metres on a tape, `36 × 1`.
pub fn thresholds_on_tape(tape: &mut Tape, attached: &Attached) -> Var {
    let raw = tape.param(attached.thresholds);
    let unit = tape.sigmoid(raw);
    tape.scale(unit, MAX_THRESHOLD_M)
}

/// What the encoder sees of a batch through the perceptual implant, differentiable in the thresholds (straight-through):
/// `encoded × batch`. `visual`: `113 × batch`; nothing is spoken.
pub fn perceive_on_tape(
    tape: &mut Tape,
    attached: &Attached,
    shape: &Shape,
    visual: &Tensor,
) -> Var {
    let batch = visual.cols();
    let beams = AZIMUTHS * BANDS;
    let range_m = tape.input_with(AZIMUTHS, batch, |out| {
        for j in 0..batch {
            let column = visual.column(j);
            for azimuth in 0..AZIMUTHS {
                out[j * AZIMUTHS + azimuth] = range_of(column, azimuth);
            }
        }
    });
    let limit = thresholds_on_tape(tape, attached);
    let limit = tape.broadcast(limit, batch);
    let mask = tape.threshold(range_m, limit, THRESHOLD_WIDTH_M);
    let nearness = tape.input_with(beams, batch, |out| {
        for j in 0..batch {
            out[j * beams..(j + 1) * beams].copy_from_slice(&visual.column(j)[..beams]);
        }
    });
    let ego = tape.input_with(EGO, batch, |out| {
        for j in 0..batch {
            out[j * EGO..(j + 1) * EGO].copy_from_slice(&visual.column(j)[beams..]);
        }
    });
    let mask_of_beams = tape.concat(&[mask; BANDS]);
    let seen = tape.mul(nearness, mask_of_beams);
    let unheard = tape.input_with(shape.verbal + shape.verbal_mask, batch, |out| {
        out.fill(0.0);
    });
    tape.concat(&[seen, ego, mask, unheard])
}

/// The person's action before tanh, N(μ + δ(z), σ² + ν²): mean and deviation, `2 × batch` each, and δ.
pub fn policy_on_tape(
    tape: &mut Tape,
    model: &SelfModel,
    attached: &Attached,
    z: Var,
) -> (Var, Var, Option<Var>) {
    let actions = model.sizes.shape.action;
    let output = tape.mlp(&model.policy.network, z);
    let (mean, deviation) = SelfModel::gaussian(tape, output, actions);
    let Some(policy) = &attached.policy else {
        return (mean, deviation, None);
    };
    let delta = tape.mlp(&policy.residual, z);
    let delta = tape.scale(delta, RESIDUAL_SCALE);
    let batch = tape.shape(mean).1;
    let raw = tape.param(policy.noise);
    let noise = tape.softplus(raw);
    let noise = tape.square(noise);
    let noise = tape.broadcast(noise, batch);
    let variance = tape.square(deviation);
    let variance = tape.add(variance, noise);
    // σ = exp(½ ln σ²)
    let log = tape.ln(variance);
    let half = tape.scale(log, 0.5);
    let deviation = tape.exp(half);
    (tape.add(mean, delta), deviation, Some(delta))
}
