//! The policy π_ψ: a Gaussian squashed by tanh (soft actor-critic), and what a policy implant does to it.

use crate::self_model::split_gaussian;
use nn::{Mlp, MlpScratch, Parameters, Tensor};

/// Network of the policy: `z → [mean; deviation before softplus]` of the action before tanh.
#[derive(Clone, Debug)]
pub struct Policy {
    /// Three dense layers.
    pub network: Mlp,
}

/// A batch of action distributions a = tanh(u), u ~ N(mean, deviation²): `2 × batch`.
#[derive(Clone, Debug)]
pub struct ActionDistribution {
    /// Mean of u.
    pub mean: Tensor,
    /// Deviation of u.
    pub deviation: Tensor,
    output: Tensor,
    scratch: MlpScratch,
}

/// Actions are kept this far inside (−1, 1) where their u is needed: people do press pedals to the floor.
pub const ACTION_EDGE: f32 = 0.97;

/// u = atanh(a) of an action that a person took.
pub fn unsquash(action: f32) -> f32 {
    action.clamp(-ACTION_EDGE, ACTION_EDGE).atanh()
}

impl ActionDistribution {
    /// Room for a batch of actions.
    pub fn new(actions: usize, batch: usize) -> Self {
        Self {
            mean: Tensor::new(actions, batch),
            deviation: Tensor::new(actions, batch),
            output: Tensor::new(2 * actions, batch),
            scratch: MlpScratch::default(),
        }
    }

    /// π_ψ(· | z) for `z`: `latent × batch`.
    pub fn infer(&mut self, policy: &Policy, p: &Parameters, z: &Tensor) {
        self.infer_network(&policy.network, p, z);
    }

    /// As [`Self::infer`], with any network of twice as many outputs as there are actions.
    pub fn infer_network(&mut self, network: &Mlp, p: &Parameters, z: &Tensor) {
        network.infer(p, z, &mut self.scratch, &mut self.output);
        split_gaussian(&self.output, &mut self.mean, &mut self.deviation);
    }

    /// Samples a = tanh(μ + σ ε) into `actions`; the mode's tanh(μ) where `noise` is none.
    pub fn sample(&self, noise: Option<&[f32]>, actions: &mut Tensor) {
        actions.resize_to(self.mean.rows(), self.mean.cols());
        let out = actions.data_mut();
        match noise {
            None => {
                for (a, mean) in out.iter_mut().zip(self.mean.data()) {
                    *a = mean.tanh();
                }
            }
            Some(noise) => {
                for (((a, mean), deviation), noise) in out
                    .iter_mut()
                    .zip(self.mean.data())
                    .zip(self.deviation.data())
                    .zip(noise)
                {
                    *a = (mean + deviation * noise).tanh();
                }
            }
        }
    }

    /// log π(a | z) of column `j`, as a density over a ∈ (−1, 1): per dimension
    /// log N(u; μ, σ²) − log(1 − a²), u = atanh(a).
    pub fn log_density(&self, j: usize, action: &[f32]) -> f32 {
        let mean = self.mean.column(j);
        let deviation = self.deviation.column(j);
        let mut sum = 0.0;
        for i in 0..action.len() {
            let u = unsquash(action[i]);
            let a = u.tanh();
            let scaled = (u - mean[i]) / deviation[i];
            sum += -0.5 * scaled * scaled
                - deviation[i].ln()
                - 0.5 * (2.0 * core::f32::consts::PI).ln()
                - (1.0 - a * a).ln();
        }
        sum
    }
}
