//! Plans what to communicate at the next step: argmax over ω of E[Σ_t γ^t (r(z_t) − C(ω_t))] (paper §III-C, "Planning for
//! communication"), by the cross-entropy method over forward imagination.

use crate::cross_entropy::Population;
use crate::imagination::{Imagination, Stage};
use crate::items::{Items, Sectors};
use crate::people::{ImaginedPeople, PeopleError};
use domains::highway::SECTORS;
use domains::highway::modalities::azimuths_shown;
use models::{Communicated, SelfModel, WorldModel};
use nn::Tensor;
pub use nn::noise::mix;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Settings of the planner; the defaults are the paper's and, where it is silent, those of the authors' scripts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Decisions ahead.
    pub horizon: usize,
    /// Control steps that each decision holds.
    pub hold: usize,
    /// Imagined futures.
    pub samples: usize,
    /// How many of them each candidate for what is communicated has: its value is their mean.
    pub futures: usize,
    /// Iterations of the cross-entropy method.
    pub iterations: usize,
    /// Candidates that the next distribution is fitted to.
    pub elites: usize,
    /// α of the update.
    pub smoothing: f32,
    /// First probability of every bit.
    pub first_probability: f32,
    /// Share of the last plan, shifted by one step, in the first distribution.
    pub warm_start: f32,
    /// γ per control step.
    pub discount: f32,
    /// Weight of the task reward against communication costs.
    pub reward_weight: f32,
    /// Cost of an azimuth that is highlighted.
    pub visual_cost: f32,
    /// Cost of n utterances: this times n³.
    pub verbal_cost: f32,
    /// A visual bit is sent above this probability.
    pub visual_threshold: f32,
    /// A verbal bit is sent above this probability.
    pub verbal_threshold: f32,
    /// Add the critic's value of the last imagined state: dangers that take longer than the horizon count too.
    pub terminal_value: bool,
    /// Futures in which nothing is said, for comparison.
    pub silent: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            horizon: 4,
            hold: 2,
            samples: 1000,
            futures: 1,
            iterations: 3,
            elites: 200,
            smoothing: 0.8,
            first_probability: 0.35,
            warm_start: 0.75,
            discount: 0.9,
            reward_weight: 10.0,
            visual_cost: 0.02,
            verbal_cost: 0.4,
            visual_threshold: 0.15,
            verbal_threshold: 0.3,
            terminal_value: true,
            silent: 20,
        }
    }
}

/// Bits of one decision on the highway: visual sectors, then verbal sectors.
pub const BITS: usize = 2 * SECTORS;
/// Imagined people are asked in this many groups, so that robot and human side work at the same time.
pub const GROUPS: usize = 2;

impl Settings {
    /// C(ω): cost of one decision's bits.
    pub fn cost(&self, communicated: Communicated) -> f32 {
        let azimuths: usize = (0..SECTORS)
            .filter(|&s| communicated.visual(s))
            .map(azimuths_shown)
            .sum();
        let utterances = communicated.verbal_bits().count_ones() as f32;
        self.visual_cost * azimuths as f32 + self.verbal_cost * utterances.powi(3)
    }

    /// Candidates of an iteration.
    pub fn candidates(&self) -> usize {
        self.samples / self.futures
    }

    /// A reason why these settings make no sense, if there is one.
    pub fn problem(&self) -> Option<String> {
        let unit = |x: f32| (0.0..=1.0).contains(&x);
        if self.horizon == 0 || self.hold == 0 || self.iterations == 0 {
            return Some("horizon, hold and iterations must be at least 1".into());
        }
        if self.horizon > 64 || self.hold > 64 || self.iterations > 1000 {
            return Some("horizon and hold may be at most 64, iterations 1000".into());
        }
        if self.samples < 2 * GROUPS
            || self.samples > GROUPS * 512
            || !self.samples.is_multiple_of(GROUPS)
        {
            return Some(format!(
                "samples must be an even number from {} to {}, not {}",
                2 * GROUPS,
                GROUPS * 512,
                self.samples
            ));
        }
        if self.futures == 0 || !self.samples.is_multiple_of(self.futures) {
            return Some(format!(
                "futures must divide samples ({}), not {}",
                self.samples, self.futures
            ));
        }
        if self.elites == 0 || self.elites > self.candidates() {
            return Some(format!(
                "elites must be from 1 to the number of candidates, samples / futures ({}), not {}",
                self.candidates(),
                self.elites
            ));
        }
        if self.silent >= self.samples {
            return Some(format!("silent must be below samples, not {}", self.silent));
        }
        if !unit(self.smoothing)
            || !unit(self.first_probability)
            || !unit(self.warm_start)
            || !unit(self.discount)
            || !unit(self.visual_threshold)
            || !unit(self.verbal_threshold)
        {
            return Some("smoothing, first_probability, warm_start, discount and thresholds must lie in [0, 1]".into());
        }
        if ![self.reward_weight, self.visual_cost, self.verbal_cost]
            .iter()
            .all(|x| x.is_finite() && *x >= 0.0)
        {
            return Some("reward_weight and costs must be finite and not negative".into());
        }
        None
    }
}

/// What was decided for the next step in any domain; [`Planner::probability`] says how clearly.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Plan {
    /// Items to show and to say.
    pub communicated: Communicated,
    /// Mean value of the last iteration's elites.
    pub value: f32,
    /// Mean value of the silent futures of the last iteration.
    pub value_silent: f32,
    /// C(ω) of `communicated`.
    pub cost: f32,
}

/// What was decided for the next step on the highway, and why.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Decision {
    /// Sectors to highlight and to speak about.
    pub communicated: Communicated,
    /// Probability of each bit of the first decision: visual, then verbal.
    pub probability: [f32; BITS],
    /// Mean value of the last iteration's elites.
    pub value: f32,
    /// Mean value of the silent futures of the last iteration.
    pub value_silent: f32,
    /// C(ω) of `communicated`.
    pub cost: f32,
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
        self.forbid(from.speech_ready_steps);
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

    /// Nothing can be said while an utterance is still running, and nothing shown where the display does not reach.
    fn forbid(&mut self, speech_ready_steps: usize) {
        let (visual, bits) = (self.items.visual_items(), self.items.count());
        let possible = self.items.possible();
        for (d, forbidden) in self.population.forbidden.chunks_exact_mut(bits).enumerate() {
            let speaking = d * self.settings.hold < speech_ready_steps;
            for (b, forbidden) in forbidden.iter_mut().enumerate() {
                *forbidden = match b.checked_sub(visual) {
                    None => !possible.visual(b),
                    Some(utterance) => speaking || !possible.verbal(utterance),
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
            group.start(from.mean, from.deviation, seed, known_action, people)?;
        }
        for t in 1..=steps {
            let decision = (t - 1) / hold;
            let speaks = (t - 1) % hold == 0; // an utterance is heard once, a highlight stays
            for (g, group) in self.groups.iter_mut().enumerate() {
                let rows = group.rows();
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
            let rows = group.rows();
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
