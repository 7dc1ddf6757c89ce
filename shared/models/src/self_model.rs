//! The self-model: a multi-modal latent state-space model (paper §III-A, equations 1–4), its evidence lower bound, and
//! the filter that follows a world with it.
//!
//! ```text
//! p(x, r, z, a) = Π_t [Π_m p_θ(x^m_t | z_t)] p_θ(r_t | z_t) p_θ(z_t | z_{t−1}, a_{t−1}) p_ψ(a_{t−1} | z_{t−1}) p(z_0)
//! q_φ(z_t | z_{t−1}, a_{t−1}, x_t) = N(g^μ_φ(·), g^Σ_φ(·))
//! ```

use crate::observation::{Encoded, Observations, Shape};
use crate::policy::Policy;
use nn::{Activation, Mlp, MlpScratch, Parameters, Tape, Tensor, Var};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Sizes and fixed deviations. The sizes are the paper's (appendix, "CARLA"); the deviations are ours: they set how much
/// each modality counts in the ELBO, a tenth of the visual modality's range and half of the others' unit of variation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sizes {
    /// Modalities and action.
    pub shape: Shape,
    /// Dimensions of z.
    pub latent: usize,
    /// Neurons of each hidden layer.
    pub hidden: usize,
    /// σ of p(x^visual | z).
    pub visual_deviation: f32,
    /// σ of p(x^verbal | z).
    pub verbal_deviation: f32,
    /// σ of p(r | z).
    pub reward_deviation: f32,
}

impl Sizes {
    /// The highway's.
    pub const HIGHWAY: Self = Self {
        shape: Shape::HIGHWAY,
        latent: 128,
        hidden: 128,
        visual_deviation: 0.1,
        verbal_deviation: 0.5,
        reward_deviation: 0.5,
    };
}

/// The networks f_θ, g_φ, d^m_θ, r_θ and π_ψ with their parameters.
#[derive(Clone, Debug)]
pub struct SelfModel {
    /// Sizes.
    pub sizes: Sizes,
    /// Every parameter of the networks below.
    pub parameters: Parameters,
    /// f_θ: `[z; a] → [mean; deviation before softplus]`.
    pub transition: Mlp,
    /// g_φ of the first step: `[x; masks] → [mean; deviation]`.
    pub first: Mlp,
    /// g_φ of the other steps: `[z; a; x; masks] → [mean; deviation]`.
    pub encoder: Mlp,
    /// d^visual_θ: `z → x̂^visual`.
    pub visual: Mlp,
    /// d^verbal_θ: `z → x̂^verbal`.
    pub verbal: Mlp,
    /// r_θ: `z → r̂`.
    pub reward: Mlp,
    /// π_ψ.
    pub policy: Policy,
    /// The two critics Q_ψ: `[z; a] → Q`.
    pub critics: [Mlp; 2],
}

impl SelfModel {
    /// Untrained networks.
    pub fn new(sizes: Sizes, rng: &mut ChaCha8Rng) -> Self {
        let Sizes {
            shape,
            latent,
            hidden,
            ..
        } = sizes;
        let mut p = Parameters::default();
        let mut net = |name: &str, input: usize, output: usize| {
            Mlp::new(
                &mut p,
                name,
                &[input, hidden, hidden, output],
                Activation::Identity,
                rng,
            )
        };
        let transition = net("transition", latent + shape.action, 2 * latent);
        let first = net("first", shape.encoded(), 2 * latent);
        let encoder = net(
            "encoder",
            latent + shape.action + shape.encoded(),
            2 * latent,
        );
        let visual = net("visual", latent, shape.visual);
        let verbal = net("verbal", latent, shape.verbal);
        let reward = net("reward", latent, 1);
        let policy = net("policy", latent, 2 * shape.action);
        let critics = [
            net("critic_1", latent + shape.action, 1),
            net("critic_2", latent + shape.action, 1),
        ];
        Self {
            sizes,
            parameters: p,
            transition,
            first,
            encoder,
            visual,
            verbal,
            reward,
            policy: Policy { network: policy },
            critics,
        }
    }

    /// Splits a network's output into mean and deviation: `2n × batch → (n × batch, n × batch)`.
    pub fn gaussian(tape: &mut Tape, output: Var, n: usize) -> (Var, Var) {
        let mean = tape.rows(output, 0..n);
        let raw = tape.rows(output, n..2 * n);
        let soft = tape.softplus(raw);
        (mean, tape.clamp(soft, nn::SMALLEST_DEVIATION, f32::MAX))
    }

    /// p_θ(z_t | z_{t−1}, a_{t−1}) on a tape.
    pub fn prior(&self, tape: &mut Tape, z: Var, action: Var) -> (Var, Var) {
        let input = tape.concat(&[z, action]);
        let output = tape.mlp(&self.transition, input);
        Self::gaussian(tape, output, self.sizes.latent)
    }

    /// q_φ(z_t | z_{t−1}, a_{t−1}, x_t) on a tape; `previous` is none at the first step. `observed`: `encoded × batch`.
    pub fn posterior(
        &self,
        tape: &mut Tape,
        previous: Option<(Var, Var)>,
        observed: Var,
    ) -> (Var, Var) {
        let output = match previous {
            None => tape.mlp(&self.first, observed),
            Some((z, action)) => {
                let input = tape.concat(&[z, action, observed]);
                tape.mlp(&self.encoder, input)
            }
        };
        Self::gaussian(tape, output, self.sizes.latent)
    }

    /// The evidence lower bound, negated, averaged over batch and steps (paper, equation 3):
    ///
    /// ```text
    /// L_e = Σ_t ( E_q[Σ_m log p_θ(x^m_t | z_t)] + E_q[log p_θ(r_t | z_t)] − E_q[KL(q_φ(z_t) ‖ p_θ(z_t | z_{t−1}, a_{t−1}))] )
    /// ```
    ///
    /// Observations go into q_φ masked and are reconstructed whole: what was dropped has to be inferred. At the first
    /// step the prior is N(0, 1). Normalising constants of the fixed-deviation Gaussians are left out.
    /// Returns the loss and a sample of each z_t.
    pub fn negative_elbo(&self, tape: &mut Tape, sequence: &Sequence) -> ElboTerms {
        let Sizes {
            latent,
            visual_deviation,
            verbal_deviation,
            reward_deviation,
            ..
        } = self.sizes;
        let steps = sequence.steps.len();
        let batch = sequence.steps[0].reward.cols();
        let mut previous: Option<Var> = None;
        let mut z = Vec::with_capacity(steps);
        let (mut reconstruction, mut reward_term, mut divergence) = (None, None, None);
        let accumulate = |tape: &mut Tape, sum: &mut Option<Var>, term: Var| {
            *sum = Some(match *sum {
                None => term,
                Some(sum) => tape.add(sum, term),
            });
        };
        for step in &sequence.steps {
            let observed = tape.input(&step.observed);
            let action = tape.input(&step.action);
            let noise = tape.input(&step.noise);
            let (prior_mean, prior_deviation) = match previous {
                None => (
                    tape.input_with(latent, batch, |x| x.fill(0.0)),
                    tape.input_with(latent, batch, |x| x.fill(1.0)),
                ),
                Some(previous) => self.prior(tape, previous, action),
            };
            let (mean, deviation) = self.posterior(tape, previous.map(|z| (z, action)), observed);
            let sample = tape.gaussian_sample(mean, deviation, noise);

            let kl = tape.gaussian_kl(mean, deviation, prior_mean, prior_deviation);
            accumulate(tape, &mut divergence, kl);
            for (decoder, target, deviation) in [
                (&self.visual, &step.visual, visual_deviation),
                (&self.verbal, &step.verbal, verbal_deviation),
            ] {
                let decoded = tape.mlp(decoder, sample);
                let error = squared_error(tape, decoded, target, deviation);
                accumulate(tape, &mut reconstruction, error);
            }
            let decoded = tape.mlp(&self.reward, sample);
            let error = squared_error(tape, decoded, &step.reward, reward_deviation);
            accumulate(tape, &mut reward_term, error);
            previous = Some(sample);
            z.push(sample);
        }
        let mut average = |sum: Option<Var>| {
            let mean = tape.mean(sum.expect("a sequence has at least one step"));
            tape.scale(mean, 1.0 / steps as f32)
        };
        let (reconstruction, reward, divergence) = (
            average(reconstruction),
            average(reward_term),
            average(divergence),
        );
        let loss = tape.add(reconstruction, reward);
        let loss = tape.add(loss, divergence);
        ElboTerms {
            loss,
            reconstruction,
            reward,
            divergence,
            z,
        }
    }
}

/// −log N(target | decoded, σ²) without its constant, summed over features: `1 × batch`.
fn squared_error(tape: &mut Tape, decoded: Var, target: &Tensor, deviation: f32) -> Var {
    let target = tape.input(target);
    let difference = tape.sub(decoded, target);
    let squared = tape.square(difference);
    let summed = tape.sum_rows(squared);
    tape.scale(summed, 0.5 / (deviation * deviation))
}

/// A batch of sequences of equal length, made for [`SelfModel::negative_elbo`].
#[derive(Clone, Debug, Default)]
pub struct Sequence {
    /// One entry per step.
    pub steps: Vec<SequenceStep>,
}

/// One step of a batch of sequences; all tensors are `features × batch`.
#[derive(Clone, Debug)]
pub struct SequenceStep {
    /// What q_φ sees: masked observation and masks, `encoded × batch`.
    pub observed: Tensor,
    /// The whole visual modality.
    pub visual: Tensor,
    /// The whole verbal modality.
    pub verbal: Tensor,
    /// a_{t−1}; zeros at the first step.
    pub action: Tensor,
    /// r_t, `1 × batch`.
    pub reward: Tensor,
    /// ε of z_t = μ + σ ε.
    pub noise: Tensor,
}

impl SequenceStep {
    /// Zeros.
    pub fn new(sizes: &Sizes, batch: usize) -> Self {
        let shape = sizes.shape;
        Self {
            observed: Tensor::new(shape.encoded(), batch),
            visual: Tensor::new(shape.visual, batch),
            verbal: Tensor::new(shape.verbal, batch),
            action: Tensor::new(shape.action, batch),
            reward: Tensor::new(1, batch),
            noise: Tensor::new(sizes.latent, batch),
        }
    }
}

/// The ELBO's terms as variables of the tape that computed them.
#[derive(Clone, Debug)]
pub struct ElboTerms {
    /// −L_e per step.
    pub loss: Var,
    /// −Σ_m log p(x^m | z).
    pub reconstruction: Var,
    /// −log p(r | z).
    pub reward: Var,
    /// KL(q ‖ p).
    pub divergence: Var,
    /// Samples of z_t, one variable per step.
    pub z: Vec<Var>,
}

/// Follows a world with q_φ, without a tape and without allocating: the belief of a batch, `latent × batch`.
///
/// Between steps the belief is carried by its mean; the planner samples z ~ N(mean, deviation) where it needs samples.
#[derive(Clone, Debug)]
pub struct Filter {
    /// Mean of z.
    pub mean: Tensor,
    /// Deviation of z.
    pub deviation: Tensor,
    /// Whether nothing was observed yet.
    pub fresh: bool,
    output: Tensor,
    scratch: MlpScratch,
}

impl Filter {
    /// A belief of somebody who saw nothing yet.
    pub fn new(latent: usize, batch: usize) -> Self {
        Self {
            mean: Tensor::new(latent, batch),
            deviation: Tensor::new(latent, batch),
            fresh: true,
            output: Tensor::new(2 * latent, batch),
            scratch: MlpScratch::default(),
        }
    }

    /// Forgets everything: an episode begins.
    pub fn reset(&mut self) {
        self.fresh = true;
    }

    /// z_{t} ← q_φ(z_{t−1}, a_{t−1}, x_t). `action`: `2 × batch`, ignored at the first step.
    pub fn update(&mut self, model: &SelfModel, action: &Tensor, observed: &Encoded) {
        let p = &model.parameters;
        if self.fresh {
            model
                .first
                .infer(p, &observed.rows, &mut self.scratch, &mut self.output);
        } else {
            model.encoder.infer_stacked(
                p,
                &[&self.mean, action, &observed.rows],
                &mut self.scratch,
                &mut self.output,
            );
        }
        self.fresh = false;
        split_gaussian(&self.output, &mut self.mean, &mut self.deviation);
    }
}

/// Splits a network's output into mean and deviation (softplus, at least 1e-4).
pub fn split_gaussian(output: &Tensor, mean: &mut Tensor, deviation: &mut Tensor) {
    let n = output.rows() / 2;
    mean.resize_to(n, output.cols());
    deviation.resize_to(n, output.cols());
    for j in 0..output.cols() {
        let column = output.column(j);
        mean.column_mut(j).copy_from_slice(&column[..n]);
        deviation.column_mut(j).copy_from_slice(&column[n..]);
    }
    nn::softplus_in_place(deviation);
}

/// Decodes beliefs: x̂ = d(z), r̂ = r(z).
#[derive(Clone, Debug, Default)]
pub struct Decoder {
    scratch: MlpScratch,
}

impl Decoder {
    /// x̂^visual and x̂^verbal of `z` (`latent × batch`).
    pub fn observations(&mut self, model: &SelfModel, z: &Tensor, out: &mut Observations) {
        self.visual(model, z, &mut out.visual);
        self.verbal(model, z, &mut out.verbal);
    }

    /// x̂^visual of `z`.
    pub fn visual(&mut self, model: &SelfModel, z: &Tensor, out: &mut Tensor) {
        model
            .visual
            .infer(&model.parameters, z, &mut self.scratch, out);
    }

    /// x̂^verbal of `z`.
    pub fn verbal(&mut self, model: &SelfModel, z: &Tensor, out: &mut Tensor) {
        model
            .verbal
            .infer(&model.parameters, z, &mut self.scratch, out);
    }

    /// r̂ of `z`, `1 × batch`.
    pub fn reward(&mut self, model: &SelfModel, z: &Tensor, out: &mut Tensor) {
        model
            .reward
            .infer(&model.parameters, z, &mut self.scratch, out);
    }

    /// The smaller of the two critics' values of (z, a), `1 × batch` (`spare` is scratch of the same shape).
    pub fn value(
        &mut self,
        model: &SelfModel,
        z: &Tensor,
        action: &Tensor,
        out: &mut Tensor,
        spare: &mut Tensor,
    ) {
        let p = &model.parameters;
        let [first, second] = &model.critics;
        first.infer_stacked(p, &[z, action], &mut self.scratch, out);
        second.infer_stacked(p, &[z, action], &mut self.scratch, spare);
        for (value, other) in out.data_mut().iter_mut().zip(spare.data()) {
            *value = value.min(*other);
        }
    }
}

/// Steps z forward through p_θ: samples z_t ~ p(z_t | f_θ(z_{t−1}, a_{t−1})) for a batch.
#[derive(Clone, Debug)]
pub struct Dynamics {
    output: Tensor,
    scratch: MlpScratch,
    mean: Tensor,
    deviation: Tensor,
}

impl Dynamics {
    /// Scratch for a latent of this size.
    pub fn new(latent: usize) -> Self {
        Self {
            output: Tensor::new(2 * latent, 0),
            scratch: MlpScratch::default(),
            mean: Tensor::new(latent, 0),
            deviation: Tensor::new(latent, 0),
        }
    }

    /// `z` (`latent × batch`) becomes the next step's sample; `noise` holds standard normals of the same shape.
    pub fn step(&mut self, model: &SelfModel, z: &mut Tensor, action: &Tensor, noise: &[f32]) {
        model.transition.infer_stacked(
            &model.parameters,
            &[z, action],
            &mut self.scratch,
            &mut self.output,
        );
        split_gaussian(&self.output, &mut self.mean, &mut self.deviation);
        sample(&self.mean, &self.deviation, noise, z);
    }
}

/// z = μ + σ ε, elementwise.
pub fn sample(mean: &Tensor, deviation: &Tensor, noise: &[f32], z: &mut Tensor) {
    z.resize_to(mean.rows(), mean.cols());
    for (((z, mean), deviation), noise) in z
        .data_mut()
        .iter_mut()
        .zip(mean.data())
        .zip(deviation.data())
        .zip(noise)
    {
        *z = mean + deviation * noise;
    }
}
