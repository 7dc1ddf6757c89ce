//! Belief matching (`kl`, the paper's MIRROR-KL): no plan and no reward; at every step what is communicated brings the
//! person's belief as near to the robot's as it can be brought (paper §V, "Compared Methods").
//!
//! ```text
//! argmin over ω of  KL[q(z^H_{k+1} | z^H_k, ǎ_k, x̊(ω)) ‖ q(z^R_{k+1} | z^R_k, ǎ_k, x̂)],   x̂ = d(E[z^R_{k+1} | z^R_k, ǎ_k])
//! ```
//!
//! Every version of what can be shown and said is tried: 8 × 7 on the highway, whose display shows three sectors and where one
//! sentence is spoken at a time; 64 in gridworld driving, 128 in bomb defusal, 16,384 in search and rescue. At a tie the
//! one that says less is taken.

use crate::items::{Items, Sectors};
use crate::people::{ImaginedPeople, PeopleError};
use crate::planner::{Decision, From, Plan, Reasons, Settings, mix};
use models::imagined::{Futures, Moment};
use models::{Communicated, Observations, SelfModel, WorldModel};
use nn::Tensor;

/// Versions that are asked about in one question.
const AT_ONCE: usize = 512;

/// The belief-matching planner, over any world model and its items.
pub struct Matcher<M: WorldModel = SelfModel, I: Items = Sectors> {
    settings: Settings,
    items: I,
    /// What could be communicated, least first.
    versions: Vec<Communicated>,
    /// So many of them, the first, say nothing aloud.
    unspoken: usize,
    z: Tensor,
    action: Tensor,
    actions: Tensor,
    still: Vec<f32>,
    mean: Tensor,
    deviation: Tensor,
    imagined: Observations,
    copies: Observations,
    scratch: M::Scratch,
    divergence: Vec<f32>,
    chosen: Communicated,
}

/// All sets of some of `possible`'s bits, at most so many in one, the smallest first.
fn subsets(possible: u32, at_most: u32) -> Vec<u32> {
    let mut sets: Vec<u32> = (0..=possible)
        .filter(|bits| bits & !possible == 0 && bits.count_ones() <= at_most)
        .collect();
    sets.sort_by_key(|bits| (bits.count_ones(), *bits));
    sets
}

impl Matcher {
    /// A planner for the highway. Of `settings` only the costs matter, which are reported and not weighed.
    pub fn new(settings: Settings, model: &SelfModel) -> Self {
        Self::with_items(settings, model, Sectors)
    }

    /// Decides what to communicate on the highway at step k + 1. The result depends on the arguments alone.
    ///
    /// # Errors
    /// As [`Matcher::search`].
    pub fn plan(
        &mut self,
        model: &SelfModel,
        from: From,
        people: &mut dyn ImaginedPeople,
    ) -> Result<Decision, PeopleError> {
        let plan = self.search(model, &from, people)?;
        let probability = core::array::from_fn(|b| self.probability(b));
        Ok(Decision::of(plan, probability))
    }
}

impl<M: WorldModel, I: Items> Matcher<M, I> {
    /// A planner for this world model and these items. Of `settings` only the costs matter, which are reported and not
    /// weighed.
    pub fn with_items(settings: Settings, model: &M, items: I) -> Self {
        let (latent, shape) = (model.latent(), model.shape());
        let possible = items.possible();
        let shows = subsets(possible.visual_bits(), u32::MAX);
        let says = subsets(possible.verbal_bits(), items.spoken_at_once());
        let mut versions: Vec<Communicated> =
            shows.iter().map(|&v| Communicated::new(v, 0)).collect();
        let unspoken = versions.len();
        for &visual in &shows {
            let aloud = says.iter().filter(|verbal| **verbal != 0);
            versions.extend(aloud.map(|&verbal| Communicated::new(visual, verbal)));
        }
        let rows = versions.len().min(AT_ONCE);
        Self {
            settings,
            items,
            unspoken,
            z: Tensor::new(latent, 1),
            action: Tensor::new(shape.action, 1),
            actions: Tensor::new(shape.action, rows),
            still: vec![0.0; latent],
            mean: Tensor::new(latent, 1),
            deviation: Tensor::new(latent, 1),
            imagined: Observations::new(&shape, 1),
            copies: Observations::new(&shape, rows),
            scratch: model.scratch(),
            divergence: vec![0.0; versions.len()],
            chosen: Communicated::default(),
            versions,
        }
    }

    /// Decides what to communicate at step k + 1. The result depends on the arguments alone.
    ///
    /// # Errors
    /// What the people answer; [`PeopleError::Incomparable`] if their beliefs are of another kind than the robot's.
    pub fn search<A: AsRef<[f32]>>(
        &mut self,
        model: &M,
        from: &From<A>,
        people: &mut dyn ImaginedPeople,
    ) -> Result<Plan, PeopleError> {
        match &from.known_action {
            Some(action) => self.action.column_mut(0).copy_from_slice(action.as_ref()),
            None => {
                let place = [from.seed, u64::from(from.episode), u64::from(from.step)];
                people.start(0, 1, Futures::each_their_own(1), mix(&place), None)?;
                people.answer(0, &mut self.action)?;
            }
        }
        // What the robot expects to sense, and to believe once it has.
        self.z.copy_from(from.mean);
        let s = &mut self.scratch;
        model.advance(s, &mut self.z, &self.action, &self.still);
        model.visual(s, &self.z, &mut self.imagined.visual);
        model.verbal(s, &self.z, &mut self.imagined.verbal);
        self.mean.copy_from(from.mean);
        let (mean, deviation) = (&mut self.mean, &mut self.deviation);
        model.believe(s, &self.action, &self.imagined, mean, deviation);

        let count = if from.speech_ready_steps == 0 {
            self.versions.len()
        } else {
            self.unspoken
        };
        for start in (0..count).step_by(AT_ONCE) {
            self.compare(start..(start + AT_ONCE).min(count), people)?;
        }
        let divergence = &self.divergence[..count];
        // The first of equals: versions stand in the order of how much they say.
        let mut best = 0;
        for (i, value) in divergence.iter().enumerate() {
            if *value < divergence[best] {
                best = i;
            }
        }
        self.chosen = self.versions[best];
        Ok(Plan {
            communicated: self.chosen,
            value: -divergence[best],
            value_silent: -divergence[0],
            cost: self.items.cost(&self.settings, self.chosen),
            reasons: Reasons::default(),
        })
    }

    /// Asks how far belief and belief are apart in some of the versions.
    fn compare(
        &mut self,
        versions: core::ops::Range<usize>,
        people: &mut dyn ImaginedPeople,
    ) -> Result<(), PeopleError> {
        let count = versions.len();
        let Observations { visual, verbal } = &self.imagined;
        self.copies.resize(count);
        self.actions.resize_to(self.action.rows(), count);
        for j in 0..count {
            let copies = &mut self.copies;
            copies
                .visual
                .column_mut(j)
                .copy_from_slice(visual.column(0));
            copies
                .verbal
                .column_mut(j)
                .copy_from_slice(verbal.column(0));
            let action = self.action.column(0);
            self.actions.column_mut(j).copy_from_slice(action);
        }
        let moment = Moment {
            action: &self.actions,
            observations: &self.copies,
            communicated: &self.versions[versions.clone()],
            robot_mean: self.mean.column(0),
            robot_deviation: self.deviation.column(0),
        };
        people.compare(moment, &mut self.divergence[versions])
    }

    /// 1 for an item that the last plan shows or says, 0 for others: visual items, then verbal ones.
    pub fn probability(&self, item: usize) -> f32 {
        let is_sent = match item.checked_sub(self.items.visual_items()) {
            None => self.chosen.visual(item),
            Some(utterance) => self.chosen.verbal(utterance),
        };
        f32::from(u8::from(is_sent))
    }
}
