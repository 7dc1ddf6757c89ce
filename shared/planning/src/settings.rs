//! Settings of the planners, and what they communicate costs.

use domains::highway::SECTORS;
use domains::highway::modalities::azimuths_shown;
use models::Communicated;
use serde::{Deserialize, Serialize};

/// Settings of the planners. Those of the cross-entropy method are by default the paper's and, where it is silent, those of the
/// authors' scripts, but for the futures that a candidate is valued by.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// The race's own.
    pub race: RaceSettings,
    /// Decisions ahead, of the cross-entropy method.
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
            race: RaceSettings::default(),
            horizon: 4,
            hold: 2,
            samples: 1000,
            futures: 5,
            iterations: 3,
            elites: 40,
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

/// Settings of the race of candidates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RaceSettings {
    /// Control steps that a candidate is imagined for.
    pub steps: usize,
    /// Futures that every candidate lives through.
    pub first: usize,
    /// Futures that the last candidates live through, at most.
    pub futures: usize,
    /// A gain counts from so many standard errors on.
    pub certainty: f32,
    /// In real time, share of a step's length after which a decision stands.
    pub budget: f32,
}

impl Default for RaceSettings {
    fn default() -> Self {
        Self {
            steps: 24,
            first: 8,
            futures: 64,
            certainty: 1.0,
            budget: 0.7,
        }
    }
}

/// Most people in one question.
pub const MOST_ROWS: usize = 512;
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

    /// Decisions that the race looks ahead.
    pub fn race_decisions(&self) -> usize {
        self.race.steps.div_ceil(self.hold)
    }

    /// Most people that one question of any planner is about.
    pub fn most_rows(&self) -> usize {
        MOST_ROWS.max(self.samples / GROUPS)
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
        let RaceSettings {
            steps,
            first,
            futures,
            certainty,
            budget,
        } = self.race;
        if !(1..=64).contains(&steps) {
            return Some(format!("race_steps must be from 1 to 64, not {steps}"));
        }
        if !(2..=512).contains(&first) || !(2..=512).contains(&futures) || first > futures {
            return Some(format!(
                "race_first and race_futures must be from 2 to 512, and race_first ({first}) not above race_futures ({futures})"
            ));
        }
        if !(certainty.is_finite() && certainty >= 0.0) {
            return Some(format!(
                "race_certainty must be finite and not negative, not {certainty}"
            ));
        }
        if !(budget > 0.0 && budget <= 1.0) {
            return Some(format!(
                "budget must be above 0 and at most 1, not {budget}"
            ));
        }
        if self.samples < 2 * GROUPS
            || self.samples > GROUPS * MOST_ROWS
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
