//! Plans what to communicate at the next step: argmax over ω of E[Σ_t γ^t (r(z_t) − C(ω_t))] (paper §III-C, "Planning for
//! communication"), by the cross-entropy method over forward imagination.

use crate::cross_entropy::Population;
use crate::imagination::{Imagination, Stage};
use crate::items::{Items, Sectors};
use crate::people::{ImaginedPeople, PeopleError};
pub use crate::settings::{BITS, GROUPS, RaceSettings, Settings};
use models::imagined::Futures;
use models::{Communicated, SelfModel, WorldModel};
use nn::Tensor;
pub use nn::noise::mix;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::time::Instant;

/// Why something is, or is not, communicated now, and how much was imagined for that.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reasons {
    /// What the best way of communicating something now gains over silence, its cost taken off (`race`).
    pub gain_now: f32,
    /// What the best way of waiting with it gains over silence, its cost taken off (`race`).
    pub gain_later: f32,
    /// Standard error of the difference that decided (`race`).
    pub gain_error: f32,
    /// Futures that the decision rests on: those that a candidate is valued by.
    pub futures: u32,
    /// Candidates × futures that were imagined, over all rounds or iterations.
    pub rows: u32,
    /// Rounds of the race, or iterations of the cross-entropy method.
    pub rounds: u32,
}

/// What was decided for the next step in any domain; [`Planner::probability`] says how clearly.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Plan {
    /// Items to show and to say.
    pub communicated: Communicated,
    /// Predicted value: of what is communicated, or of the last iteration's elites.
    pub value: f32,
    /// Predicted value of silence.
    pub value_silent: f32,
    /// C(ω) of `communicated`.
    pub cost: f32,
    /// Why.
    pub reasons: Reasons,
}

/// What was decided for the next step on the highway, and why.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Decision {
    /// Sectors to highlight and to speak about.
    pub communicated: Communicated,
    /// Probability of each bit of the first decision: visual, then verbal.
    pub probability: [f32; BITS],
    /// Predicted value: of what is communicated, or of the last iteration's elites.
    pub value: f32,
    /// Predicted value of silence.
    pub value_silent: f32,
    /// C(ω) of `communicated`.
    pub cost: f32,
    /// Why.
    pub reasons: Reasons,
}

impl Decision {
    /// A plan for the highway.
    pub(crate) fn of(plan: Plan, probability: [f32; BITS]) -> Self {
        Self {
            communicated: plan.communicated,
            probability,
            value: plan.value,
            value_silent: plan.value_silent,
            cost: plan.cost,
            reasons: plan.reasons,
        }
    }
}

/// Where a plan starts; `A` is how a known action is given.
#[derive(Clone, Copy)]
pub struct From<'a, A = [f32; 2]> {
    /// Mean of z^R_k, `latent × 1`.
    pub mean: &'a Tensor,
    /// Deviation of z^R_k.
    pub deviation: &'a Tensor,
    /// What the person does at step k, where that is known.
    pub known_action: Option<A>,
    /// Control steps until the next utterance may start, seen from step k + 1.
    pub speech_ready_steps: usize,
    /// Seed of the run.
    pub seed: u64,
    /// Episode.
    pub episode: u32,
    /// Step k.
    pub step: u32,
    /// When the decision has to stand; none where everybody waits for it. Only the race minds it.
    pub until: Option<Instant>,
}

impl<'a, A> From<'a, A> {
    /// The same start with another known action.
    pub fn knowing<B>(self, known_action: Option<B>) -> From<'a, B> {
        let Self {
            mean,
            deviation,
            speech_ready_steps,
            seed,
            episode,
            step,
            until,
            ..
        } = self;
        From {
            mean,
            deviation,
            known_action,
            speech_ready_steps,
            seed,
            episode,
            step,
            until,
        }
    }
}

/// The cross-entropy planner (`--planner ce`) over any world model and its items.
pub struct Planner<M: WorldModel = SelfModel, I: Items = Sectors> {
    /// Settings.
    pub settings: Settings,
    items: I,
    population: Population,
    groups: Vec<Imagination<M>>,
    communicated: Vec<Communicated>,
    values: Vec<f32>,
    means: Vec<f32>,
    previous: Vec<f32>,
    planned: Option<(u32, u32)>,
    /// What the robot believes to see.
    seen: Tensor,
    scratch: M::Scratch,
}

impl Planner {
    /// A planner for the highway's self-model. Settings must have no [`Settings::problem`].
    pub fn new(settings: Settings, model: &SelfModel) -> Self {
        Self::with_items(settings, model, Sectors)
    }

    /// Decides what to communicate at step k + 1. The result depends on the arguments and on the last plan alone.
    pub fn plan(
        &mut self,
        model: &SelfModel,
        from: From,
        people: &mut dyn ImaginedPeople,
    ) -> Result<Decision, PeopleError> {
        let plan = self.search(model, &from, people)?;
        let mut probability = [0.0; BITS];
        for (b, probability) in probability.iter_mut().enumerate() {
            *probability = self.probability(b);
        }
        Ok(Decision::of(plan, probability))
    }
}

impl<M: WorldModel, I: Items> Planner<M, I> {
    /// A planner for this world model and these items. Settings must have no [`Settings::problem`].
    pub fn with_items(settings: Settings, model: &M, items: I) -> Self {
        let rows = settings.samples / GROUPS;
        let (bits, hears) = (settings.horizon * items.count(), items.hears());
        let (mut seen, mut scratch) = (Tensor::new(model.shape().visual, 1), model.scratch());
        // Makes the memory that decoding the robot's belief takes.
        model.visual(&mut scratch, &Tensor::new(model.latent(), 1), &mut seen);
        Self {
            settings,
            items,
            population: Population::new(settings.candidates(), bits),
            groups: (0..GROUPS)
                .map(|group| Imagination::new(model, group, rows, hears))
                .collect(),
            communicated: vec![Communicated::default(); rows],
            values: vec![0.0; settings.samples],
            means: vec![0.0; settings.candidates()],
            previous: vec![settings.first_probability; bits],
            planned: None,
            seen,
            scratch,
        }
    }

    /// Decides what to communicate at step k + 1. The result depends on the arguments and on the last plan alone.
    pub fn search<A: AsRef<[f32]>>(
        &mut self,
        model: &M,
        from: &From<A>,
        people: &mut dyn ImaginedPeople,
    ) -> Result<Plan, PeopleError> {
        self.warm_start(self.planned == Some((from.episode, from.step.wrapping_sub(1))));
        model.visual(&mut self.scratch, from.mean, &mut self.seen);
        let held = self.items.held(self.seen.column(0));
        self.forbid(held, from.speech_ready_steps);
        let mut value = 0.0;
        for iteration in 0..self.settings.iterations {
            let seed = mix(&[
                from.seed,
                u64::from(from.episode),
                u64::from(from.step),
                iteration as u64,
            ]);
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let silent = self.settings.silent / self.settings.futures;
            self.population.draw(&mut rng, silent);
            self.imagine(model, from, seed, people)?;
            self.average();
            self.subtract_costs();
            let Settings {
                elites, smoothing, ..
            } = self.settings;
            value = self.population.update(&self.means, elites, smoothing);
        }
        self.previous.copy_from_slice(&self.population.probability);
        self.planned = Some((from.episode, from.step));
        Ok(self.decide(value))
    }

    /// p ← w · (last plan, one control step on) + (1 − w) · first probability.
    fn warm_start(&mut self, follows: bool) {
        let Settings {
            horizon,
            hold,
            first_probability,
            warm_start,
            ..
        } = self.settings;
        let bits = self.items.count();
        for d in 0..horizon {
            for b in 0..bits {
                let i = d * bits + b;
                self.population.probability[i] = if follows {
                    // A decision holds `hold` control steps: one step on, it covers hold − 1 of its own and one of the next.
                    let own = self.previous[i];
                    let next = self
                        .previous
                        .get(i + bits)
                        .copied()
                        .unwrap_or(first_probability);
                    let shifted = own + (next - own) / hold as f32;
                    warm_start * shifted + (1.0 - warm_start) * first_probability
                } else {
                    first_probability
                };
            }
        }
    }

    /// Nothing can be said while an utterance is still running, nothing shown where the display does not reach, and nothing of
    /// either kind is communicated of what the robot does not believe to be there.
    fn forbid(&mut self, held: Communicated, speech_ready_steps: usize) {
        let (visual, bits) = (self.items.visual_items(), self.items.count());
        let possible = self.items.possible();
        for (d, forbidden) in self.population.forbidden.chunks_exact_mut(bits).enumerate() {
            let speaking = d * self.settings.hold < speech_ready_steps;
            for (b, forbidden) in forbidden.iter_mut().enumerate() {
                *forbidden = match b.checked_sub(visual) {
                    None => !(possible.visual(b) && held.visual(b)),
                    Some(utterance) => {
                        speaking || !(possible.verbal(utterance) && held.verbal(utterance))
                    }
                };
            }
        }
    }

    /// Runs every sample's future and leaves its discounted reward in `values`.
    fn imagine<A: AsRef<[f32]>>(
        &mut self,
        model: &M,
        from: &From<A>,
        seed: u64,
        people: &mut dyn ImaginedPeople,
    ) -> Result<(), PeopleError> {
        let Settings {
            futures,
            horizon,
            hold,
            discount,
            reward_weight,
            terminal_value,
            ..
        } = self.settings;
        let steps = horizon * hold;
        let (visual, count) = (self.items.visual_items(), self.items.count());
        for (g, group) in self.groups.iter_mut().enumerate() {
            let seed = mix(&[seed, g as u64]);
            let known_action = from.known_action.as_ref().map(AsRef::as_ref);
            let rows = group.most_rows();
            let futures = Futures::each_their_own(rows);
            let belief = [from.mean, from.deviation];
            group.start(belief, rows, futures, seed, known_action, people)?;
        }
        for t in 1..=steps {
            let decision = (t - 1) / hold;
            let speaks = (t - 1) % hold == 0; // an utterance is heard once, a highlight stays
            for (g, group) in self.groups.iter_mut().enumerate() {
                let rows = group.most_rows();
                for (j, bits) in self.communicated.iter_mut().enumerate() {
                    let candidate = (g * rows + j) / futures;
                    let sample = &self.population.candidate(candidate)
                        [decision * count..(decision + 1) * count];
                    *bits = communicated(sample, visual, speaks);
                }
                let stage = Stage {
                    discount: discount.powi(t as i32 - 1),
                    reward_weight,
                    seed: mix(&[seed, g as u64, t as u64]),
                };
                let last = t == steps && !terminal_value;
                group.step(model, stage, &self.communicated, last, people)?;
            }
        }
        for (g, group) in self.groups.iter_mut().enumerate() {
            if terminal_value {
                let stage = Stage {
                    discount: discount.powi(steps as i32),
                    reward_weight,
                    seed: 0,
                };
                group.finish(model, stage, people)?;
            }
            let rows = group.most_rows();
            self.values[g * rows..(g + 1) * rows].copy_from_slice(&group.returns);
        }
        Ok(())
    }

    /// E[Σ_t γ^t r]: the mean over a candidate's futures.
    fn average(&mut self) {
        let futures = self.settings.futures;
        for (mean, values) in self.means.iter_mut().zip(self.values.chunks_exact(futures)) {
            *mean = values.iter().sum::<f32>() / futures as f32;
        }
    }

    /// Each decision costs once, discounted to its first step.
    fn subtract_costs(&mut self) {
        let Settings {
            horizon,
            hold,
            discount,
            ..
        } = self.settings;
        let (visual, count) = (self.items.visual_items(), self.items.count());
        for (i, value) in self.means.iter_mut().enumerate() {
            let bits = self.population.candidate(i);
            for d in 0..horizon {
                let decision = &bits[d * count..(d + 1) * count];
                let told = communicated(decision, visual, true);
                let cost = self.items.cost(&self.settings, told);
                *value -= discount.powi((d * hold) as i32) * cost;
            }
        }
    }

    /// Probability of a bit of the last plan's first decision: visual items, then verbal ones.
    pub fn probability(&self, bit: usize) -> f32 {
        if self.population.forbidden[bit] {
            0.0
        } else {
            self.population.probability[bit]
        }
    }

    fn decide(&self, value: f32) -> Plan {
        let Settings {
            visual_threshold,
            verbal_threshold,
            silent,
            futures,
            ..
        } = self.settings;
        let silent = silent / futures;
        let (mut visual, mut verbal) = (0, 0);
        let shown = self.items.visual_items();
        for b in 0..self.items.count() {
            let p = self.probability(b);
            if b < shown && p > visual_threshold {
                visual |= 1 << b;
            } else if b >= shown && p > verbal_threshold {
                verbal |= 1 << (b - shown);
            }
        }
        let communicated = Communicated::new(visual, verbal);
        Plan {
            communicated,
            value,
            value_silent: self.means[..silent].iter().sum::<f32>() / silent.max(1) as f32,
            cost: self.items.cost(&self.settings, communicated),
            reasons: Reasons {
                futures: self.settings.futures as u32,
                rows: (self.settings.samples * self.settings.iterations) as u32,
                rounds: self.settings.iterations as u32,
                ..Reasons::default()
            },
        }
    }
}

/// The bits of one decision, visual items first, as what is communicated.
fn communicated(bits: &[bool], visual: usize, speaks: bool) -> Communicated {
    let pack = |bits: &[bool]| {
        bits.iter()
            .enumerate()
            .fold(0, |packed, (i, &bit)| packed | u32::from(bit) << i)
    };
    let verbal = if speaks { pack(&bits[visual..]) } else { 0 };
    Communicated::new(pack(&bits[..visual]), verbal)
}
