//! The human model's trait, over batches of people, and its first implementation: the robot's self-model, unchanged
//! (`self`) or with implants (`mirror`, `mirror-p`).

use crate::implants::Implants;
use crate::observation::{AZIMUTHS, Communicated, Encoded, Observations, SECTORS, overlay};
use crate::policy::ActionDistribution;
use crate::self_model::{SelfModel, sample, split_gaussian};
use nn::{MlpScratch, Tensor};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The kinds of human model, by the names that the command line takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// The self-model with both implants.
    Mirror,
    /// The self-model with the perceptual implant only.
    MirrorP,
    /// The self-model unchanged: sees all, acts as the robot would.
    #[serde(rename = "self")]
    Myself,
    /// Behavioural cloning: a recurrent policy learned by likelihood.
    Bc,
    /// Soft-Q imitation: the same policy, learned by reinforcement.
    Sqil,
    /// The simulated person's own model, in the gridworlds: what nobody has of a real person.
    Ideal,
}

impl Kind {
    /// Every kind.
    pub const ALL: [Self; 6] = [
        Self::Mirror,
        Self::MirrorP,
        Self::Myself,
        Self::Bc,
        Self::Sqil,
        Self::Ideal,
    ];

    /// The name on the command line and in messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mirror => "mirror",
            Self::MirrorP => "mirror-p",
            Self::Myself => "self",
            Self::Bc => "bc",
            Self::Sqil => "sqil",
            Self::Ideal => "ideal",
        }
    }

    /// Whether it learns from a person's rounds, and so has a file.
    pub const fn learns(self) -> bool {
        !matches!(self, Self::Myself | Self::Ideal)
    }

    /// Whether this is the self-model, with or without implants, rather than a policy of its own ([`crate::recurrent`]).
    pub const fn is_self_model(self) -> bool {
        matches!(self, Self::Mirror | Self::MirrorP | Self::Myself)
    }

    /// The kind of that name.
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

/// What a batch of (real or imagined) people believe: `latent × batch`.
#[derive(Clone, Debug)]
pub struct Beliefs {
    /// Mean of z^H, or a recurrent model's hidden state.
    pub mean: Tensor,
    /// Deviation of z^H; zeros for deterministic models.
    pub deviation: Tensor,
    /// The z^H from which the next step and the action follow: a sample in imagination, the mean when filtering.
    pub z: Tensor,
    /// Nothing perceived yet.
    pub fresh: bool,
}

impl Beliefs {
    /// Beliefs of `batch` people who perceived nothing yet.
    pub fn new(latent: usize, batch: usize) -> Self {
        Self {
            mean: Tensor::new(latent, batch),
            deviation: Tensor::new(latent, batch),
            z: Tensor::new(latent, batch),
            fresh: true,
        }
    }

    /// An episode begins.
    pub fn reset(&mut self) {
        self.fresh = true;
    }

    /// Makes `batch` imagined people out of the one person in `source`: z ~ N(mean, deviation), noise `latent × batch`.
    pub fn spread(&mut self, source: &Self, batch: usize, noise: &[f32]) {
        let latent = source.mean.rows();
        for tensor in [&mut self.mean, &mut self.deviation, &mut self.z] {
            tensor.resize_to(latent, batch);
        }
        let (mean, deviation) = (source.mean.column(0), source.deviation.column(0));
        for j in 0..batch {
            self.mean.column_mut(j).copy_from_slice(mean);
            self.deviation.column_mut(j).copy_from_slice(deviation);
        }
        self.fresh = source.fresh;
        sample(&self.mean, &self.deviation, noise, &mut self.z);
    }
}

/// A model of how people perceive and act, over batches (DESIGN §5). Implementations own their scratch memory: after a
/// first call of a given batch size, nothing allocates.
///
/// Every implementation has to pass the conformance suite (`models/tests/conformance.rs`).
pub trait HumanModel: Send {
    /// Which kind of model this is.
    fn kind(&self) -> &'static str;

    /// Rows of a belief.
    fn latent(&self) -> usize;

    /// Standard normals that [`HumanModel::perceive`] takes per person: `latent` to sample z^H and, where perception itself
    /// is a matter of chance, more for that.
    fn noise_rows(&self) -> usize {
        self.latent()
    }

    /// Room for this model's action distributions.
    fn distribution(&self, batch: usize) -> ActionDistribution {
        ActionDistribution::new(2, batch)
    }

    /// Updates beliefs with what people perceive (steps 4 to 7 of forward imagination): the observation through their
    /// perception, overlaid with what is communicated.
    ///
    /// `actions`: `actions × batch`, what each person did since the last call (ignored while `beliefs.fresh`);
    /// `observations`: what the robot sensed or imagines; `communicated`: one entry per person; `noise`: standard normals,
    /// `latent × batch` to sample z^H followed by what else `noise_rows` counts, or none to carry the mean.
    fn perceive(
        &mut self,
        beliefs: &mut Beliefs,
        actions: &Tensor,
        observations: &Observations,
        communicated: &[Communicated],
        noise: Option<&[f32]>,
    );

    /// The distribution of each person's next action.
    fn act(&mut self, beliefs: &Beliefs, out: &mut ActionDistribution);

    /// The highway's models: what they think the person sees of each azimuth, in metres.
    fn visible_m(&self) -> [f32; AZIMUTHS] {
        [crate::observation::RANGE_M; AZIMUTHS]
    }

    /// Whether z^H is a Gaussian in the same space as the robot's z^R, so that the two can be compared (MIRROR-KL).
    fn shares_latent(&self) -> bool {
        false
    }
}

/// Noise of the real person's belief, as opposed to imagined people's.
const FOLLOWING: u64 = 21;

/// The noise that [`HumanModel::perceive`] takes where the real person is followed. Where perception is a matter of chance, so is
/// the belief, drawn from seed, episode and step; elsewhere its mean is carried. `noise` has [`HumanModel::noise_rows`] numbers.
pub fn following<'a>(
    model: &dyn HumanModel,
    at: [u64; 3],
    noise: &'a mut [f32],
) -> Option<&'a [f32]> {
    if model.noise_rows() <= model.latent() {
        return None;
    }
    nn::noise::fill(noise, nn::noise::mix(&at), FOLLOWING);
    Some(noise)
}

/// The self-model as a human model, with or without implants.
pub struct SelfHuman {
    model: Arc<SelfModel>,
    implants: Option<Implants>,
    thresholds_m: [f32; AZIMUTHS],
    encoded: Encoded,
    output: Tensor,
    delta: Tensor,
    scratch: MlpScratch,
}

impl SelfHuman {
    /// The self-model with `implants`, or unchanged without.
    pub fn new(model: Arc<SelfModel>, implants: Option<Implants>) -> Self {
        let thresholds_m = implants
            .as_ref()
            .map_or([f32::INFINITY; AZIMUTHS], Implants::thresholds_m);
        let shape = model.sizes.shape;
        let latent = model.sizes.latent;
        Self {
            model,
            implants,
            thresholds_m,
            encoded: Encoded::new(shape, 0),
            output: Tensor::new(2 * latent, 0),
            delta: Tensor::new(shape.action, 0),
            scratch: MlpScratch::default(),
        }
    }
}

impl HumanModel for SelfHuman {
    fn kind(&self) -> &'static str {
        match &self.implants {
            None => Kind::Myself,
            Some(implants) if implants.has_policy() => Kind::Mirror,
            Some(_) => Kind::MirrorP,
        }
        .name()
    }

    fn latent(&self) -> usize {
        self.model.sizes.latent
    }

    fn perceive(
        &mut self,
        beliefs: &mut Beliefs,
        actions: &Tensor,
        observations: &Observations,
        communicated: &[Communicated],
        noise: Option<&[f32]>,
    ) {
        let batch = observations.batch();
        self.encoded.resize(batch);
        for j in 0..batch {
            let visual = observations.visual.column(j);
            let mut visual_mask = [0.0; AZIMUTHS];
            let mut verbal_mask = [0.0; SECTORS];
            // 4: x̌ = h_p(x̂)   5: û = w_ω(x̂)   6: x̊ = v(x̌, û)
            Implants::visible(&self.thresholds_m, visual, &mut visual_mask);
            overlay(communicated[j], visual, &mut visual_mask, &mut verbal_mask);
            self.encoded.set(
                j,
                visual,
                observations.verbal.column(j),
                &visual_mask,
                &verbal_mask,
            );
        }
        // 7: z^H ~ q_φ(z^H | z^H', ǎ, x̊)
        let p = &self.model.parameters;
        if beliefs.fresh {
            self.model
                .first
                .infer(p, &self.encoded.rows, &mut self.scratch, &mut self.output);
        } else {
            self.model.encoder.infer_stacked(
                p,
                &[&beliefs.z, actions, &self.encoded.rows],
                &mut self.scratch,
                &mut self.output,
            );
        }
        beliefs.fresh = false;
        split_gaussian(&self.output, &mut beliefs.mean, &mut beliefs.deviation);
        match noise {
            Some(noise) => sample(&beliefs.mean, &beliefs.deviation, noise, &mut beliefs.z),
            None => {
                beliefs
                    .z
                    .resize_to(beliefs.mean.rows(), beliefs.mean.cols());
                beliefs.z.copy_from(&beliefs.mean);
            }
        }
    }

    fn act(&mut self, beliefs: &Beliefs, out: &mut ActionDistribution) {
        out.infer(&self.model.policy, &self.model.parameters, &beliefs.z);
        if let Some(implants) = &self.implants {
            implants.shift(&beliefs.z, out, &mut self.scratch, &mut self.delta);
        }
    }

    fn visible_m(&self) -> [f32; AZIMUTHS] {
        self.thresholds_m
            .map(|limit| limit.min(crate::observation::RANGE_M))
    }

    fn shares_latent(&self) -> bool {
        true
    }
}
