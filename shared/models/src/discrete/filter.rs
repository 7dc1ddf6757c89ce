//! The gridworlds' self-model without a tape: following a world, imagining, and choosing; nothing allocates after the first call.

use super::reader::{ReaderScratch, copy_rows};
use super::self_model::DiscreteModel;
use crate::WorldModel;
use crate::observation::{Observations, Shape};
use crate::policy::{ActionDistribution, largest};
use crate::self_model::{sample, split_gaussian};
use nn::{MlpScratch, Tensor};

/// One caller's memory.
#[derive(Clone, Debug, Default)]
pub struct DiscreteScratch {
    mlp: MlpScratch,
    output: Tensor,
    mean: Tensor,
    deviation: Tensor,
    image: Tensor,
    unfolded: Tensor,
    map: Tensor,
    reader: ReaderScratch,
    observed: Tensor,
    believed: Tensor,
}

impl DiscreteModel {
    /// q_φ of a batch of encoded observations (`view rows × batch`): mean and deviation, `latent × batch`. `previous`: z and
    /// action of the step before, none at the first.
    pub fn infer(
        &self,
        s: &mut DiscreteScratch,
        previous: Option<(&Tensor, &Tensor)>,
        observed: &Tensor,
        mean: &mut Tensor,
        deviation: &mut Tensor,
    ) {
        let p = &self.parameters;
        let (reader, mlp, output) = (&mut s.reader, &mut s.mlp, &mut s.output);
        self.reader
            .infer(p, reader, observed, |features| match (previous, features) {
                (None, _) => self.first.infer_stacked(p, features, mlp, output),
                (Some((z, action)), [a]) => {
                    self.encoder.infer_stacked(p, &[z, action, a], mlp, output);
                }
                (Some((z, action)), [a, b, ..]) => {
                    let blocks = [z, action, a, b];
                    self.encoder.infer_stacked(p, &blocks, mlp, output);
                }
                (Some(_), []) => {}
            });
        split_gaussian(&s.output, mean, deviation);
    }

    /// Q_ψ(z, ·), `actions × batch`.
    pub fn q_values(&self, s: &mut DiscreteScratch, z: &Tensor, out: &mut Tensor) {
        self.q.infer(&self.parameters, z, &mut s.mlp, out);
    }

    /// log π(· | z) = log softmax(Q_ψ(z, ·) / temperature).
    pub fn policy(&self, s: &mut DiscreteScratch, z: &Tensor, out: &mut ActionDistribution) {
        self.q_values(s, z, &mut out.log_probability);
        let inverse = 1.0 / self.sizes.temperature;
        for value in out.log_probability.data_mut() {
            *value *= inverse;
        }
        nn::log_softmax_in_place(&mut out.log_probability);
    }
}

impl WorldModel for DiscreteModel {
    type Scratch = DiscreteScratch;

    fn scratch(&self) -> DiscreteScratch {
        DiscreteScratch::default()
    }

    fn latent(&self) -> usize {
        self.sizes.latent
    }

    fn shape(&self) -> Shape {
        self.sizes.shape
    }

    fn advance(&self, s: &mut DiscreteScratch, z: &mut Tensor, actions: &Tensor, noise: &[f32]) {
        let p = &self.parameters;
        self.transition
            .infer_stacked(p, &[z, actions], &mut s.mlp, &mut s.output);
        split_gaussian(&s.output, &mut s.mean, &mut s.deviation);
        sample(&s.mean, &s.deviation, noise, z);
    }

    fn visual(&self, s: &mut DiscreteScratch, z: &Tensor, out: &mut Tensor) {
        let p = &self.parameters;
        let Some(draw) = &self.draw else {
            self.visual.infer(p, z, &mut s.mlp, out);
            return;
        };
        self.visual.infer(p, z, &mut s.mlp, &mut s.output);
        copy_rows(&s.output, 0, draw.input(), &mut s.map);
        for x in s.map.data_mut() {
            *x = if *x > 0.0 { *x } else { x.exp_m1() };
        }
        draw.infer(p, &s.map, &mut s.unfolded, &mut s.image);
        let (image, map) = (self.sizes.image_numbers(), draw.input());
        out.resize_to(self.sizes.shape.visual, z.cols());
        for j in 0..z.cols() {
            let column = out.column_mut(j);
            column[..image].copy_from_slice(s.image.column(j));
            column[image..].copy_from_slice(&s.output.column(j)[map..]);
        }
    }

    fn verbal(&self, s: &mut DiscreteScratch, z: &Tensor, out: &mut Tensor) {
        self.verbal.infer(&self.parameters, z, &mut s.mlp, out);
    }

    fn reward(&self, s: &mut DiscreteScratch, z: &Tensor, out: &mut Tensor) {
        self.reward.infer(&self.parameters, z, &mut s.mlp, out);
    }

    fn value(&self, s: &mut DiscreteScratch, z: &Tensor, actions: &Tensor, out: &mut Tensor) {
        self.q.infer(&self.parameters, z, &mut s.mlp, &mut s.output);
        out.resize_to(1, z.cols());
        for (j, value) in out.data_mut().iter_mut().enumerate() {
            *value = s.output.column(j)[largest(actions.column(j))];
        }
    }

    fn believe(
        &self,
        s: &mut DiscreteScratch,
        action: &Tensor,
        observed: &Observations,
        mean: &mut Tensor,
        deviation: &mut Tensor,
    ) {
        let (mut encoded, mut next) = (
            std::mem::take(&mut s.observed),
            std::mem::take(&mut s.believed),
        );
        encoded.resize_to(self.view.rows(), 1);
        let (visual, verbal) = (observed.visual.column(0), observed.verbal.column(0));
        let everything = self.layout.everything();
        self.view
            .write(visual, verbal, everything, encoded.column_mut(0));
        self.infer(s, Some((mean, action)), &encoded, &mut next, deviation);
        mean.copy_from(&next);
        (s.observed, s.believed) = (encoded, next);
    }
}

/// Follows a world with q_φ: the belief of a batch, carried by its mean.
#[derive(Clone, Debug)]
pub struct DiscreteFilter {
    /// Mean of z, `latent × batch`.
    pub mean: Tensor,
    /// Deviation of z.
    pub deviation: Tensor,
    /// Whether nothing was observed yet.
    pub fresh: bool,
    next: Tensor,
    scratch: DiscreteScratch,
}

impl DiscreteFilter {
    /// A belief of somebody who saw nothing yet.
    pub fn new(latent: usize, batch: usize) -> Self {
        Self {
            mean: Tensor::new(latent, batch),
            deviation: Tensor::new(latent, batch),
            fresh: true,
            next: Tensor::new(latent, batch),
            scratch: DiscreteScratch::default(),
        }
    }

    /// Forgets everything: an episode begins.
    pub fn reset(&mut self) {
        self.fresh = true;
    }

    /// z_t ← q_φ(z_{t−1}, a_{t−1}, x_t). `action`: a column with a one, ignored at the first step; `observed`: as
    /// [`super::View`] writes it.
    pub fn update(&mut self, model: &DiscreteModel, action: &Tensor, observed: &Tensor) {
        let previous = (!self.fresh).then_some((&self.mean, action));
        model.infer(
            &mut self.scratch,
            previous,
            observed,
            &mut self.next,
            &mut self.deviation,
        );
        std::mem::swap(&mut self.mean, &mut self.next);
        self.fresh = false;
    }
}
