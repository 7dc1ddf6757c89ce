//! Distributions over actions: a Gaussian squashed by tanh (soft actor-critic, the highway) or a choice among a few
//! (Boltzmann over Q-values, the gridworlds).

use crate::self_model::split_gaussian;
use nn::{Mlp, MlpScratch, Parameters, Tensor};

/// Network of the policy: `z → [mean; deviation before softplus]` of the action before tanh.
#[derive(Clone, Debug)]
pub struct Policy {
    /// Three dense layers.
    pub network: Mlp,
}

/// What kind of action a distribution is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Family {
    /// a = tanh(u), u ~ N(mean, deviation²).
    Gaussian,
    /// One of a few choices; as an action, a column of zeros with a one.
    Categorical,
}

/// A batch of action distributions, `actions × batch`.
#[derive(Clone, Debug)]
pub struct ActionDistribution {
    /// Which of the fields below hold.
    pub family: Family,
    /// Gaussian: mean of u. Empty for choices.
    pub mean: Tensor,
    /// Gaussian: deviation of u. Empty for choices.
    pub deviation: Tensor,
    /// Categorical: log-probability of each choice. Empty for Gaussians.
    pub log_probability: Tensor,
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
    /// Room for a batch of Gaussian actions.
    pub fn new(actions: usize, batch: usize) -> Self {
        Self {
            family: Family::Gaussian,
            log_probability: Tensor::default(),
            mean: Tensor::new(actions, batch),
            deviation: Tensor::new(actions, batch),
            output: Tensor::new(2 * actions, batch),
            scratch: MlpScratch::default(),
        }
    }

    /// Room for a batch of choices among `choices`.
    pub fn categorical(choices: usize, batch: usize) -> Self {
        Self {
            family: Family::Categorical,
            mean: Tensor::default(),
            deviation: Tensor::default(),
            log_probability: Tensor::new(choices, batch),
            output: Tensor::default(),
            scratch: MlpScratch::default(),
        }
    }

    /// Rows and columns of the actions.
    pub fn shape(&self) -> (usize, usize) {
        let held = match self.family {
            Family::Gaussian => &self.mean,
            Family::Categorical => &self.log_probability,
        };
        (held.rows(), held.cols())
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

    /// Samples into `actions`: a = tanh(μ + σ ε), or a choice as a column with a one; the mode where `noise` is none.
    /// `noise`: standard normals of the actions' shape (choices need two rows or more).
    pub fn sample(&self, noise: Option<&[f32]>, actions: &mut Tensor) {
        if self.family == Family::Categorical {
            self.choose(noise, actions);
            return;
        }
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

    /// A choice per column.
    fn choose(&self, noise: Option<&[f32]>, actions: &mut Tensor) {
        let (choices, batch) = self.shape();
        actions.resize_to(choices, batch);
        actions.fill(0.0);
        for j in 0..batch {
            let log = self.log_probability.column(j);
            let choice = match noise {
                None => largest(log),
                // exp(−(a² + b²)/2) of two independent standard normals is uniform on (0, 1].
                Some(noise) => {
                    let (a, b) = (noise[j * choices], noise[j * choices + 1]);
                    let uniform = (-0.5 * (a * a + b * b)).exp();
                    let mut below = 0.0;
                    let passed = log[..choices - 1].iter().take_while(|log| {
                        below += log.exp();
                        below < uniform
                    });
                    passed.count()
                }
            };
            actions.column_mut(j)[choice] = 1.0;
        }
    }

    /// log π(a | z) of column `j`. Gaussian: a density over a ∈ (−1, 1), per dimension
    /// log N(u; μ, σ²) − log(1 − a²), u = atanh(a). Categorical: the chosen one's log-probability.
    pub fn log_density(&self, j: usize, action: &[f32]) -> f32 {
        if self.family == Family::Categorical {
            return self.log_probability.column(j)[largest(action)];
        }
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

/// Place of the largest number, the first among equals.
pub fn largest(values: &[f32]) -> usize {
    let mut best = 0;
    for (i, value) in values.iter().enumerate() {
        if *value > values[best] {
            best = i;
        }
    }
    best
}
