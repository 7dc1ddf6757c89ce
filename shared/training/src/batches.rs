//! Batches of sequences out of whole rounds, with modality dropout (paper §III-A, "Practical aspects"): the model has to learn
//! from data that approximate the ways in which observations can appear to a person.

use crate::SHARDS;
use crate::replay::{Episode, Replay};
use domains::highway::modalities::{self, MAX_SIGHT_M};
use domains::highway::speech::sector_of;
use domains::highway::{AZIMUTHS, BEAMS, SECTORS};
use domains::{Layout, Mask};
use models::SelfModel;
use models::self_model::Batch;
use nn::{Tensor, noise};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// How sequences are chosen in a domain, and what of them is perceived.
pub trait Dropout: Send {
    /// A batch begins.
    fn batch(&mut self, rng: &mut ChaCha8Rng);

    /// The next sequence, the `column`-th of its shard: a round and the first of up to `length` observations; none if there is no
    /// such sequence yet.
    fn sequence<'a>(
        &mut self,
        column: usize,
        replay: &'a Replay,
        length: usize,
        rng: &mut ChaCha8Rng,
    ) -> Option<(&'a Episode, usize)>;

    /// What of observation `t` of this sequence is perceived.
    fn mask(&mut self, t: usize, visual: &[f32], rng: &mut ChaCha8Rng) -> Mask;

    /// Whether what the expert does there is a demonstration to somebody who perceives this sequence.
    fn demonstrates(&self) -> bool;

    /// In how many parts a shard's noise is drawn.
    fn noise_parts(&self, steps: usize) -> usize;
}

/// The dropout of a domain; `keep`: probability that a region or an utterance is kept where each is dropped by itself.
pub fn dropout(layout: &Arc<Layout>, keep: f32) -> Box<dyn Dropout> {
    if layout.domain == modalities::NAME {
        return Box::new(HighwayDropout {
            layout: Arc::clone(layout),
            keep,
            way: HighwayWay::Nothing,
            limits_m: [0.0; AZIMUTHS],
        });
    }
    Box::new(GridworldDropout {
        keep,
        way: GridworldWay::Everything,
        limits: vec![0.0; layout.perception.limits()],
        chance: vec![0.0; layout.perception.noise_rows()],
        layout: Arc::clone(layout),
    })
}

/// A part of a batch.
pub struct Shard {
    /// Input of the ELBO.
    pub batch: Batch,
    /// What the expert would do after each observation, `numbers of an action × (steps · columns)`; zeros where that is no
    /// demonstration.
    pub expert: Tensor,
    /// 1 where the observation has no future, `1 × …`.
    pub terminal: Tensor,
}

/// Draws batches, in shards.
pub struct Drawing {
    /// Parts of a batch.
    pub shards: Vec<Shard>,
    dropout: Box<dyn Dropout>,
}

impl Drawing {
    /// Room for `sequences` sequences of `length` observations.
    pub fn new(model: &SelfModel, sequences: usize, length: usize, keep: f32) -> Self {
        let shards = (0..SHARDS).map(|s| {
            let columns = sequences * (s + 1) / SHARDS - sequences * s / SHARDS;
            Shard {
                batch: Batch::new(model, length, columns),
                expert: Tensor::new(model.sizes.shape.action, length * columns),
                terminal: Tensor::new(1, length * columns),
            }
        });
        Self {
            shards: shards.collect(),
            dropout: dropout(&model.layout, keep),
        }
    }

    /// Fills every shard from the buffer; whether it holds such sequences.
    pub fn draw(&mut self, model: &SelfModel, replay: &Replay, rng: &mut ChaCha8Rng) -> bool {
        let dropout = &mut *self.dropout;
        dropout.batch(rng);
        for shard in &mut self.shards {
            let (steps, columns) = (shard.batch.steps, shard.batch.columns);
            for column in 0..columns {
                let Some((episode, start)) = dropout.sequence(column, replay, steps, rng) else {
                    return false;
                };
                for t in 0..steps {
                    let at = t * columns + column;
                    match start + t < episode.len() {
                        true => shard.fill(at, t, (episode, start), dropout, model, rng),
                        false => shard.clear(at),
                    }
                }
            }
            let noise = shard.batch.noise.data_mut();
            let part = noise.len() / dropout.noise_parts(steps);
            for noise in noise.chunks_exact_mut(part) {
                noise::fill(noise, rng.random(), 0);
            }
        }
        true
    }
}

impl Shard {
    /// Writes observation `t` of a sequence to a column.
    fn fill(
        &mut self,
        at: usize,
        t: usize,
        (episode, start): (&Episode, usize),
        dropout: &mut dyn Dropout,
        model: &SelfModel,
        rng: &mut ChaCha8Rng,
    ) {
        let (batch, from) = (&mut self.batch, start + t);
        let (visual, verbal) = (episode.visual(from), episode.verbal(from));
        let mask = dropout.mask(t, visual, rng);
        let observed = batch.observed.column_mut(at);
        model.view.write(visual, verbal, mask, observed);
        batch.visual.column_mut(at).copy_from_slice(visual);
        batch.verbal.column_mut(at).copy_from_slice(verbal);
        // A sequence that begins within a round begins with the first step's network, which knows no action.
        let action = batch.action.column_mut(at);
        match t {
            0 => action.fill(0.0),
            _ => action.copy_from_slice(episode.action(from)),
        }
        batch.reward.data_mut()[at] = episode.reward[from];
        batch.weight.data_mut()[at] = 1.0;
        let expert = self.expert.column_mut(at);
        match dropout.demonstrates() {
            true => expert.copy_from_slice(episode.expert(from)),
            false => expert.fill(0.0),
        }
        let is_last = from + 1 == episode.len();
        self.terminal.data_mut()[at] = f32::from(u8::from(is_last && episode.terminal));
    }

    /// Beyond a round's end nothing counts.
    fn clear(&mut self, at: usize) {
        let batch = &mut self.batch;
        for tensor in [
            &mut batch.observed,
            &mut batch.visual,
            &mut batch.verbal,
            &mut batch.action,
            &mut batch.reward,
            &mut batch.weight,
            &mut self.expert,
            &mut self.terminal,
        ] {
            tensor.column_mut(at).fill(0.0);
        }
    }
}

/// What a gridworld's sequence perceives.
#[derive(Clone, Copy, Debug)]
enum GridworldWay {
    Everything,
    /// Each region and utterance of each step is kept with the same probability.
    Singles,
    /// As a person with these limits would see, who hears what they are told: each hidden item with this probability.
    Person {
        told: f32,
    },
}

/// The gridworlds': a way is drawn for each sequence.
struct GridworldDropout {
    layout: Arc<Layout>,
    keep: f32,
    way: GridworldWay,
    limits: Vec<f32>,
    chance: Vec<f32>,
}

impl Dropout for GridworldDropout {
    fn batch(&mut self, _: &mut ChaCha8Rng) {}

    /// A third of the sequences begin where rounds do, for that is where every belief begins, and a third end where rounds do:
    /// that is where most of the reward is, and the steps before it are what leads there.
    fn sequence<'a>(
        &mut self,
        _: usize,
        replay: &'a Replay,
        length: usize,
        rng: &mut ChaCha8Rng,
    ) -> Option<(&'a Episode, usize)> {
        let episodes = replay.episodes();
        if episodes.is_empty() {
            return None;
        }
        let episode = &episodes[rng.random_range(0..episodes.len())];
        let latest = episode.len().saturating_sub(length);
        let start = match rng.random_range(0..3) {
            0 => 0,
            1 => latest,
            _ => rng.random_range(0..=latest),
        };
        self.way = match rng.random_range(0..4) {
            0 => GridworldWay::Everything,
            1 => GridworldWay::Singles,
            _ => {
                // Half of these people see nothing or nearly nothing.
                let share = (rng.random_range(-0.5_f32..1.0)).max(0.0);
                let told = [0.0, 0.05, 0.2][rng.random_range(0..3)];
                for limit in &mut self.limits {
                    let own = (share * rng.random_range(0.5..1.5)).clamp(0.0, 1.0);
                    *limit = own * self.layout.perception.largest();
                }
                GridworldWay::Person { told }
            }
        };
        Some((episode, start))
    }

    fn mask(&mut self, _: usize, visual: &[f32], rng: &mut ChaCha8Rng) -> Mask {
        let everything = self.layout.everything();
        match self.way {
            GridworldWay::Everything => everything,
            GridworldWay::Singles => subset(everything, self.keep, rng),
            GridworldWay::Person { told } => {
                let chance = (!self.chance.is_empty()).then(|| {
                    noise::fill(&mut self.chance, rng.random(), 0);
                    &self.chance[..]
                });
                let seen = Mask {
                    visual: self.layout.perception.seen(&self.limits, visual, chance),
                    verbal: 0,
                };
                seen | subset(everything, told, rng)
            }
        }
    }

    /// The expert sees everything: what it does is a demonstration only to those who do.
    fn demonstrates(&self) -> bool {
        matches!(self.way, GridworldWay::Everything)
    }

    fn noise_parts(&self, _: usize) -> usize {
        1
    }
}

/// Each item with the same probability.
fn subset(of: Mask, probability: f32, rng: &mut ChaCha8Rng) -> Mask {
    let mut draw = |bits: u64| {
        (0..64)
            .filter(|bit| bits >> bit & 1 == 1)
            .fold(0, |kept, bit| {
                kept | u64::from(rng.random::<f32>() < probability) << bit
            })
    };
    Mask {
        visual: draw(of.visual),
        verbal: draw(of.verbal.into()) as u32,
    }
}

/// What a batch of the highway perceives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum HighwayWay {
    Nothing,
    Sectors,
    Singles,
    /// What lies beyond a distance, drawn per sector and sequence: how fog hides things, and how a perceptual implant
    /// does. Without it, people in fog see in a way that the model has never met.
    Distances,
}

/// The highway's: a way is drawn for each batch.
struct HighwayDropout {
    layout: Arc<Layout>,
    keep: f32,
    way: HighwayWay,
    limits_m: [f32; AZIMUTHS],
}

impl HighwayDropout {
    fn kept(&self, rng: &mut ChaCha8Rng) -> bool {
        rng.random::<f32>() < self.keep
    }

    fn visual(&self, visual: &[f32], rng: &mut ChaCha8Rng) -> u64 {
        match self.way {
            HighwayWay::Nothing => self.layout.everything().visual,
            HighwayWay::Distances => self.layout.perception.seen(&self.limits_m, visual, None),
            HighwayWay::Sectors => {
                let sectors: [bool; SECTORS] = core::array::from_fn(|_| self.kept(rng));
                bits((0..AZIMUTHS).map(|azimuth| sectors[sector_of(azimuth)]))
            }
            HighwayWay::Singles => bits((0..AZIMUTHS).map(|_| self.kept(rng))),
        }
    }

    /// Speech is rare: the robot filters without any, so half of all steps have none whatever the batch's way.
    fn verbal(&self, rng: &mut ChaCha8Rng) -> u32 {
        if self.way == HighwayWay::Nothing || rng.random::<bool>() {
            return 0;
        }
        bits((0..SECTORS).map(|_| self.kept(rng))) as u32
    }
}

impl Dropout for HighwayDropout {
    fn batch(&mut self, rng: &mut ChaCha8Rng) {
        self.way = match rng.random_range(0..5) {
            0 => HighwayWay::Nothing,
            1 => HighwayWay::Sectors,
            2 => HighwayWay::Singles,
            _ => HighwayWay::Distances,
        };
    }

    /// Every other sequence is one in which something is going on, if 100 draws meet one.
    fn sequence<'a>(
        &mut self,
        column: usize,
        replay: &'a Replay,
        length: usize,
        rng: &mut ChaCha8Rng,
    ) -> Option<(&'a Episode, usize)> {
        let (mut episode, mut start) = replay.draw(length, rng)?;
        if column.is_multiple_of(2) {
            for _ in 1..100 {
                if (start..start + length).any(|t| is_eventful(episode, t)) {
                    break;
                }
                (episode, start) = replay.draw(length, rng)?;
            }
        }
        self.limits_m = limits_m(rng);
        Some((episode, start))
    }

    fn mask(&mut self, t: usize, visual: &[f32], rng: &mut ChaCha8Rng) -> Mask {
        // A kept first step tells what is hidden later; but a person who starts in fog starts with little, so half of the
        // sequences do too.
        let visual = match t == 0 && rng.random::<bool>() {
            true => self.layout.everything().visual,
            false => self.visual(visual, rng),
        };
        Mask {
            visual,
            verbal: self.verbal(rng),
        }
    }

    fn demonstrates(&self) -> bool {
        true
    }

    fn noise_parts(&self, steps: usize) -> usize {
        steps
    }
}

/// Whether something is going on: a car within 20 m, an expert who brakes or steers, or an end. Most of a drive is
/// empty road; what has to be learned happens in a few seconds of it.
fn is_eventful(episode: &Episode, t: usize) -> bool {
    let expert = episode.expert(t);
    let beams = &episode.visual(t)[..BEAMS];
    episode.terminal && t + 1 == episode.len()
        || expert[0] < -0.2
        || expert[1].abs() > 0.2
        || beams.iter().any(|nearness| *nearness > 0.5)
}

/// Limits of sight: a distance per sector, from almost nothing to beyond the LIDAR's range.
pub fn limits_m(rng: &mut ChaCha8Rng) -> [f32; AZIMUTHS] {
    let sectors: [f32; SECTORS] = core::array::from_fn(|_| rng.random_range(1.0..MAX_SIGHT_M));
    core::array::from_fn(|azimuth| sectors[sector_of(azimuth)])
}

/// A bit for each that is true.
fn bits(all: impl Iterator<Item = bool>) -> u64 {
    all.enumerate()
        .fold(0, |bits, (i, is_in)| bits | u64::from(is_in) << i)
}
