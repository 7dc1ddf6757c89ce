//! Batches of sequences out of whole rounds, with modality dropout (paper §III-A, "Practical aspects"): the model has to learn
//! from data that approximate the ways in which observations can appear to a person.

use crate::SHARDS;
use crate::replay::{Episode, Replay};
use crate::sighted::subset;
use domains::highway::modalities;
use domains::highway::speech::sector_of;
use domains::highway::{AZIMUTHS, BEAMS, SECTORS};
use domains::{Layout, Mask};
use models::SelfModel;
use models::self_model::Batch;
use nn::{Tensor, noise};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// What a sequence perceives: never less than whoever acted. What they did would tell the model what it cannot know, and it would come
/// to believe that acting as if it knew makes it so (an actor's own actions taken as evidence; Ortega et al. 2021, "Shaking the
/// foundations"). Who acted had also seen what came before: a sequence that begins within a round begins with all there is to see.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    /// Everything that the robot senses.
    Everything,
    /// What whoever acted perceived.
    Actor,
    /// That, and of everything else each region and utterance with the same probability.
    Singles,
    /// That, and some of the highway's sectors, as its display would show them.
    Sectors,
}

/// How sequences are chosen in a domain, and what of them is perceived.
struct Dropout {
    layout: Arc<Layout>,
    /// Probability that a region or an utterance is kept where each is dropped by itself.
    keep: f32,
    is_highway: bool,
}

impl Dropout {
    fn new(layout: &Arc<Layout>, keep: f32) -> Self {
        Self {
            layout: Arc::clone(layout),
            keep,
            is_highway: layout.domain == modalities::NAME,
        }
    }

    /// The next sequence, the `column`-th of its shard: a round and the first of up to `length` observations; none if there is no
    /// such sequence yet.
    fn sequence<'a>(
        &self,
        column: usize,
        replay: &'a Replay,
        length: usize,
        rng: &mut ChaCha8Rng,
    ) -> Option<(&'a Episode, usize)> {
        if self.is_highway {
            return drive(column, replay, length, rng);
        }
        // A third of the sequences begin where rounds do, for that is where every belief begins, and a third end where rounds do:
        // that is where most of the reward is, and the steps before it are what leads there.
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
        Some((episode, start))
    }

    fn way(&self, rng: &mut ChaCha8Rng) -> Way {
        match rng.random_range(0..6) {
            0 | 1 => Way::Everything,
            2 => Way::Singles,
            3 if self.is_highway => Way::Sectors,
            _ => Way::Actor,
        }
    }

    /// What is perceived of an observation of which whoever acted perceived `actor`; `first`: it begins a sequence within a round.
    fn mask(&self, way: Way, first: bool, actor: Mask, rng: &mut ChaCha8Rng) -> Mask {
        let Layout { sensed, .. } = *self.layout;
        let mut mask = match way {
            _ if first => sensed,
            Way::Everything => sensed,
            Way::Actor => actor,
            Way::Singles => {
                let mut more = subset(sensed, self.keep, rng);
                if self.is_highway {
                    more.verbal = 0;
                }
                actor | more
            }
            Way::Sectors => {
                let sectors: [bool; SECTORS] =
                    core::array::from_fn(|_| rng.random::<f32>() < self.keep);
                let shown = (0..AZIMUTHS).filter(|azimuth| sectors[sector_of(*azimuth)]);
                let visual = shown.fold(0, |bits, azimuth| bits | 1 << azimuth);
                actor | Mask { visual, verbal: 0 }
            }
        };
        // On the highway the robot filters without speech, which is rare: half of all steps have none whatever the way.
        if self.is_highway && way != Way::Everything && rng.random::<bool>() {
            mask.verbal |= subset(self.layout.everything(), self.keep, rng).verbal;
        }
        mask
    }
}

/// A sequence of the highway. Every other one is one in which something is going on, if 100 draws meet one; every eighth begins where
/// its round does, for that is where every belief begins.
fn drive<'a>(
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
    if column % 8 == 1 {
        start = 0;
    }
    Some((episode, start))
}

/// A part of a batch.
pub struct Shard {
    /// Input of the ELBO.
    pub batch: Batch,
    /// What an expert would do after each observation who perceives as much of it, `numbers of an action × (steps · columns)`; zeros
    /// where there is none.
    pub expert: Tensor,
    /// 1 where there is one, `1 × …`.
    pub imitated: Tensor,
}

/// Draws batches, in shards.
pub struct Drawing {
    /// Parts of a batch.
    pub shards: Vec<Shard>,
    dropout: Dropout,
}

impl Drawing {
    /// Room for `sequences` sequences of `length` observations.
    pub fn new(model: &SelfModel, sequences: usize, length: usize, keep: f32) -> Self {
        let shards = (0..SHARDS).map(|s| {
            let columns = sequences * (s + 1) / SHARDS - sequences * s / SHARDS;
            Shard {
                batch: Batch::new(model, length, columns),
                expert: Tensor::new(model.sizes.shape.action, length * columns),
                imitated: Tensor::new(1, length * columns),
            }
        });
        Self {
            shards: shards.collect(),
            dropout: Dropout::new(&model.layout, keep),
        }
    }

    /// Fills every shard from the buffer; whether it holds such sequences.
    pub fn draw(&mut self, model: &SelfModel, replay: &Replay, rng: &mut ChaCha8Rng) -> bool {
        let dropout = &self.dropout;
        for shard in &mut self.shards {
            let (steps, columns) = (shard.batch.steps, shard.batch.columns);
            for column in 0..columns {
                let Some((episode, start)) = dropout.sequence(column, replay, steps, rng) else {
                    return false;
                };
                let way = dropout.way(rng);
                for t in 0..steps {
                    let at = t * columns + column;
                    match start + t < episode.len() {
                        true => {
                            let actor = episode.perceived[start + t];
                            let mask = dropout.mask(way, t == 0 && start > 0, actor, rng);
                            shard.fill(at, t, (episode, start), mask, model);
                        }
                        false => shard.clear(at),
                    }
                }
            }
            noise::fill(shard.batch.noise.data_mut(), rng.random(), 0);
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
        mask: Mask,
        model: &SelfModel,
    ) {
        let (batch, from) = (&mut self.batch, start + t);
        let (visual, verbal) = (episode.visual(from), episode.verbal(from));
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
        // What an expert does is a demonstration only to those who perceive as much.
        let sensed = model.layout.sensed;
        let demonstrated = if mask & sensed == sensed {
            Some(episode.expert(from))
        } else {
            (mask == episode.perceived[from]).then(|| episode.peer(from))
        };
        let demonstrated = demonstrated.filter(|action| action.iter().any(|x| *x != 0.0));
        let expert = self.expert.column_mut(at);
        match demonstrated {
            Some(action) => expert.copy_from_slice(action),
            None => expert.fill(0.0),
        }
        self.imitated.data_mut()[at] = f32::from(u8::from(demonstrated.is_some()));
        let is_last = from + 1 == episode.len();
        self.batch.ended.data_mut()[at] = f32::from(u8::from(is_last && episode.terminal));
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
            &mut batch.ended,
            &mut self.expert,
            &mut self.imitated,
        ] {
            tensor.column_mut(at).fill(0.0);
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::{Environment, shipped};
    use crate::rollout::{Actor, Rollout};
    use domains::discrete::Setting;
    use models::Sizes;
    use rand::SeedableRng;

    /// Some rounds of a domain, lived with limited sight and without.
    fn lived(domain: &'static str) -> (SelfModel, Replay) {
        let environment: Box<dyn Environment> = shipped(domain, Setting::Original).expect("ships");
        let layout = Arc::clone(environment.layout());
        let sizes = Sizes::of(&layout).with_hidden(16);
        let model = SelfModel::new(
            sizes,
            Arc::clone(&layout),
            &mut ChaCha8Rng::seed_from_u64(1),
        );
        let has_peer = environment.has_peer();
        let mut rollout = Rollout::new(environment, &model);
        let mut replay = Replay::new(100_000, &layout);
        for number in 0..8 {
            let limited = Actor::Policy {
                explore: 0.5,
                limited: true,
            };
            let actor = match number % 3 {
                0 => Actor::Expert { slips: 0.0 },
                1 if has_peer => Actor::Peer,
                _ => limited,
            };
            let (_, episode) = rollout.episode(&model, actor, 3, number);
            replay.push(episode.clone());
        }
        (model, replay)
    }

    /// Nobody perceives less than whoever acted, and what is imitated is an expert who perceives as much.
    #[test]
    fn no_sequence_perceives_less_than_whoever_acted() {
        for domain in ["highway", "driving", "search_rescue", "bomb_defusal"] {
            let (model, replay) = lived(domain);
            let layout = &model.layout;
            let dropout = Dropout::new(layout, 0.35);
            let mut rng = ChaCha8Rng::seed_from_u64(5);
            let (mut limited, mut peers, mut experts) = (0, 0, 0);
            let mut shard = Shard {
                batch: Batch::new(&model, 1, 1),
                expert: Tensor::new(model.sizes.shape.action, 1),
                imitated: Tensor::new(1, 1),
            };
            for draw in 0..2000 {
                let found = dropout.sequence(draw % 8, &replay, 2, &mut rng);
                let (episode, start) = found.expect("there are sequences");
                let way = dropout.way(&mut rng);
                for t in [0, 1] {
                    let from = start + t;
                    if from >= episode.len() {
                        continue;
                    }
                    let actor = episode.perceived[from];
                    let begins_within = t == 0 && start > 0;
                    let mask = dropout.mask(way, begins_within, actor, &mut rng);
                    assert_eq!(mask & actor, actor, "{domain}: {mask:?} of {actor:?}");
                    assert!(!begins_within || mask & layout.sensed == layout.sensed);
                    limited += u32::from(mask & layout.sensed != layout.sensed);
                    shard.fill(0, t, (episode, start), mask, &model);
                    if shard.imitated.data()[0] == 0.0 {
                        continue;
                    }
                    let imitated = shard.expert.column(0);
                    if mask & layout.sensed == layout.sensed {
                        assert_eq!(imitated, episode.expert(from));
                        experts += 1;
                    } else {
                        assert_eq!((mask, imitated), (actor, episode.peer(from)));
                        peers += 1;
                    }
                }
            }
            assert!(
                limited > 200 && experts > 200,
                "{domain}: {limited}, {experts}"
            );
            let has_peer = ["highway", "search_rescue"].contains(&domain);
            assert_eq!(peers > 100, has_peer, "{domain}: {peers} peers");
        }
    }
}
