//! Batches of sequences out of whole rounds, with modality dropout (paper §III-A, "Practical aspects"): the model has to learn
//! from data that approximate the ways in which observations can appear to a person.

use super::replay::{NO_ACTION, Replay};
use crate::SHARDS;
use domains::{Mask, Perception};
use models::SelfModel;
use models::self_model::Batch;
use nn::noise;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// How modalities are dropped; one way is drawn per sequence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dropout {
    /// Probability that a region or an utterance is kept where each is dropped by itself.
    pub keep: f32,
}

/// What a sequence perceives.
#[derive(Clone, Copy, Debug)]
enum Way {
    Everything,
    /// Each region and utterance of each step is kept with this probability.
    Singles(f32),
    /// As a person with these limits would see, who hears what they are told: each hidden item with this probability.
    Person {
        share: f32,
        told: f32,
    },
}

/// A part of a batch.
pub struct Shard {
    /// Input of the ELBO.
    pub batch: Batch,
    /// Action taken after each observation, one per column; [`NO_ACTION`] at the end.
    pub taken: Vec<u8>,
    /// What the expert would do after each observation, in sequences that perceive all that it does; else [`NO_ACTION`].
    pub expert: Vec<u8>,
    /// 1 where the observation has no future.
    pub terminal: Vec<f32>,
}

/// Draws batches, in shards.
pub struct Drawing {
    /// Parts of a batch.
    pub shards: Vec<Shard>,
    perception: &'static dyn Perception,
    everything: Mask,
    limits: Vec<f32>,
    chance: Vec<f32>,
}

impl Drawing {
    /// Room for `sequences` sequences of `length` observations.
    pub fn new(model: &SelfModel, sequences: usize, length: usize) -> Self {
        let perception = model.layout.perception;
        let shards = (0..SHARDS)
            .map(|s| {
                let columns = sequences * (s + 1) / SHARDS - sequences * s / SHARDS;
                Shard {
                    batch: Batch::new(model, length, columns),
                    taken: vec![NO_ACTION; length * columns],
                    expert: vec![NO_ACTION; length * columns],
                    terminal: vec![0.0; length * columns],
                }
            })
            .collect();
        Self {
            shards,
            everything: model.layout.everything(),
            limits: vec![0.0; perception.limits()],
            chance: vec![0.0; perception.noise_rows()],
            perception,
        }
    }

    /// Fills every shard from the buffer, which must hold a round.
    pub fn draw(
        &mut self,
        model: &SelfModel,
        replay: &Replay,
        dropout: Dropout,
        rng: &mut ChaCha8Rng,
    ) {
        for s in 0..self.shards.len() {
            let columns = self.shards[s].batch.columns;
            for column in 0..columns {
                self.draw_sequence(s, column, model, replay, dropout, rng);
            }
            let batch = &mut self.shards[s].batch;
            noise::fill(batch.noise.data_mut(), rng.random(), 0);
        }
    }

    fn draw_sequence(
        &mut self,
        s: usize,
        column: usize,
        model: &SelfModel,
        replay: &Replay,
        dropout: Dropout,
        rng: &mut ChaCha8Rng,
    ) {
        let episodes = replay.episodes();
        let episode = &episodes[rng.random_range(0..episodes.len())];
        let shape = model.sizes.shape;
        let (steps, columns) = (self.shards[s].batch.steps, self.shards[s].batch.columns);
        // A third of the sequences begin where rounds do, for that is where every belief begins, and a third end where rounds do:
        // that is where most of the reward is, and the steps before it are what leads there.
        let latest = episode.len().saturating_sub(steps.min(episode.len()));
        let start = match rng.random_range(0..3) {
            0 => 0,
            1 => latest,
            _ => rng.random_range(0..=latest),
        };
        let way = match rng.random_range(0..4) {
            0 => Way::Everything,
            1 => Way::Singles(dropout.keep),
            _ => Way::Person {
                // Half of these people see nothing or nearly nothing.
                share: (rng.random_range(-0.5_f32..1.0)).max(0.0),
                told: [0.0, 0.05, 0.2][rng.random_range(0..3)],
            },
        };
        if let Way::Person { share, .. } = way {
            for limit in &mut self.limits {
                let own = (share * rng.random_range(0.5..1.5)).clamp(0.0, 1.0);
                *limit = own * self.perception.largest();
            }
        }
        for t in 0..steps {
            let at = t * columns + column;
            let from = start + t;
            let shard = &mut self.shards[s];
            let batch = &mut shard.batch;
            if from >= episode.len() {
                // Beyond the end: nothing counts.
                batch.weight.data_mut()[at] = 0.0;
                batch.reward.data_mut()[at] = 0.0;
                for tensor in [
                    &mut batch.observed,
                    &mut batch.visual,
                    &mut batch.verbal,
                    &mut batch.action,
                ] {
                    tensor.column_mut(at).fill(0.0);
                }
                shard.taken[at] = NO_ACTION;
                shard.expert[at] = NO_ACTION;
                shard.terminal[at] = 0.0;
                continue;
            }
            let visual = &episode.visual[from * shape.visual..(from + 1) * shape.visual];
            let verbal = &episode.verbal[from * shape.verbal..(from + 1) * shape.verbal];
            let mask = match way {
                Way::Everything => self.everything,
                Way::Singles(keep) => subset(self.everything, keep, rng),
                Way::Person { told, .. } => {
                    let chance = (!self.chance.is_empty()).then(|| {
                        noise::fill(&mut self.chance, rng.random(), 0);
                        &self.chance[..]
                    });
                    let seen = Mask {
                        visual: self.perception.seen(&self.limits, visual, chance),
                        verbal: 0,
                    };
                    seen | subset(self.everything, told, rng)
                }
            };
            model
                .view
                .write(visual, verbal, mask, batch.observed.column_mut(at));
            batch.visual.column_mut(at).copy_from_slice(visual);
            batch.verbal.column_mut(at).copy_from_slice(verbal);
            let action = batch.action.column_mut(at);
            action.fill(0.0);
            // A sequence that begins within a round begins with the first step's network, which knows no action.
            if t > 0 {
                action[usize::from(episode.action[from])] = 1.0;
            }
            batch.reward.data_mut()[at] = episode.reward[from];
            batch.weight.data_mut()[at] = 1.0;
            shard.expert[at] = match way {
                Way::Everything => episode.expert[from],
                _ => NO_ACTION,
            };
            let last = from + 1 == episode.len();
            shard.terminal[at] = f32::from(u8::from(last && episode.terminal));
            shard.taken[at] = if last || t + 1 == steps {
                NO_ACTION
            } else {
                episode.action[from + 1]
            };
        }
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
