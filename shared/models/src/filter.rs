//! The self-model without a tape: following a world (q_φ), imagining (p_θ), and choosing (π_ψ). Memory belongs to the caller;
//! nothing allocates after the first call.

use crate::observation::{Observations, Shape};
use crate::policy::{ActionDistribution, HeadScratch, Policy, largest};
use crate::reader::{ReaderScratch, copy_rows};
use crate::self_model::SelfModel;
use nn::{MlpScratch, Tensor};

/// A latent model that can be run forward (paper §III-C, steps 2 and 3 of forward imagination), and what the robot would
/// believe of what it imagines: all that planning needs of [`SelfModel`]. Parameters are shared; scratch memory belongs to the
/// caller, so that a step allocates nothing.
pub trait WorldModel {
    /// Memory of one caller.
    type Scratch;

    /// Memory for one caller.
    fn scratch(&self) -> Self::Scratch;

    /// Dimensions of z.
    fn latent(&self) -> usize;

    /// Sizes of the modalities and of an action.
    fn shape(&self) -> Shape;

    /// Step 2: `z` (`latent × batch`) becomes a sample of p(z_t | f_θ(z_{t−1}, a_{t−1})); `noise`: standard normals of z's shape.
    fn advance(&self, scratch: &mut Self::Scratch, z: &mut Tensor, actions: &Tensor, noise: &[f32]);

    /// Step 3: x̂^visual of `z`.
    fn visual(&self, scratch: &mut Self::Scratch, z: &Tensor, out: &mut Tensor);

    /// Step 3: x̂^verbal of `z`.
    fn verbal(&self, scratch: &mut Self::Scratch, z: &Tensor, out: &mut Tensor);

    /// r̂ of `z`, `1 × batch`; never more or less than was ever earned.
    fn reward(&self, scratch: &mut Self::Scratch, z: &Tensor, out: &mut Tensor);

    /// Probability that the round has ended in `z`, `1 × batch`.
    fn ended(&self, scratch: &mut Self::Scratch, z: &Tensor, out: &mut Tensor);

    /// What is expected of the future after `actions` in `z`, `1 × batch`.
    fn value(&self, scratch: &mut Self::Scratch, z: &Tensor, actions: &Tensor, out: &mut Tensor);

    /// q_φ(z_t | z_{t−1}, a_{t−1}, x_t) of one robot that senses all of `observed`: `mean` and `deviation` of z_t, each
    /// `latent × 1`. `mean` holds that of z_{t−1} before.
    fn believe(
        &self,
        scratch: &mut Self::Scratch,
        action: &Tensor,
        observed: &Observations,
        mean: &mut Tensor,
        deviation: &mut Tensor,
    );
}

/// One caller's memory.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    mlp: MlpScratch,
    head: HeadScratch,
    output: Tensor,
    spare: Tensor,
    mean: Tensor,
    deviation: Tensor,
    image: Tensor,
    unfolded: Tensor,
    map: Tensor,
    reader: ReaderScratch,
    observed: Tensor,
    believed: Tensor,
}

impl SelfModel {
    /// q_φ of a batch of encoded observations (`view rows × batch`): mean and deviation, `latent × batch`. `previous`: z and
    /// action of the step before, none at the first.
    pub fn infer(
        &self,
        s: &mut Scratch,
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
        if let Some((z, _)) = previous {
            add(mean, z);
        }
    }

    /// Q_ψ(z, ·) of every choice, `actions × batch`.
    ///
    /// # Panics
    /// If actions are numbers.
    pub fn q_values(&self, s: &mut Scratch, z: &Tensor, out: &mut Tensor) {
        let (q, _) = self.policy.q();
        q.infer(&self.parameters, z, &mut s.mlp, out);
    }

    /// π_ψ(· | z) of a batch, `z`: `latent × batch`.
    pub fn act(&self, s: &mut Scratch, z: &Tensor, out: &mut ActionDistribution) {
        let (network, temperature) = match &self.policy {
            Policy::SquashedGaussian { actor, .. } => (actor, 1.0),
            Policy::Boltzmann { q, temperature } => (q, *temperature),
        };
        out.infer(network, temperature, &self.parameters, z, &mut s.head);
    }
}

impl WorldModel for SelfModel {
    type Scratch = Scratch;

    fn scratch(&self) -> Scratch {
        Scratch::default()
    }

    fn latent(&self) -> usize {
        self.sizes.latent
    }

    fn shape(&self) -> Shape {
        self.sizes.shape
    }

    fn advance(&self, s: &mut Scratch, z: &mut Tensor, actions: &Tensor, noise: &[f32]) {
        let p = &self.parameters;
        self.transition
            .infer_stacked(p, &[z, actions], &mut s.mlp, &mut s.output);
        split_gaussian(&s.output, &mut s.mean, &mut s.deviation);
        add(&mut s.mean, z);
        sample(&s.mean, &s.deviation, noise, z);
    }

    fn visual(&self, s: &mut Scratch, z: &Tensor, out: &mut Tensor) {
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

    fn verbal(&self, s: &mut Scratch, z: &Tensor, out: &mut Tensor) {
        self.verbal.infer(&self.parameters, z, &mut s.mlp, out);
    }

    fn reward(&self, s: &mut Scratch, z: &Tensor, out: &mut Tensor) {
        self.reward.infer(&self.parameters, z, &mut s.mlp, out);
        let [least, most] = self.rewards();
        for reward in out.data_mut() {
            *reward = reward.clamp(least, most);
        }
    }

    fn ended(&self, s: &mut Scratch, z: &Tensor, out: &mut Tensor) {
        self.ended.infer(&self.parameters, z, &mut s.mlp, out);
        nn::sigmoid_in_place(out);
    }

    /// The smaller of two critics' values, or the chosen action's.
    fn value(&self, s: &mut Scratch, z: &Tensor, actions: &Tensor, out: &mut Tensor) {
        let p = &self.parameters;
        match &self.policy {
            Policy::SquashedGaussian { critics, .. } => {
                let [first, second] = critics;
                first.infer_stacked(p, &[z, actions], &mut s.mlp, out);
                second.infer_stacked(p, &[z, actions], &mut s.mlp, &mut s.spare);
                for (value, other) in out.data_mut().iter_mut().zip(s.spare.data()) {
                    *value = value.min(*other);
                }
            }
            Policy::Boltzmann { q, .. } => {
                q.infer(p, z, &mut s.mlp, &mut s.output);
                out.resize_to(1, z.cols());
                for (j, value) in out.data_mut().iter_mut().enumerate() {
                    *value = s.output.column(j)[largest(actions.column(j))];
                }
            }
        }
    }

    fn believe(
        &self,
        s: &mut Scratch,
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
        let sensed = self.layout.sensed;
        self.view
            .write(visual, verbal, sensed, encoded.column_mut(0));
        self.infer(s, Some((mean, action)), &encoded, &mut next, deviation);
        mean.copy_from(&next);
        (s.observed, s.believed) = (encoded, next);
    }
}

/// Follows a world with q_φ: the belief of a batch, carried by its mean.
#[derive(Clone, Debug)]
pub struct Filter {
    /// Mean of z, `latent × batch`.
    pub mean: Tensor,
    /// Deviation of z.
    pub deviation: Tensor,
    /// Whether nothing was observed yet.
    pub fresh: bool,
    next: Tensor,
    scratch: Scratch,
}

impl Filter {
    /// A belief of somebody who saw nothing yet.
    pub fn new(latent: usize, batch: usize) -> Self {
        Self {
            mean: Tensor::new(latent, batch),
            deviation: Tensor::new(latent, batch),
            fresh: true,
            next: Tensor::new(latent, batch),
            scratch: Scratch::default(),
        }
    }

    /// Forgets everything: an episode begins.
    pub fn reset(&mut self) {
        self.fresh = true;
    }

    /// z_t ← q_φ(z_{t−1}, a_{t−1}, x_t). `action`: `actions × batch`, ignored at the first step; `observed`: as
    /// [`crate::View`] writes it.
    pub fn update(&mut self, model: &SelfModel, action: &Tensor, observed: &Tensor) {
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

/// x + y in x's place.
fn add(x: &mut Tensor, y: &Tensor) {
    for (x, y) in x.data_mut().iter_mut().zip(y.data()) {
        *x += y;
    }
}

/// z = μ + σ ε, elementwise.
pub fn sample(mean: &Tensor, deviation: &Tensor, noise: &[f32], z: &mut Tensor) {
    z.resize_to(mean.rows(), mean.cols());
    let gaussians = mean.data().iter().zip(deviation.data()).zip(noise);
    for (z, ((mean, deviation), noise)) in z.data_mut().iter_mut().zip(gaussians) {
        *z = mean + deviation * noise;
    }
}
