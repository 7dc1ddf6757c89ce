//! Batches of sequences out of the replay buffer, with modality dropout (paper §III-A "Practical aspects"; DESIGN §5):
//! the model has to learn from data that approximate the ways in which observations can appear to a person.

use crate::SHARDS;
use crate::replay::Replay;
use models::Implants;
use models::implants::MAX_THRESHOLD_M;
use models::observation::{AZIMUTHS, Encoded, SECTORS, sector_of};
use models::self_model::{Sequence, SequenceStep, Sizes};
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
    /// does. Not in DESIGN's list; without it, people in fog see in a way that the model has never met.
    Distances,
}

/// A batch of sequences in shards, with everything that actor and critics need beside the observations.
pub struct Batch {
    /// One sequence batch per shard.
    pub shards: Vec<Shard>,
}

/// A part of a batch.
pub struct Shard {
    /// Input of the ELBO.
    pub sequence: Sequence,
    /// What the expert would do, one tensor per step, `2 × batch`.
    pub expert: Vec<Tensor>,
    /// 1 where the future ends at this step, `1 × batch` per step.
    pub terminal: Vec<Tensor>,
    encoded: Encoded,
}

impl Batch {
    /// Room for `sequences` sequences of `length` steps.
    pub fn new(sizes: &Sizes, sequences: usize, length: usize) -> Self {
        let shards = (0..SHARDS)
            .map(|s| {
                let batch = sequences * (s + 1) / SHARDS - sequences * s / SHARDS;
                Shard {
                    sequence: Sequence {
                        steps: (0..length)
                            .map(|_| SequenceStep::new(sizes, batch))
                            .collect(),
                    },
                    expert: vec![Tensor::new(sizes.shape.action, batch); length],
                    terminal: vec![Tensor::new(1, batch); length],
                    encoded: Encoded::new(sizes.shape, batch),
                }
            })
            .collect();
        Self { shards }
    }

    /// Draws sequences, masks and noise. Returns false if the buffer holds no sequence of that length yet.
    pub fn draw(
        &mut self,
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
            let length = shard.sequence.steps.len();
            let batch = shard.expert[0].cols();
            for j in 0..batch {
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
                    shard.fill(t, j, replay, start + t, table);
                    let visual = shard.sequence.steps[t].visual.column(j);
                    let (visual_mask, verbal_mask) = if t == 0 && rng.random::<bool>() {
                        // A kept first step tells what is hidden later; but a person who starts in fog starts with
                        // little, so half of the sequences do too.
                        ([1.0; AZIMUTHS], verbal_mask(way, dropout, rng))
                    } else {
                        (
                            visual_mask(way, dropout, &limits_m, visual, rng),
                            verbal_mask(way, dropout, rng),
                        )
                    };
                    let step = &shard.sequence.steps[t];
                    shard.encoded.set(
                        j,
                        step.visual.column(j),
                        step.verbal.column(j),
                        &visual_mask,
                        &verbal_mask,
                    );
                    let step = &mut shard.sequence.steps[t];
                    step.observed
                        .column_mut(j)
                        .copy_from_slice(shard.encoded.rows.column(j));
                }
            }
            for step in &mut shard.sequence.steps {
                noise::fill(step.noise.data_mut(), rng.random(), 0);
            }
        }
        true
    }
}

impl Shard {
    fn fill(&mut self, t: usize, j: usize, replay: &Replay, i: usize, table: &UtteranceTable) {
        let lived = replay.get(i);
        let step = &mut self.sequence.steps[t];
        step.visual.column_mut(j).copy_from_slice(&lived.visual);
        lived.write_verbal(table, step.verbal.column_mut(j));
        step.action.column_mut(j).copy_from_slice(&lived.action);
        step.reward.column_mut(j)[0] = lived.reward;
        self.expert[t].column_mut(j).copy_from_slice(&lived.expert);
        self.terminal[t].column_mut(j)[0] = f32::from(lived.terminal);
    }
}

fn kept(dropout: Dropout, rng: &mut ChaCha8Rng) -> f32 {
    f32::from(u8::from(rng.random::<f32>() < dropout.keep))
}

/// Limits of sight: a distance per sector, from almost nothing to beyond the LIDAR's range.
pub fn limits_m(rng: &mut ChaCha8Rng) -> [f32; AZIMUTHS] {
    let sectors: [f32; SECTORS] = core::array::from_fn(|_| rng.random_range(1.0..MAX_THRESHOLD_M));
    core::array::from_fn(|azimuth| sectors[sector_of(azimuth)])
}

fn visual_mask(
    way: Way,
    dropout: Dropout,
    limits_m: &[f32; AZIMUTHS],
    visual: &[f32],
    rng: &mut ChaCha8Rng,
) -> [f32; AZIMUTHS] {
    match way {
        Way::Nothing => [1.0; AZIMUTHS],
        Way::Distances => {
            let mut mask = [0.0; AZIMUTHS];
            Implants::visible(limits_m, visual, &mut mask);
            mask
        }
        Way::Sectors => {
            let sectors: [f32; SECTORS] = core::array::from_fn(|_| kept(dropout, rng));
            core::array::from_fn(|azimuth| sectors[sector_of(azimuth)])
        }
        Way::Singles => core::array::from_fn(|_| kept(dropout, rng)),
    }
}

/// Speech is rare: the robot filters without any, so half of all steps have none whatever the batch's way.
fn verbal_mask(way: Way, dropout: Dropout, rng: &mut ChaCha8Rng) -> [f32; SECTORS] {
    if way == Way::Nothing || rng.random::<bool>() {
        return [0.0; SECTORS];
    }
    core::array::from_fn(|_| kept(dropout, rng))
}
