//! Model implants: the few numbers that turn the robot's self-model into a model of a person (paper §III-B and appendix, "MIRROR
//! Implants"), and what is known of them: a posterior, as weighted hypotheses.
//!
//! *Perceptual implant*: the limits of the domain's [`Perception`]; what is farther than its limit is not seen (paper, figure 4).
//!
//! *Policy implant*: how the person's choices differ from the robot's in the same belief. With φ(z), z along the directions in which
//! it varied most in the person's rounds, in deviations and held within ±[`REACH`]:
//!
//! ```text
//! choices:  p(a | z) = (1 − ε) softmax_a(β Q(z, a)/T + b_a + w_a · φ(z)) + ε/|A|
//! numbers:  u ~ N(μ(z) + b + W φ(z), σ(z)² + ν²),  a = tanh(u)
//! ```
//!
//! β: how much surer or less sure of their choices people are than the robot. b: habits. W: the residual, as small as its prior
//! makes it and bounded by φ's reach, because a person who is told something is in a state that no round without an assistant shows.
//! ν: people's hands are less exact than the robot ("simple implants can simply add noise", ibid.). ε: lapses, without which one
//! action that nothing explains would outweigh everything the person saw.

use crate::policy::ActionDistribution;
use crate::self_model::SelfModel;
use domains::{ActionSpace, Perception};

/// φ is held within ± this many deviations.
pub const REACH: f32 = 2.5;

/// ν of somebody of whom nothing is known.
const FIRST_NOISE: f32 = 0.3;

/// One hypothesis χ about a person.
#[derive(Clone, Debug, PartialEq)]
pub struct Implants {
    /// Limits of sight, in the order and unit of the domain's [`Perception`].
    pub limits: Vec<f32>,
    /// None for MIRROR-P, which has the perceptual implant only.
    pub policy: Option<PolicyImplant>,
}

/// How a person's choices differ from the robot's.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PolicyImplant {
    /// ln β; 0 where actions are numbers.
    pub log_gain: f32,
    /// b, a number per row of an action.
    pub bias: Vec<f32>,
    /// W, `actions × features`, action by action.
    pub residual: Vec<f32>,
    /// ν, a number per row of an action; empty where actions are choices.
    pub noise: Vec<f32>,
    /// ε; 0 where actions are numbers.
    pub lapse: f32,
}

/// What was learned of a person: hypotheses with their probabilities.
#[derive(Clone, Debug)]
pub struct Posterior {
    /// The perception that the limits belong to.
    pub perception: &'static dyn Perception,
    /// Hypotheses, at least one. All have a policy implant, or none has.
    pub hypotheses: Vec<Implants>,
    /// Their probabilities.
    pub weights: Vec<f32>,
    /// φ; empty without policy implants.
    pub features: Features,
}

/// φ(z)_k = d_k · (z − center) within ±[`REACH`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Features {
    /// Mean of z over the person's rounds, `latent` numbers.
    pub center: Vec<f32>,
    /// d_k, one after the other: `features × latent`. Along each, z varied by 1 in the person's rounds.
    pub directions: Vec<f32>,
}

impl Features {
    /// How many there are.
    pub fn count(&self) -> usize {
        self.directions.len() / self.center.len().max(1)
    }

    /// φ of one z, into `out`.
    pub fn write(&self, z: &[f32], out: &mut [f32]) {
        let directions = self.directions.chunks_exact(self.center.len().max(1));
        for (out, direction) in out.iter_mut().zip(directions) {
            let along: f32 = z
                .iter()
                .zip(&self.center)
                .zip(direction)
                .map(|((z, center), d)| d * (z - center))
                .sum();
            *out = along.clamp(-REACH, REACH);
        }
    }
}

impl Posterior {
    /// One hypothesis, held for certain.
    pub fn certain(
        perception: &'static dyn Perception,
        implants: Implants,
        features: Features,
    ) -> Self {
        Self {
            perception,
            hypotheses: vec![implants],
            weights: vec![1.0],
            features,
        }
    }

    /// A person of whom nothing is known yet: every limit at half of the largest, and choices as the robot's.
    pub fn neutral(model: &SelfModel, with_policy: bool) -> Self {
        let perception = model.layout.perception;
        let actions = model.layout.actions;
        let policy = with_policy.then(|| PolicyImplant {
            bias: vec![0.0; actions.rows()],
            noise: match actions {
                ActionSpace::Discrete(_) => Vec::new(),
                ActionSpace::Continuous(n) => vec![FIRST_NOISE; n],
            },
            ..PolicyImplant::default()
        });
        let features = match with_policy {
            true => Features {
                center: vec![0.0; model.sizes.latent],
                directions: Vec::new(),
            },
            false => Features::default(),
        };
        let limits = vec![perception.largest() / 2.0; perception.limits()];
        Self::certain(perception, Implants { limits, policy }, features)
    }

    /// A person of whom nothing but these limits is known.
    pub fn of_limits(perception: &'static dyn Perception, limits: Vec<f32>) -> Self {
        let implants = Implants {
            limits,
            policy: None,
        };
        Self::certain(perception, implants, Features::default())
    }

    /// Whether there are policy implants.
    pub fn has_policy(&self) -> bool {
        self.hypotheses.iter().any(|h| h.policy.is_some())
    }

    /// Mean of each limit.
    pub fn mean_limits(&self) -> Vec<f32> {
        let mean = |k: usize| {
            let weighted = self.hypotheses.iter().zip(&self.weights);
            weighted.map(|(h, weight)| weight * h.limits[k]).sum()
        };
        (0..self.perception.limits()).map(mean).collect()
    }

    /// Least and greatest of the values of limit `k` that lie in the middle `share` of the probability.
    pub fn interval(&self, k: usize, share: f32) -> [f32; 2] {
        let mut values: Vec<(f32, f32)> = self
            .hypotheses
            .iter()
            .zip(&self.weights)
            .map(|(h, weight)| (h.limits[k], *weight))
            .collect();
        values.sort_by(|a, b| a.0.total_cmp(&b.0));
        let at = |quantile: f32| {
            let mut below = 0.0;
            let found = values.iter().find(|(_, weight)| {
                below += weight;
                below >= quantile
            });
            found
                .or(values.last())
                .map_or(f32::NAN, |(value, _)| *value)
        };
        let tail = (1.0 - share) / 2.0;
        [at(tail), at(1.0 - tail)]
    }

    /// Turns the robot's distribution in belief z (column `j`) into the person's by hypothesis `h`; `phi` is scratch.
    pub(crate) fn shift(
        &self,
        h: usize,
        z: &[f32],
        j: usize,
        distribution: &mut ActionDistribution,
        phi: &mut Vec<f32>,
    ) {
        let Some(policy) = &self.hypotheses[h].policy else {
            return;
        };
        phi.resize(self.features.count(), 0.0);
        self.features.write(z, phi);
        match distribution {
            ActionDistribution::Gaussian { mean, deviation } => {
                let (mean, deviation) = (mean.column_mut(j), deviation.column_mut(j));
                for (row, (mean, deviation)) in mean.iter_mut().zip(deviation).enumerate() {
                    *mean += policy.tendency(row, phi);
                    *deviation = deviation.hypot(policy.noise[row]);
                }
            }
            ActionDistribution::Categorical { log_probability } => {
                policy.choose(log_probability.column_mut(j), phi);
            }
        }
    }
}

impl PolicyImplant {
    /// b_a + w_a · φ.
    pub fn tendency(&self, row: usize, phi: &[f32]) -> f32 {
        let own = &self.residual[row * phi.len()..(row + 1) * phi.len()];
        let residual: f32 = own.iter().zip(phi).map(|(w, phi)| w * phi).sum();
        self.bias[row] + residual
    }

    /// Turns Q/T, or the logarithm of its softmax, into the logarithms of the person's probabilities.
    pub fn choose(&self, logits: &mut [f32], phi: &[f32]) {
        let gain = self.log_gain.exp();
        for (row, logit) in logits.iter_mut().enumerate() {
            *logit = gain * *logit + self.tendency(row, phi);
        }
        let most = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let sum: f32 = logits.iter().map(|logit| (logit - most).exp()).sum();
        let anything = self.lapse / logits.len() as f32;
        for logit in logits {
            let soft = (*logit - most).exp() / sum;
            *logit = ((1.0 - self.lapse) * soft + anything).ln();
        }
    }
}
