//! The human model's trait, over batches of people, the kinds that there are, and what people believe.

use crate::filter::sample;
use crate::observation::{Communicated, Observations};
use crate::policy::ActionDistribution;
use domains::{ActionSpace, Layout, Mask};
use nn::Tensor;
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

/// What a batch of (real or imagined) people believe: `latent × batch`. One real person may be followed by several hypotheses about
/// them side by side, a column each ([`Beliefs::of_person`]).
#[derive(Clone, Debug)]
pub struct Beliefs {
    /// Mean of z^H, or a recurrent model's hidden state.
    pub mean: Tensor,
    /// Deviation of z^H; zeros for deterministic models.
    pub deviation: Tensor,
    /// The z^H from which the next step and the action follow: a sample in imagination, the mean when filtering.
    pub z: Tensor,
    /// By which of the model's hypotheses each column goes.
    pub hypothesis: Vec<u32>,
    /// How probable each column is, where they are views of one person.
    pub weight: Vec<f32>,
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
            hypothesis: vec![0; batch],
            weight: vec![1.0 / batch.max(1) as f32; batch],
            fresh: true,
        }
    }

    /// One person in all of a model's hypotheses, each as often as the model asks for samples.
    pub fn of_person(model: &dyn HumanModel) -> Self {
        let (weights, samples) = (model.weights(), model.samples());
        let mut beliefs = Self::new(model.latent(), weights.len() * samples);
        for (j, hypothesis) in beliefs.hypothesis.iter_mut().enumerate() {
            *hypothesis = (j / samples) as u32;
        }
        beliefs.weigh(weights);
        beliefs
    }

    /// Every column as probable as its hypothesis allows: `weights` has the hypotheses'.
    pub fn weigh(&mut self, weights: &[f32]) {
        let samples = self.hypothesis.len() / weights.len();
        for (weight, hypothesis) in self.weight.iter_mut().zip(&self.hypothesis) {
            *weight = weights[*hypothesis as usize] / samples as f32;
        }
    }

    /// An episode begins.
    pub fn reset(&mut self) {
        self.fresh = true;
    }

    /// Makes this a copy of `other` without allocating where both have one size.
    pub fn copy_from(&mut self, other: &Self) {
        for (own, other) in [
            (&mut self.mean, &other.mean),
            (&mut self.deviation, &other.deviation),
            (&mut self.z, &other.z),
        ] {
            own.resize_to(other.rows(), other.cols());
            own.copy_from(other);
        }
        self.hypothesis.clone_from(&other.hypothesis);
        self.weight.clone_from(&other.weight);
        self.fresh = other.fresh;
    }

    /// The most probable column, the first among equals.
    pub fn most_probable(&self) -> usize {
        crate::policy::largest(&self.weight)
    }

    /// Makes `batch` imagined people out of the one person in `source`: each goes by a hypothesis as often as it is probable, and has
    /// z ~ N(mean, deviation) of its column; noise `latent × batch`. Which column person j is drawn from depends on `future(j)`
    /// alone.
    pub fn spread(
        &mut self,
        source: &Self,
        batch: usize,
        noise: &[f32],
        future: impl Fn(usize) -> usize,
    ) {
        self.spread_as(source, batch, noise, |j| drawn(&source.weight, future(j)));
    }

    /// Lets row j go by the hypothesis of row j mod `count`, for `rows` rows.
    pub(crate) fn repeat_hypotheses(&mut self, count: usize, rows: usize) {
        self.hypothesis.resize(rows, 0);
        for j in count.min(rows)..rows {
            self.hypothesis[j] = self.hypothesis[j % count];
        }
    }

    /// As [`Self::spread`], with everybody out of column `column(j)` of `source`.
    pub fn spread_as(
        &mut self,
        source: &Self,
        batch: usize,
        noise: &[f32],
        column: impl Fn(usize) -> usize,
    ) {
        let latent = source.mean.rows();
        for tensor in [&mut self.mean, &mut self.deviation, &mut self.z] {
            tensor.resize_to(latent, batch);
        }
        self.hypothesis.clear();
        for j in 0..batch {
            let from = column(j);
            let (mean, deviation) = (source.mean.column(from), source.deviation.column(from));
            self.mean.column_mut(j).copy_from_slice(mean);
            self.deviation.column_mut(j).copy_from_slice(deviation);
            self.hypothesis.push(source.hypothesis[from]);
        }
        self.weight.clear();
        self.weight.resize(batch, 1.0 / batch.max(1) as f32);
        self.fresh = source.fresh;
        sample(&self.mean, &self.deviation, noise, &mut self.z);
    }
}

/// The column that person j is drawn from: the points j · golden ratio (mod 1) are spread evenly over [0, 1), however many there are.
fn drawn(weight: &[f32], j: usize) -> usize {
    const GOLDEN: f64 = 0.618_033_988_749_894_8;
    let point = ((j as f64 + 0.5) * GOLDEN).fract();
    let mut below = 0.0;
    let passed = weight.iter().take_while(|weight| {
        below += f64::from(**weight);
        below <= point
    });
    passed.count().min(weight.len() - 1)
}

/// A model of how people perceive and act, over batches. Implementations own their scratch memory: after a
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

    /// What people do.
    fn actions(&self) -> ActionSpace;

    /// Probabilities of the hypotheses about the person that the model holds side by side.
    fn weights(&self) -> &[f32] {
        &[1.0]
    }

    /// How many samples of the real person's belief are followed by each hypothesis: more than one where it is chance what they
    /// perceive, since then what they do tells what it was.
    fn samples(&self) -> usize {
        1
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

    /// What the model thinks limits the person's sight, on average over its hypotheses, in the order and unit of the domain's
    /// [`domains::Perception`]; infinite where nothing does, empty where the model cannot say.
    fn limits(&self) -> &[f32] {
        &[]
    }

    /// Whether z^H is a Gaussian in the same space as the robot's z^R, so that the two can be compared (MIRROR-KL).
    fn shares_latent(&self) -> bool {
        false
    }
}

/// What a person of these limits perceives: the observation through their perception, overlaid with what is communicated (steps 4
/// to 6 of forward imagination).
#[derive(Clone, Debug)]
pub(crate) struct Perceiver {
    layout: Arc<Layout>,
    /// Of each hypothesis, in the order of [`domains::Perception`].
    limits: Vec<Vec<f32>>,
    /// Utterances that the person hears without an assistant. Who speaks is no secret, so these are given, not learned.
    heard: u32,
}

impl Perceiver {
    pub fn new(layout: &Arc<Layout>, limits: Vec<Vec<f32>>, heard: u32) -> Self {
        debug_assert!(
            limits
                .iter()
                .all(|own| own.len() == layout.perception.limits())
        );
        Self {
            layout: Arc::clone(layout),
            limits,
            heard,
        }
    }

    /// Nothing limits the person's sight.
    pub fn of_everything(layout: &Arc<Layout>, heard: u32) -> Self {
        let limits = vec![f32::INFINITY; layout.perception.limits()];
        Self::new(layout, vec![limits], heard)
    }

    /// Standard normals that perception takes per person.
    pub fn noise_rows(&self) -> usize {
        self.layout.perception.noise_rows()
    }

    /// What person `j` of a batch perceives by a hypothesis. `noise`: [`Self::noise_rows`] numbers for each person.
    pub fn perceive(
        &self,
        j: usize,
        hypothesis: u32,
        visual: &[f32],
        communicated: Communicated,
        noise: Option<&[f32]>,
    ) -> Mask {
        let rows = self.noise_rows();
        let noise = noise.filter(|_| rows > 0);
        let noise = noise.map(|noise| &noise[j * rows..(j + 1) * rows]);
        // 4: x̌ = h_p(x̂)
        let seen = self
            .layout
            .perception
            .seen(&self.limits[hypothesis as usize], visual, noise);
        // 5: û = w_ω(x̂)   6: x̊ = v(x̌, û)
        self.layout
            .overlay(seen, self.heard, communicated.bits(), visual)
    }
}
