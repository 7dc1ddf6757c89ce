//! The policy that belongs to a self-model, and distributions over actions: a Gaussian squashed by tanh (soft actor-critic)
//! where actions are numbers, softmax(Q/temperature) where they are choices.

use crate::filter::split_gaussian;
use crate::sizes::Sizes;
use domains::ActionSpace;
use nn::{Activation, Mlp, MlpScratch, Parameters, Tensor};
use rand_chacha::ChaCha8Rng;

/// π_ψ and Q_ψ.
#[derive(Clone, Debug)]
pub enum Policy {
    /// Continuous actions.
    SquashedGaussian {
        /// `z → [mean; deviation before softplus]` of the action before tanh.
        actor: Mlp,
        /// The two critics Q_ψ: `[z; a] → Q`.
        critics: [Mlp; 2],
    },
    /// Choices.
    Boltzmann {
        /// Q_ψ: `z →` the value of each action.
        q: Mlp,
        /// Temperature of softmax(Q / temperature), by which actions have likelihoods.
        temperature: f32,
    },
}

impl Policy {
    /// Untrained networks.
    pub(crate) fn new(
        sizes: &Sizes,
        actions: ActionSpace,
        p: &mut Parameters,
        rng: &mut ChaCha8Rng,
    ) -> Self {
        let (latent, hidden) = (sizes.latent, sizes.policy_hidden);
        let mut net = |name: &str, input: usize, output: usize| {
            let widths = [input, hidden, hidden, output];
            Mlp::new(p, name, &widths, Activation::Identity, rng)
        };
        match actions {
            ActionSpace::Continuous(n) => Self::SquashedGaussian {
                actor: net("policy", latent, 2 * n),
                critics: [
                    net("critic_1", latent + n, 1),
                    net("critic_2", latent + n, 1),
                ],
            },
            ActionSpace::Discrete(n) => Self::Boltzmann {
                q: net("q", latent, n),
                temperature: sizes.temperature,
            },
        }
    }

    /// Actor and critics.
    ///
    /// # Panics
    /// If actions are choices.
    pub fn actor_critic(&self) -> (&Mlp, &[Mlp; 2]) {
        match self {
            Self::SquashedGaussian { actor, critics } => (actor, critics),
            Self::Boltzmann { .. } => panic!("a policy over choices has no actor"),
        }
    }

    /// The network of the actions' values, and the temperature.
    ///
    /// # Panics
    /// If actions are numbers.
    pub fn q(&self) -> (&Mlp, f32) {
        match self {
            Self::Boltzmann { q, temperature } => (q, *temperature),
            Self::SquashedGaussian { .. } => panic!("there is no value for each of all actions"),
        }
    }
}

/// A batch of action distributions, `actions × batch`.
#[derive(Clone, Debug)]
pub enum ActionDistribution {
    /// a = tanh(u), u ~ N(mean, deviation²).
    Gaussian {
        /// Mean of u.
        mean: Tensor,
        /// Deviation of u.
        deviation: Tensor,
    },
    /// One of a few choices; as an action, a column of zeros with a one.
    Categorical {
        /// Log-probability of each choice.
        log_probability: Tensor,
    },
}

/// Actions are kept this far inside (−1, 1) where their u is needed: people do press pedals to the floor.
pub const ACTION_EDGE: f32 = 0.97;

/// u = atanh(a) of an action that a person took.
pub fn unsquash(action: f32) -> f32 {
    action.clamp(-ACTION_EDGE, ACTION_EDGE).atanh()
}

impl ActionDistribution {
    /// Room for a batch of actions.
    pub fn new(actions: ActionSpace, batch: usize) -> Self {
        match actions {
            ActionSpace::Continuous(n) => Self::Gaussian {
                mean: Tensor::new(n, batch),
                deviation: Tensor::new(n, batch),
            },
            ActionSpace::Discrete(n) => Self::Categorical {
                log_probability: Tensor::new(n, batch),
            },
        }
    }

    /// Rows and columns of the actions.
    pub fn shape(&self) -> (usize, usize) {
        match self {
            Self::Gaussian { mean: held, .. }
            | Self::Categorical {
                log_probability: held,
            } => (held.rows(), held.cols()),
        }
    }

    /// Mean and deviation of u; none of choices.
    pub fn gaussian(&self) -> Option<(&Tensor, &Tensor)> {
        match self {
            Self::Gaussian { mean, deviation } => Some((mean, deviation)),
            Self::Categorical { .. } => None,
        }
    }

    /// Log-probabilities of choices; none of numbers.
    pub fn log_probability(&self) -> Option<&Tensor> {
        match self {
            Self::Categorical { log_probability } => Some(log_probability),
            Self::Gaussian { .. } => None,
        }
    }

    /// What a network says at `x` (`features × batch`): twice as many outputs as there are numbers in an action, or a logit
    /// for each choice, to be divided by `temperature`.
    pub fn infer(
        &mut self,
        network: &Mlp,
        temperature: f32,
        p: &Parameters,
        x: &Tensor,
        scratch: &mut HeadScratch,
    ) {
        match self {
            Self::Gaussian { mean, deviation } => {
                network.infer(p, x, &mut scratch.mlp, &mut scratch.output);
                split_gaussian(&scratch.output, mean, deviation);
            }
            Self::Categorical { log_probability } => {
                network.infer(p, x, &mut scratch.mlp, log_probability);
                let inverse = 1.0 / temperature;
                for value in log_probability.data_mut() {
                    *value *= inverse;
                }
                nn::log_softmax_in_place(log_probability);
            }
        }
    }

    /// One distribution out of a batch's columns, which have these weights: of choices their mixture, of numbers the Gaussian with
    /// the mixture's mean and deviation.
    pub fn mix(&self, weights: &[f32], out: &mut Self) {
        match (self, out) {
            (
                Self::Gaussian { mean, deviation },
                Self::Gaussian {
                    mean: out_mean,
                    deviation: out_deviation,
                },
            ) => {
                if weights.len() == 1 {
                    out_mean.copy_from(mean);
                    out_deviation.copy_from(deviation);
                    return;
                }
                let out = out_mean.column_mut(0).iter_mut();
                let out = out.zip(out_deviation.column_mut(0));
                for (row, (out_mean, out_deviation)) in out.enumerate() {
                    let (mut sum, mut square) = (0.0, 0.0);
                    for (j, weight) in weights.iter().enumerate() {
                        let (m, s) = (mean.column(j)[row], deviation.column(j)[row]);
                        sum += weight * m;
                        square += weight * (s * s + m * m);
                    }
                    (*out_mean, *out_deviation) = (sum, (square - sum * sum).max(0.0).sqrt());
                }
            }
            (
                Self::Categorical { log_probability },
                Self::Categorical {
                    log_probability: out,
                },
            ) => {
                if weights.len() == 1 {
                    out.copy_from(log_probability);
                    return;
                }
                for (row, out) in out.column_mut(0).iter_mut().enumerate() {
                    let terms = weights.iter().enumerate();
                    let sum: f32 = terms
                        .map(|(j, weight)| weight * log_probability.column(j)[row].exp())
                        .sum();
                    *out = sum.max(f32::MIN_POSITIVE).ln();
                }
            }
            _ => unreachable!("both are of one action space"),
        }
    }

    /// Samples into `actions`: a = tanh(μ + σ ε), or a choice as a column with a one; the mode where `noise` is none.
    /// `noise`: standard normals of the actions' shape (choices need two rows or more).
    pub fn sample(&self, noise: Option<&[f32]>, actions: &mut Tensor) {
        let (mean, deviation) = match self {
            Self::Gaussian { mean, deviation } => (mean, deviation),
            Self::Categorical { log_probability } => {
                return choose(log_probability, noise, actions);
            }
        };
        actions.resize_to(mean.rows(), mean.cols());
        let out = actions.data_mut();
        match noise {
            None => {
                for (a, mean) in out.iter_mut().zip(mean.data()) {
                    *a = mean.tanh();
                }
            }
            Some(noise) => {
                let gaussians = mean.data().iter().zip(deviation.data()).zip(noise);
                for (a, ((mean, deviation), noise)) in out.iter_mut().zip(gaussians) {
                    *a = (mean + deviation * noise).tanh();
                }
            }
        }
    }

    /// log π(a | z) of column `j`. Gaussian: a density over a ∈ (−1, 1), per dimension
    /// log N(u; μ, σ²) − log(1 − a²), u = atanh(a). Categorical: the chosen one's log-probability.
    pub fn log_density(&self, j: usize, action: &[f32]) -> f32 {
        let (mean, deviation) = match self {
            Self::Gaussian { mean, deviation } => (mean.column(j), deviation.column(j)),
            Self::Categorical { log_probability } => {
                return log_probability.column(j)[largest(action)];
            }
        };
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

/// One caller's memory for [`ActionDistribution::infer`].
#[derive(Clone, Debug, Default)]
pub struct HeadScratch {
    mlp: MlpScratch,
    output: Tensor,
}

/// A choice per column.
fn choose(log_probability: &Tensor, noise: Option<&[f32]>, actions: &mut Tensor) {
    let (choices, batch) = (log_probability.rows(), log_probability.cols());
    actions.resize_to(choices, batch);
    actions.fill(0.0);
    for j in 0..batch {
        let log = log_probability.column(j);
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
