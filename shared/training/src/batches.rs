//! Batches of sequences out of the replay buffer, with modality dropout (paper §III-A "Practical aspects"):
//! the model has to learn from data that approximate the ways in which observations can appear to a person.

use crate::SHARDS;
use crate::replay::{Replay, Step};
use domains::Mask;
use domains::highway::modalities::MAX_SIGHT_M;
use domains::highway::speech::sector_of;
use domains::highway::{AZIMUTHS, SECTORS};
use models::SelfModel;
use models::self_model::Batch;
use models::utterances::UtteranceTable;
use nn::{Tensor, noise};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// How modalities are dropped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dropout {
    /// Probability that a sector or a single value is kept.
    pub keep: f32,
}

/// Which way of dropping a batch uses; one is drawn per batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    Nothing,
    Sectors,
    Singles,
    /// What lies beyond a distance, drawn per sector and sequence: how fog hides things, and how a perceptual implant
    /// does. Without it, people in fog see in a way that the model has never met.
    Distances,
}

/// Batches in shards, with everything that actor and critics need beside the observations.
pub struct Drawing {
    /// One batch per shard.
    pub shards: Vec<Shard>,
}

/// A part of a batch.
pub struct Shard {
    /// Input of the ELBO.
    pub batch: Batch,
    /// What the expert would do, `2 × (steps · columns)`, step after step.
    pub expert: Tensor,
    /// 1 where the future ends at this step, `1 × (steps · columns)`.
    pub terminal: Tensor,
}

impl Drawing {
    /// Room for `sequences` sequences of `length` steps.
    pub fn new(model: &SelfModel, sequences: usize, length: usize) -> Self {
        let shards = (0..SHARDS)
            .map(|s| {
                let columns = sequences * (s + 1) / SHARDS - sequences * s / SHARDS;
                let mut batch = Batch::new(model, length, columns);
                batch.weight.fill(1.0);
                Shard {
                    expert: Tensor::new(model.sizes.shape.action, length * columns),
                    terminal: Tensor::new(1, length * columns),
                    batch,
                }
            })
            .collect();
        Self { shards }
    }

    /// Draws sequences, masks and noise. Returns false if the buffer holds no sequence of that length yet.
    pub fn draw(
        &mut self,
        model: &SelfModel,
        replay: &Replay,
        table: &UtteranceTable,
        dropout: Dropout,
        rng: &mut ChaCha8Rng,
    ) -> bool {
        let way = match rng.random_range(0..5) {
            0 => Way::Nothing,
            1 => Way::Sectors,
            2 => Way::Singles,
            _ => Way::Distances,
        };
        for shard in &mut self.shards {
            let (length, columns) = (shard.batch.steps, shard.batch.columns);
            for j in 0..columns {
                // Every other sequence is one in which something is going on.
                let drawn = if j % 2 == 0 {
                    replay.draw_eventful(length, rng)
                } else {
                    replay.draw(length, rng)
                };
                let Some(start) = drawn else {
                    return false;
                };
                let limits_m = limits_m(rng);
                for t in 0..length {
                    let at = t * columns + j;
                    shard.fill(at, replay.get(start + t), table);
                    let batch = &mut shard.batch;
                    let visual = batch.visual.column(at);
                    let mask = if t == 0 && rng.random::<bool>() {
                        // A kept first step tells what is hidden later; but a person who starts in fog starts with
                        // little, so half of the sequences do too.
                        Mask {
                            visual: everything(),
                            verbal: verbal_mask(way, dropout, rng),
                        }
                    } else {
                        Mask {
                            visual: visual_mask(way, dropout, model, &limits_m, visual, rng),
                            verbal: verbal_mask(way, dropout, rng),
                        }
                    };
                    let (verbal, out) = (batch.verbal.column(at), batch.observed.column_mut(at));
                    model.view.write(visual, verbal, mask, out);
                }
            }
            // Step by step, each with its own.
            let step = shard.batch.noise.rows() * columns;
            for noise in shard.batch.noise.data_mut().chunks_exact_mut(step) {
                noise::fill(noise, rng.random(), 0);
            }
        }
        true
    }
}

impl Shard {
    fn fill(&mut self, at: usize, lived: &Step, table: &UtteranceTable) {
        let batch = &mut self.batch;
        batch.visual.column_mut(at).copy_from_slice(&lived.visual);
        lived.write_verbal(table, batch.verbal.column_mut(at));
        batch.action.column_mut(at).copy_from_slice(&lived.action);
        batch.reward.data_mut()[at] = lived.reward;
        self.expert.column_mut(at).copy_from_slice(&lived.expert);
        self.terminal.data_mut()[at] = f32::from(lived.terminal);
    }
}

fn everything() -> u64 {
    u64::MAX >> (64 - AZIMUTHS)
}

fn kept(dropout: Dropout, rng: &mut ChaCha8Rng) -> bool {
    rng.random::<f32>() < dropout.keep
}

/// Limits of sight: a distance per sector, from almost nothing to beyond the LIDAR's range.
pub fn limits_m(rng: &mut ChaCha8Rng) -> [f32; AZIMUTHS] {
    let sectors: [f32; SECTORS] = core::array::from_fn(|_| rng.random_range(1.0..MAX_SIGHT_M));
    core::array::from_fn(|azimuth| sectors[sector_of(azimuth)])
}

fn visual_mask(
    way: Way,
    dropout: Dropout,
    model: &SelfModel,
    limits_m: &[f32; AZIMUTHS],
    visual: &[f32],
    rng: &mut ChaCha8Rng,
) -> u64 {
    match way {
        Way::Nothing => everything(),
        Way::Distances => model.layout.perception.seen(limits_m, visual, None),
        Way::Sectors => {
            let sectors: [bool; SECTORS] = core::array::from_fn(|_| kept(dropout, rng));
            bits((0..AZIMUTHS).map(|azimuth| sectors[sector_of(azimuth)]))
        }
        Way::Singles => bits((0..AZIMUTHS).map(|_| kept(dropout, rng))),
    }
}

/// Speech is rare: the robot filters without any, so half of all steps have none whatever the batch's way.
fn verbal_mask(way: Way, dropout: Dropout, rng: &mut ChaCha8Rng) -> u32 {
    if way == Way::Nothing || rng.random::<bool>() {
        return 0;
    }
    bits((0..SECTORS).map(|_| kept(dropout, rng))) as u32
}

/// A bit for each that is true.
fn bits(all: impl Iterator<Item = bool>) -> u64 {
    all.enumerate()
        .fold(0, |bits, (i, is_in)| bits | u64::from(is_in) << i)
}
