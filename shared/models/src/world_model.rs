//! What planning needs of the robot's self-model, whichever domain it is of: forward imagination (paper §III-C, steps 2 and 3),
//! and what the robot would believe of what it imagines.

use crate::observation::{AZIMUTHS, Encoded, Observations, SECTORS, Shape};
use crate::self_model::{Decoder, Dynamics, Filter, SelfModel};
use nn::Tensor;

/// A latent model that can be run forward. Parameters are shared; scratch memory belongs to the caller, so that a step
/// allocates nothing.
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

    /// r̂ of `z`, `1 × batch`.
    fn reward(&self, scratch: &mut Self::Scratch, z: &Tensor, out: &mut Tensor);

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

/// Memory for imagining with a [`SelfModel`].
pub struct SelfModelScratch {
    dynamics: Dynamics,
    decoder: Decoder,
    spare: Tensor,
    encoded: Encoded,
    filter: Filter,
}

impl WorldModel for SelfModel {
    type Scratch = SelfModelScratch;

    fn scratch(&self) -> SelfModelScratch {
        SelfModelScratch {
            dynamics: Dynamics::new(self.sizes.latent),
            decoder: Decoder::default(),
            spare: Tensor::default(),
            encoded: Encoded::new(self.sizes.shape, 1),
            filter: Filter::new(self.sizes.latent, 1),
        }
    }

    fn latent(&self) -> usize {
        self.sizes.latent
    }

    fn shape(&self) -> Shape {
        self.sizes.shape
    }

    fn advance(&self, s: &mut SelfModelScratch, z: &mut Tensor, actions: &Tensor, noise: &[f32]) {
        s.dynamics.step(self, z, actions, noise);
    }

    fn visual(&self, s: &mut SelfModelScratch, z: &Tensor, out: &mut Tensor) {
        s.decoder.visual(self, z, out);
    }

    fn verbal(&self, s: &mut SelfModelScratch, z: &Tensor, out: &mut Tensor) {
        s.decoder.verbal(self, z, out);
    }

    fn reward(&self, s: &mut SelfModelScratch, z: &Tensor, out: &mut Tensor) {
        s.decoder.reward(self, z, out);
    }

    fn value(&self, s: &mut SelfModelScratch, z: &Tensor, actions: &Tensor, out: &mut Tensor) {
        s.decoder.value(self, z, actions, out, &mut s.spare);
    }

    fn believe(
        &self,
        s: &mut SelfModelScratch,
        action: &Tensor,
        observed: &Observations,
        mean: &mut Tensor,
        deviation: &mut Tensor,
    ) {
        let (visual, verbal) = (observed.visual.column(0), observed.verbal.column(0));
        // On the highway the robot has its LIDAR, and nobody talks to it.
        s.encoded
            .set(0, visual, verbal, &[1.0; AZIMUTHS], &[0.0; SECTORS]);
        s.filter.mean.copy_from(mean);
        s.filter.fresh = false;
        s.filter.update(self, action, &s.encoded);
        mean.copy_from(&s.filter.mean);
        deviation.copy_from(&s.filter.deviation);
    }
}
