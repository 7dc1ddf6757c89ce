//! The race in imagination: candidates live through futures of the robot's world model and of imagined people.

use crate::candidates::Candidate;
use crate::imagination::{Imagination, Stage};
use crate::items::{Items, Sectors};
use crate::people::{ImaginedPeople, PeopleError};
use crate::planner::{From, Plan, mix};
use crate::race::{Race, Round, Simulation, Start};
use crate::settings::{GROUPS, MOST_ROWS, Settings};
use models::imagined::Futures;
use models::{Communicated, SelfModel, WorldModel};
use nn::Tensor;
use std::time::Instant;

/// Nanoseconds that a step of one candidate in one future takes, until that is known.
const FIRST_PACE_NS: f64 = 15_000.0;
/// Share of the newest measurement in the pace.
const NEWEST: f64 = 0.2;

/// The planner that races candidates (`--planner race`), over any world model and its items.
pub struct RacePlanner<M: WorldModel = SelfModel, I: Items = Sectors> {
    settings: Settings,
    race: Race<I>,
    groups: Vec<Imagination<M>>,
    communicated: Vec<Communicated>,
    /// What the robot believes to see.
    seen: Tensor,
    scratch: M::Scratch,
    pace_ns: f64,
}

impl<M: WorldModel, I: Items> RacePlanner<M, I> {
    /// A planner for this world model and these items. Settings must have no [`Settings::problem`].
    pub fn with_items(settings: Settings, model: &M, items: I) -> Self {
        let hears = items.hears();
        let group = |group| {
            let mut group = Imagination::new(model, group, MOST_ROWS, hears);
            group.warm(model);
            group
        };
        let (mut seen, mut scratch) = (Tensor::new(model.shape().visual, 1), model.scratch());
        // Makes the memory that decoding the robot's belief takes.
        model.visual(&mut scratch, &Tensor::new(model.latent(), 1), &mut seen);
        Self {
            settings,
            race: Race::new(settings, items),
            groups: (0..GROUPS).map(group).collect(),
            communicated: Vec::with_capacity(MOST_ROWS),
            seen,
            scratch,
            pace_ns: FIRST_PACE_NS,
        }
    }

    /// Decides what to communicate at step k + 1. Without [`From::until`] the result depends on the other arguments alone.
    ///
    /// # Errors
    /// What the people answer.
    pub fn search<A: AsRef<[f32]>>(
        &mut self,
        model: &M,
        from: &From<A>,
        people: &mut dyn ImaginedPeople,
    ) -> Result<Plan, PeopleError> {
        model.visual(&mut self.scratch, from.mean, &mut self.seen);
        let start = Start {
            held: self.race.items().held(self.seen.column(0)),
            speech_ready_steps: from.speech_ready_steps,
            seed: mix(&[from.seed, u64::from(from.episode), u64::from(from.step)]),
        };
        let mut imagined = Imagined {
            settings: &self.settings,
            visual: self.race.items().visual_items(),
            groups: &mut self.groups,
            communicated: &mut self.communicated,
            model,
            from,
            people,
            pace_ns: &mut self.pace_ns,
        };
        self.race.decide(&mut imagined, start)
    }

    /// 1 for an item that the last plan shows or says now, 0 for others: visual items, then verbal ones.
    pub fn probability(&self, item: usize) -> f32 {
        f32::from(u8::from(self.race.chosen().decision(item) == Some(0)))
    }
}

/// The imagined world, and the people in it, during one plan.
struct Imagined<'a, M: WorldModel, A> {
    settings: &'a Settings,
    visual: usize,
    groups: &'a mut [Imagination<M>],
    communicated: &'a mut Vec<Communicated>,
    model: &'a M,
    from: &'a From<'a, A>,
    people: &'a mut dyn ImaginedPeople,
    pace_ns: &'a mut f64,
}

impl<M: WorldModel, A: AsRef<[f32]>> Imagined<'_, M, A> {
    fn is_late(&self) -> bool {
        self.from.until.is_some_and(|until| Instant::now() >= until)
    }
}

impl<M: WorldModel, A: AsRef<[f32]>> Simulation for Imagined<'_, M, A> {
    fn live(
        &mut self,
        candidates: &[Candidate],
        round: Round,
        values: &mut [f32],
    ) -> Result<bool, PeopleError> {
        let Settings {
            hold,
            discount,
            reward_weight,
            race,
            ..
        } = *self.settings;
        let began = self.from.until.map(|_| Instant::now());
        let count = round.count / GROUPS;
        // Who has not begun yet is silence, and need not be imagined beside it.
        let begun_by = |decision: usize| {
            let begun = |candidate: &Candidate| candidate.begins().is_none_or(|at| at <= decision);
            candidates.partition_point(begun)
        };
        let known_action = self.from.known_action.as_ref().map(AsRef::as_ref);
        for (g, group) in self.groups.iter_mut().enumerate() {
            let futures = Futures {
                first: round.first + g * count,
                count,
            };
            let belief = [self.from.mean, self.from.deviation];
            let (rows, seed) = (begun_by(0) * count, mix(&[round.seed, g as u64]));
            group.start(belief, rows, futures, seed, known_action, self.people)?;
        }
        let mut steps = 0;
        for t in 1..=race.steps {
            if self.is_late() {
                for group in self.groups.iter_mut() {
                    group.drain(self.people)?;
                }
                return Ok(false);
            }
            let decision = (t - 1) / hold;
            let speaks = (t - 1) % hold == 0; // an utterance is heard once, a highlight stays
            let begun = begun_by(decision);
            steps += begun * round.count;
            self.communicated.clear();
            for candidate in &candidates[..begun] {
                let told = candidate.told(decision, self.visual);
                let told = match speaks {
                    true => told,
                    false => Communicated::new(told.visual_bits(), 0),
                };
                self.communicated.extend((0..count).map(|_| told));
            }
            for (g, group) in self.groups.iter_mut().enumerate() {
                let stage = Stage {
                    discount: discount.powi(t as i32 - 1),
                    reward_weight,
                    seed: mix(&[round.seed, g as u64, t as u64]),
                };
                let last = t == race.steps;
                group.step(self.model, stage, self.communicated, last, self.people)?;
            }
        }
        for (c, values) in values.chunks_exact_mut(round.count).enumerate() {
            for (group, values) in self.groups.iter().zip(values.chunks_exact_mut(count)) {
                values.copy_from_slice(&group.returns[c * count..(c + 1) * count]);
            }
        }
        if let Some(began) = began {
            let pace = began.elapsed().as_nanos() as f64 / steps.max(1) as f64;
            *self.pace_ns += NEWEST * (pace - *self.pace_ns);
        }
        Ok(true)
    }

    fn most_rows(&self) -> usize {
        GROUPS * MOST_ROWS
    }

    fn steps_left(&self) -> Option<f64> {
        let until = self.from.until?;
        let left = until.saturating_duration_since(Instant::now());
        Some(left.as_nanos() as f64 / *self.pace_ns)
    }
}
