//! The self-model: a multi-modal latent state-space model (paper §III-A, equations 1–4) and its evidence lower bound. The
//! filter that follows a world with it, and everything else without a tape, stands in [`crate::filter`].
//!
//! ```text
//! p(x, r, z, a) = Π_t [Π_m p_θ(x^m_t | z_t)] p_θ(r_t | z_t) p_θ(z_t | z_{t−1}, a_{t−1}) p_ψ(a_{t−1} | z_{t−1}) p(z_0)
//! q_φ(z_t | z_{t−1}, a_{t−1}, x_t) = N(g^μ_φ(·), g^Σ_φ(·))
//! ```
//!
//! Two things are ours. The means of f_θ and g_φ are z_{t−1} plus what their networks give: what goes on as it was need not be
//! learned, and a car that is no longer seen is not forgotten. And e_θ tells whether a round has ended in z, so that an imagined
//! round that ends stops earning (after Hafner et al. 2021, "Mastering Atari with discrete world models").
//!
//! Every quantity of a batch of sequences lies in one tensor, step after step: what need not wait for z (reading images,
//! decoding, priors, divergences) is computed for all steps at once.

use crate::policy::Policy;
use crate::reader::Reader;
use crate::sizes::Sizes;
use crate::view::View;
use domains::Layout;
use nn::{Activation, Deconv, Mlp, ParamId, Parameters, Tape, Tensor, Var};
use rand_chacha::ChaCha8Rng;
use std::ops::Range;
use std::sync::Arc;

/// The networks f_θ, g_φ, d^m_θ, r_θ, e_θ and π_ψ with their parameters.
#[derive(Clone, Debug)]
pub struct SelfModel {
    /// Sizes.
    pub sizes: Sizes,
    /// What the numbers mean.
    pub layout: Arc<Layout>,
    /// How masked observations look.
    pub view: View,
    /// Every parameter of the networks below.
    pub parameters: Parameters,
    /// f_θ: `[z; a] → [mean − z; deviation before softplus]`.
    pub transition: Mlp,
    /// g_φ of the first step: `features → [mean; deviation]`.
    pub first: Mlp,
    /// g_φ of the other steps: `[z; a; features] → [mean − z; deviation]`.
    pub encoder: Mlp,
    /// d^visual_θ: `z → [feature map; other visual numbers]`, or `z → x̂^visual` without an image.
    pub visual: Mlp,
    /// d^verbal_θ: `z → x̂^verbal`.
    pub verbal: Mlp,
    /// r_θ: `z → r̂`.
    pub reward: Mlp,
    /// e_θ: `z → log-odds that the round has ended`.
    pub ended: Mlp,
    /// Least and greatest reward that was ever earned, `2 × 1`, within which r̂ stays. Among the parameters because it is a part of
    /// what was learned; no gradient moves it.
    pub(crate) rewards: ParamId,
    /// π_ψ and Q_ψ.
    pub policy: Policy,
    /// Reads observations for g_φ.
    pub reader: Reader,
    /// Draws the image from its feature map.
    pub(crate) draw: Option<Deconv>,
}

impl SelfModel {
    /// Untrained networks.
    pub fn new(sizes: Sizes, layout: Arc<Layout>, rng: &mut ChaCha8Rng) -> Self {
        let Sizes { shape, latent, .. } = sizes;
        let view = View::new(&layout);
        let mut p = Parameters::default();
        let mut net = |p: &mut Parameters, name: &str, widths: [usize; 4]| {
            Mlp::new(p, name, &widths, Activation::Identity, rng)
        };
        let t = sizes.transition_hidden;
        let transition = net(
            &mut p,
            "transition",
            [latent + shape.action, t, t, 2 * latent],
        );
        let features = sizes.image.map_or(view.rows(), |image| 2 * image.features);
        let e = sizes.encoder_hidden;
        let first = net(&mut p, "first", [features, e, e, 2 * latent]);
        let encoder = net(
            &mut p,
            "encoder",
            [latent + shape.action + features, e, e, 2 * latent],
        );
        let d = sizes.decoder_hidden;
        let others = shape.visual - sizes.image_numbers();
        let map = sizes
            .image
            .map_or(0, |image| image.patterns * image.windows().positions());
        let visual = net(&mut p, "visual", [latent, d, d, map + others]);
        let verbal = net(&mut p, "verbal", [latent, d, d, shape.verbal]);
        let reward = net(&mut p, "reward", [latent, d, d, 1]);
        let ended = net(&mut p, "ended", [latent, d, d, 1]);
        let anything = Tensor::from_slice(2, 1, &[f32::MIN, f32::MAX]);
        let rewards = p.add("rewards", anything);
        let policy = Policy::new(&sizes, layout.actions, &mut p, rng);
        let reader = Reader::new(&sizes, &view, &mut p, rng);
        let draw = sizes
            .image
            .map(|image| Deconv::new(&mut p, "draw", image.windows(), image.patterns, rng));
        Self {
            sizes,
            layout,
            view,
            parameters: p,
            transition,
            first,
            encoder,
            visual,
            verbal,
            reward,
            ended,
            rewards,
            policy,
            reader,
            draw,
        }
    }

    /// Least and greatest reward that was ever earned; all there are before anything was.
    pub fn rewards(&self) -> [f32; 2] {
        let bounds = self.parameters.get(self.rewards).data();
        [bounds[0], bounds[1]]
    }

    /// Takes note of rewards that were earned.
    pub fn note_rewards(&mut self, earned: impl IntoIterator<Item = f32>) {
        let known = match self.rewards() {
            [f32::MIN, f32::MAX] => [f32::MAX, f32::MIN],
            known => known,
        };
        let bounds = earned.into_iter().fold(known, |[least, most], reward| {
            [least.min(reward), most.max(reward)]
        });
        if bounds[0] <= bounds[1] {
            let kept = self.parameters.get_mut(self.rewards);
            kept.data_mut().copy_from_slice(&bounds);
        }
    }

    /// Splits a network's output into mean and deviation: `2n × batch → (n × batch, n × batch)`.
    pub fn gaussian(tape: &mut Tape, output: Var, n: usize) -> (Var, Var) {
        let mean = tape.rows(output, 0..n);
        let raw = tape.rows(output, n..2 * n);
        let soft = tape.softplus(raw);
        (mean, tape.clamp(soft, nn::SMALLEST_DEVIATION, f32::MAX))
    }

    /// What the posterior reads of encoded observations (`view rows × batch`).
    pub fn features(&self, tape: &mut Tape, observed: Var) -> Var {
        self.reader.on_tape(tape, observed)
    }

    /// q_φ(z_t | z_{t−1}, a_{t−1}, x_t): mean and deviation; `previous` is none at the first step.
    pub fn posterior(
        &self,
        tape: &mut Tape,
        previous: Option<(Var, Var)>,
        features: Var,
    ) -> (Var, Var) {
        let latent = self.sizes.latent;
        match previous {
            None => {
                let output = tape.mlp(&self.first, features);
                Self::gaussian(tape, output, latent)
            }
            Some((z, action)) => {
                let input = tape.concat(&[z, action, features]);
                let output = tape.mlp(&self.encoder, input);
                let (change, deviation) = Self::gaussian(tape, output, latent);
                (tape.add(z, change), deviation)
            }
        }
    }

    /// p_θ(z_t | z_{t−1}, a_{t−1}): mean and deviation.
    pub fn prior(&self, tape: &mut Tape, z: Var, action: Var) -> (Var, Var) {
        let input = tape.concat(&[z, action]);
        let output = tape.mlp(&self.transition, input);
        let (change, deviation) = Self::gaussian(tape, output, self.sizes.latent);
        (tape.add(z, change), deviation)
    }

    /// x̂^visual of `z`.
    pub fn decode_visual(&self, tape: &mut Tape, z: Var) -> Var {
        let output = tape.mlp(&self.visual, z);
        let Some(draw) = &self.draw else {
            return output;
        };
        let rows = tape.shape(output).0;
        let map = tape.rows(output, 0..draw.input());
        let others = tape.rows(output, draw.input()..rows);
        let map = tape.elu(map);
        let image = tape.deconv(draw, map);
        tape.concat(&[image, others])
    }

    /// The evidence lower bound, negated, per step that counts (paper, equation 3):
    ///
    /// ```text
    /// L_e = Σ_t ( E_q[Σ_m log p_θ(x^m_t | z_t)] + E_q[log p_θ(r_t | z_t)] + E_q[log p_θ(e_t | z_t)]
    ///             − E_q[KL(q_φ(z_t) ‖ p_θ(z_t | z_{t−1}, a_{t−1}))] )
    /// ```
    ///
    /// Observations go in masked and are reconstructed whole; at the first step the prior is N(0, 1). Constants of the fixed
    /// deviations are left out.
    pub fn negative_elbo(&self, tape: &mut Tape, batch: &Batch) -> ElboTerms {
        let latent = self.sizes.latent;
        let (steps, columns) = (batch.steps, batch.columns);
        let all = steps * columns;
        let observed = tape.input(&batch.observed);
        let features = self.features(tape, observed);
        let action = tape.input(&batch.action);
        let noise = tape.input(&batch.noise);
        let weight = tape.input(&batch.weight);
        let (mut means, mut deviations, mut samples) = (
            Vec::with_capacity(steps),
            Vec::with_capacity(steps),
            Vec::with_capacity(steps),
        );
        for t in 0..steps {
            let here = t * columns..(t + 1) * columns;
            let seen = tape.columns(features, here.clone());
            let previous = samples.last().map(|&z| {
                let action = tape.columns(action, here.clone());
                (z, action)
            });
            let (mean, deviation) = self.posterior(tape, previous, seen);
            let noise = tape.columns(noise, here);
            samples.push(tape.gaussian_sample(mean, deviation, noise));
            means.push(mean);
            deviations.push(deviation);
        }
        let (mean, deviation) = (tape.join(&means), tape.join(&deviations));
        let z = tape.join(&samples);
        let (prior_mean, prior_deviation) = {
            let first_mean = tape.constant(latent, columns, 0.0);
            let first_deviation = tape.constant(latent, columns, 1.0);
            if steps == 1 {
                (first_mean, first_deviation)
            } else {
                let before = tape.columns(z, 0..all - columns);
                let action = tape.columns(action, columns..all);
                let (mean, deviation) = self.prior(tape, before, action);
                (
                    tape.join(&[first_mean, mean]),
                    tape.join(&[first_deviation, deviation]),
                )
            }
        };
        let counted: f32 = batch.weight.data().iter().sum();
        let average = |tape: &mut Tape, terms: Var| {
            let weighted = tape.mul(terms, weight);
            let sum = tape.sum(weighted);
            tape.scale(sum, 1.0 / counted.max(1.0))
        };
        let kl = tape.gaussian_kl(mean, deviation, prior_mean, prior_deviation);
        let divergence = average(tape, kl);
        let everything = 0..all;
        let both = self.reconstruction(tape, batch, z, everything.clone());
        let reconstruction = average(tape, both);
        let reward = self.rewarded(tape, batch, z, everything.clone());
        let reward = average(tape, reward);
        let ending = self.ending(tape, batch, z, everything);
        let ending = average(tape, ending);
        let loss = tape.add(reconstruction, reward);
        let loss = tape.add(loss, ending);
        let loss = tape.add(loss, divergence);
        ElboTerms {
            loss,
            reconstruction,
            reward,
            ending,
            divergence,
            z,
        }
    }

    /// −Σ_m log p_θ(x^m | z) of the batch's columns in `of`, of which `z` is (`latent × columns`): `1 × columns`.
    fn reconstruction(&self, tape: &mut Tape, batch: &Batch, z: Var, of: Range<usize>) -> Var {
        let sizes = &self.sizes;
        let visual = self.decode_visual(tape, z);
        let target = tape.input(&batch.visual);
        let target = tape.columns(target, of.clone());
        let (image, numbers) = (sizes.image_numbers(), sizes.shape.visual);
        let others = {
            let (decoded, target) = (
                tape.rows(visual, image..numbers),
                tape.rows(target, image..numbers),
            );
            squared_error(tape, decoded, target, sizes.state_deviation)
        };
        let visual = if image > 0 {
            let (decoded, target) = (tape.rows(visual, 0..image), tape.rows(target, 0..image));
            let image = squared_error(tape, decoded, target, sizes.image_deviation);
            tape.add(image, others)
        } else {
            others
        };
        let verbal = tape.mlp(&self.verbal, z);
        let target = tape.input(&batch.verbal);
        let target = tape.columns(target, of);
        let verbal = squared_error(tape, verbal, target, sizes.verbal_deviation);
        tape.add(visual, verbal)
    }

    /// −log p_θ(r | z) of the batch's columns in `of`, of which `z` is: `1 × columns`.
    fn rewarded(&self, tape: &mut Tape, batch: &Batch, z: Var, of: Range<usize>) -> Var {
        let reward = tape.mlp(&self.reward, z);
        let target = tape.input(&batch.reward);
        let target = tape.columns(target, of);
        squared_error(tape, reward, target, self.sizes.reward_deviation)
    }

    /// −log p_θ(e | z) of the batch's columns in `of`, of which `z` is: `1 × columns`; softplus(l) − e l of log-odds l.
    fn ending(&self, tape: &mut Tape, batch: &Batch, z: Var, of: Range<usize>) -> Var {
        let odds = tape.mlp(&self.ended, z);
        let ended = tape.input(&batch.ended);
        let ended = tape.columns(ended, of);
        let certain = tape.softplus(odds);
        let told = tape.mul(ended, odds);
        tape.sub(certain, told)
    }

    /// How badly the model foresees, per step that counts: from the belief at step `from` it imagines the rest of each sequence, given
    /// the actions but nothing more to see,
    ///
    /// ```text
    /// L_f = − Σ_{t > from} ( Σ_m log p_θ(x^m_t | ẑ_t) + log p_θ(r_t | ẑ_t) + log p_θ(e_t | ẑ_t) ),
    ///       ẑ_t = the mean of p_θ(· | ẑ_{t−1}, a_{t−1}),  ẑ_from = z_from
    /// ```
    ///
    /// The ELBO asks for one step at a time, and errors of a step add up: a car that rushes up from behind was foreseen to recede
    /// (after Hafner et al. 2019, "latent overshooting", here of observations). `z`: what [`Self::negative_elbo`] sampled.
    ///
    /// # Panics
    /// If the sequence has no step after `from`.
    pub fn foresight(&self, tape: &mut Tape, batch: &Batch, z: Var, from: usize) -> Var {
        let (steps, columns) = (batch.steps, batch.columns);
        assert!(
            from + 1 < steps,
            "nothing lies after step {from} of {steps}"
        );
        let action = tape.input(&batch.action);
        let mut imagined = tape.columns(z, from * columns..(from + 1) * columns);
        let mut all = Vec::with_capacity(steps - from - 1);
        for t in from + 1..steps {
            let here = t * columns..(t + 1) * columns;
            let action = tape.columns(action, here);
            (imagined, _) = self.prior(tape, imagined, action);
            all.push(imagined);
        }
        let imagined = tape.join(&all);
        let of = (from + 1) * columns..steps * columns;
        let reconstruction = self.reconstruction(tape, batch, imagined, of.clone());
        let reward = self.rewarded(tape, batch, imagined, of.clone());
        let ending = self.ending(tape, batch, imagined, of.clone());
        let both = tape.add(reconstruction, reward);
        let all = tape.add(both, ending);
        let weight = tape.input(&batch.weight);
        let weight = tape.columns(weight, of.clone());
        let counted: f32 = batch.weight.data()[of].iter().sum();
        let weighted = tape.mul(all, weight);
        let sum = tape.sum(weighted);
        tape.scale(sum, 1.0 / counted.max(1.0))
    }
}

/// −log N(target | decoded, σ²) without its constant, summed over features: `1 × batch`.
fn squared_error(tape: &mut Tape, decoded: Var, target: Var, deviation: f32) -> Var {
    let difference = tape.sub(decoded, target);
    let squared = tape.square(difference);
    let summed = tape.sum_rows(squared);
    tape.scale(summed, 0.5 / (deviation * deviation))
}

/// A batch of sequences; every tensor is `features × (steps · columns)`, step after step.
#[derive(Clone, Debug)]
pub struct Batch {
    /// Steps of a sequence.
    pub steps: usize,
    /// Sequences.
    pub columns: usize,
    /// What q_φ sees, as [`View`] writes it.
    pub observed: Tensor,
    /// The whole visual modality.
    pub visual: Tensor,
    /// The whole verbal modality.
    pub verbal: Tensor,
    /// a_{t−1}, a choice as a column with a one; zeros at the first step.
    pub action: Tensor,
    /// r_t.
    pub reward: Tensor,
    /// e_t: 1 where the round has ended and has no future, else 0.
    pub ended: Tensor,
    /// ε of z_t = μ + σ ε.
    pub noise: Tensor,
    /// 1 where the step counts, 0 beyond an episode's end.
    pub weight: Tensor,
}

impl Batch {
    /// Zeros.
    pub fn new(model: &SelfModel, steps: usize, columns: usize) -> Self {
        let (shape, all) = (model.sizes.shape, steps * columns);
        Self {
            steps,
            columns,
            observed: Tensor::new(model.view.rows(), all),
            visual: Tensor::new(shape.visual, all),
            verbal: Tensor::new(shape.verbal, all),
            action: Tensor::new(shape.action, all),
            reward: Tensor::new(1, all),
            ended: Tensor::new(1, all),
            noise: Tensor::new(model.sizes.latent, all),
            weight: Tensor::new(1, all),
        }
    }
}

/// The ELBO's terms as variables of the tape that computed them.
#[derive(Clone, Copy, Debug)]
pub struct ElboTerms {
    /// −L_e per step.
    pub loss: Var,
    /// −Σ_m log p(x^m | z).
    pub reconstruction: Var,
    /// −log p(r | z).
    pub reward: Var,
    /// −log p(e | z).
    pub ending: Var,
    /// KL(q ‖ p).
    pub divergence: Var,
    /// Samples of z_t, `latent × (steps · columns)`.
    pub z: Var,
}
