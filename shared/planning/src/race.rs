//! The race of candidates (`--planner race`): what to communicate now, if anything, decided on what it is better than.
//!
//! Silence, every item now and every item later live through the same futures: the same particle of the person, the same
//! chance in world and person. What two of them gain over each other, future by future, is then what the words did:
//!
//! ```text
//! d_f = Σ_t γ^t (r(z^a_{t,f}) − C(ω^a_t)) − Σ_t γ^t (r(z^b_{t,f}) − C(ω^b_t))
//! gain of a over b: mean of d_f, give or take its standard error √(Σ (d_f − mean)² / (n (n − 1)))
//! ```
//!
//! First every item is tried now. Where one may help, it races what could be communicated later, because a sentence blocks
//! the channel while it is spoken, and what is told too early is old when it matters. The weaker half drops out after every
//! round, the others live through as many futures again (successive halving), silence and the best of either kind always
//! among them. The race ends early where more futures would not change the decision. What then gains something over silence and
//! over waiting, by more than its standard error, is communicated; other items that help are added one by one, as long as each
//! gains something over what there is already, and over following it a decision later.

use crate::candidates::{Candidate, moments};
use crate::items::Items;
use crate::people::PeopleError;
use crate::planner::{Plan, Reasons, mix};
use crate::settings::{GROUPS, MOST_ROWS, Settings};
use models::Communicated;

/// More certainty than for a decision is asked for before the race ends early: so many times as many standard errors.
const EARLY: f64 = 2.0;
/// Share of the time left that the first round may take.
const FIRST_SHARE: f64 = 0.3;
/// Candidates that are not halved any further.
const FEWEST: usize = 2;

/// Futures of one round.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Round {
    /// Seed of all chance in them.
    pub seed: u64,
    /// Number of the first, counted over the rounds of a plan.
    pub first: usize,
    /// How many.
    pub count: usize,
}

/// A world with a person in it in which candidates live through futures: an imagined one, or, for an oracle, the true one.
pub trait Simulation {
    /// `values[c · count + f]` ← Σ_t γ^t · w · r of candidate c in future f, costs left out. The first candidate is silence, the
    /// others stand in the order in which they begin. False if there was no time for it; then `values` mean nothing.
    ///
    /// # Errors
    /// What the people answer.
    fn live(
        &mut self,
        candidates: &[Candidate],
        round: Round,
        values: &mut [f32],
    ) -> Result<bool, PeopleError>;

    /// Candidates × futures that may live through one round at once.
    fn most_rows(&self) -> usize;

    /// Steps of one candidate in one future for which there is time left; none where time is no matter.
    fn steps_left(&self) -> Option<f64> {
        None
    }
}

/// Where a race starts.
#[derive(Clone, Copy, Debug)]
pub struct Start {
    /// What the robot believes to be there: [`Items::held`].
    pub held: Communicated,
    /// Control steps until the next utterance may start, seen from the step that is decided for.
    pub speech_ready_steps: usize,
    /// Seed of this plan.
    pub seed: u64,
}

/// What a candidate gains over another.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gain {
    /// Mean over the futures that both lived through, costs taken off.
    pub mean: f64,
    /// Its standard error.
    pub error: f64,
}

impl Gain {
    /// Whether it is beyond so many standard errors.
    fn is_certain(self, errors: f64) -> bool {
        self.mean > errors * self.error
    }

    /// Whether it could still be above 0.
    fn is_possible(self, errors: f64) -> bool {
        self.mean + errors * self.error > 0.0
    }
}

/// A candidate in the race.
#[derive(Clone, Copy, Debug)]
struct Runner {
    candidate: Candidate,
    cost: f64,
    /// Futures lived through, from the first on.
    futures: usize,
    is_in: bool,
}

/// Silence is the first runner.
const SILENCE: usize = 0;

/// The race. Allocates nothing after its first plans.
pub struct Race<I: Items> {
    settings: Settings,
    items: I,
    runners: Vec<Runner>,
    /// By runner, a place for each future.
    values: Vec<f32>,
    /// Where the rounds begin.
    rounds: Vec<Round>,
    /// Runners that live through a round next.
    next: Vec<usize>,
    batch: Vec<Candidate>,
    batch_values: Vec<f32>,
    /// Items that may help now, with the gain of the first round.
    helpful: Vec<usize>,
    lived: u32,
    chosen: Candidate,
}

impl<I: Items> Race<I> {
    /// A race between what can be said of `items`.
    pub fn new(settings: Settings, items: I) -> Self {
        // Silence, each item at each moment, and twice each item in a combination, of which one stays.
        let most = (items.count() + 1) * (moments(settings.race_decisions()).count() + 4);
        Self {
            runners: Vec::with_capacity(most),
            values: Vec::with_capacity(most * settings.race.futures),
            rounds: Vec::with_capacity(32),
            next: Vec::with_capacity(most),
            batch: Vec::with_capacity(most),
            batch_values: Vec::with_capacity(GROUPS * MOST_ROWS),
            helpful: Vec::with_capacity(items.count()),
            lived: 0,
            chosen: Candidate::SILENCE,
            settings,
            items,
        }
    }

    /// The items.
    pub fn items(&self) -> &I {
        &self.items
    }

    /// What the last plan communicates, now and later.
    pub fn chosen(&self) -> Candidate {
        self.chosen
    }

    /// Decides what to communicate now. The result depends on the arguments alone, and on time where `simulation` minds it.
    ///
    /// # Errors
    /// What the people answer.
    pub fn decide(
        &mut self,
        simulation: &mut dyn Simulation,
        start: Start,
    ) -> Result<Plan, PeopleError> {
        self.runners.clear();
        self.values.clear();
        self.rounds.clear();
        self.helpful.clear();
        (self.lived, self.chosen) = (0, Candidate::SILENCE);
        self.enter(Candidate::SILENCE);
        let (visual, possible) = (self.items.visual_items(), self.items.possible());
        for item in 0..self.items.count() {
            let is_possible = match item.checked_sub(visual) {
                // What is not there cannot be shown; that it is not there can be said.
                None => possible.visual(item) && start.held.visual(item),
                Some(utterance) => start.speech_ready_steps == 0 && possible.verbal(utterance),
            };
            if is_possible {
                self.enter(Candidate::SILENCE.with(item, 0));
            }
        }
        if self.runners.len() == 1 {
            return Ok(Plan::default());
        }
        self.schedule(simulation, start.seed);
        if !self.live_first_round(simulation)? {
            return Ok(Plan::default());
        }
        if self.helpful.is_empty() {
            let best = self.best(|runner| runner.candidate.begins_now());
            return Ok(self.plan(best, None));
        }
        let weighed = self.enter_later(simulation, start)?;
        self.halve(simulation)?;
        self.choose(weighed);
        let best = self.best(|runner| runner.is_in && runner.candidate.begins_now());
        let later = self.best(|runner| runner.is_in && is_later(&runner.candidate));
        let plan = self.plan(best, later);
        self.combine(simulation)?;
        let communicated = self.chosen.told(0, visual);
        Ok(Plan {
            communicated,
            value: self.value_of(self.chosen),
            cost: self.items.cost(&self.settings, communicated),
            reasons: Reasons {
                rows: self.lived,
                ..plan.reasons
            },
            ..plan
        })
    }

    /// A new candidate, at the end.
    fn enter(&mut self, candidate: Candidate) -> usize {
        let cost = f64::from(candidate.cost(&self.settings, &self.items));
        self.runners.push(Runner {
            candidate,
            cost,
            futures: 0,
            is_in: true,
        });
        let stride = self.settings.race.futures;
        self.values.resize(self.runners.len() * stride, 0.0);
        self.runners.len() - 1
    }

    /// How many futures each round has: as many again as there were before. Where time is short the first has fewer.
    fn schedule(&mut self, simulation: &dyn Simulation, seed: u64) {
        let race = self.settings.race;
        let mut first = race.first;
        if let Some(left) = simulation.steps_left() {
            let each = (self.runners.len() * race.steps) as f64;
            first = first.min((FIRST_SHARE * left / each) as usize);
        }
        let most = simulation.most_rows();
        let fitting = most / self.runners.len();
        let first = even(first.min(fitting)).max(2);
        let (mut begin, mut count) = (0, first);
        while begin + count <= race.futures && self.rounds.len() < self.rounds.capacity() {
            self.rounds.push(Round {
                seed: mix(&[seed, self.rounds.len() as u64]),
                first: begin,
                count,
            });
            begin += count;
            count = even(begin.min(most / (FEWEST + 1)));
        }
    }

    /// Every item now; notes which of them may help.
    fn live_first_round(&mut self, simulation: &mut dyn Simulation) -> Result<bool, PeopleError> {
        self.next.clear();
        self.next.extend(1..self.runners.len());
        if !self.live(simulation, 0)? {
            return Ok(false);
        }
        let certainty = self.certainty();
        for i in 1..self.runners.len() {
            let gain = self.gain(i, SILENCE);
            self.runners[i].is_in = gain.is_possible(certainty);
            if self.runners[i].is_in {
                let item = (0..self.items.count())
                    .find(|&item| self.runners[i].candidate.decision(item).is_some());
                self.helpful.extend(item);
            }
        }
        Ok(true)
    }

    /// What could be communicated later in place of what may help now; false if there is no time to weigh it.
    fn enter_later(
        &mut self,
        simulation: &mut dyn Simulation,
        start: Start,
    ) -> Result<bool, PeopleError> {
        let (visual, hold) = (self.items.visual_items(), self.settings.hold);
        let begin = self.runners.len();
        let decisions = self.settings.race_decisions();
        let blocks =
            self.items.spoken_at_once() == 1 && self.helpful.iter().any(|item| *item >= visual);
        for decision in moments(decisions).skip(1) {
            for item in 0..self.items.count() {
                let utterance = item.checked_sub(visual);
                // What is spoken later needs a free channel, which a sentence now would have taken.
                let competes =
                    utterance.is_some_and(|utterance| blocks && start.held.verbal(utterance));
                let is_ready = utterance.is_none() || decision * hold >= start.speech_ready_steps;
                if is_ready && (competes || self.helpful.contains(&item)) {
                    self.enter(Candidate::SILENCE.with(item, decision));
                }
            }
        }
        if let Some(left) = simulation.steps_left() {
            // What lies farthest ahead is left out first: it stands at the end.
            let each = self.rounds[0].count as f64;
            let mut room = 0.5 * left / each - self.settings.race.steps as f64;
            let mut fitting = begin;
            while fitting < self.runners.len() {
                room -= self.steps_of(fitting) as f64;
                if room < 0.0 {
                    break;
                }
                fitting += 1;
            }
            self.runners.truncate(fitting);
        }
        if self.runners.len() == begin {
            return Ok(decisions == 1);
        }
        self.next.clear();
        self.next.extend(begin..self.runners.len());
        let lived = self.live(simulation, 0)?;
        if !lived {
            self.runners.truncate(begin);
        }
        Ok(lived)
    }

    /// Steps that a runner is imagined for on its own: until it begins, it is silence.
    fn steps_of(&self, i: usize) -> usize {
        let begins = self.runners[i].candidate.begins().unwrap_or(0);
        (self.settings.race.steps).saturating_sub(begins * self.settings.hold)
    }

    /// Lets the weaker half drop out, and the others live through further futures.
    fn halve(&mut self, simulation: &mut dyn Simulation) -> Result<(), PeopleError> {
        for round in 1..self.rounds.len() {
            self.drop_out();
            if self.is_decided() {
                return Ok(());
            }
            self.next.clear();
            for i in 1..self.runners.len() {
                if self.runners[i].is_in {
                    self.next.push(i);
                }
            }
            if let Some(left) = simulation.steps_left() {
                let steps: usize = self.next.iter().map(|&i| self.steps_of(i)).sum();
                let needed = (steps + self.settings.race.steps) * self.rounds[round].count;
                if needed as f64 > left {
                    return Ok(());
                }
            }
            if !self.live(simulation, round)? {
                return Ok(());
            }
        }
        Ok(())
    }

    /// Half of the runners leave, those of the least gain. Silence and the best of those who tell something now, and of those
    /// who wait, stay.
    fn drop_out(&mut self) {
        let in_race = |runner: &Runner| runner.is_in;
        let best = self.best(|runner| in_race(runner) && runner.candidate.begins_now());
        let later = self.best(|runner| in_race(runner) && is_later(&runner.candidate));
        let mut order = core::mem::take(&mut self.next);
        order.clear();
        order.extend((1..self.runners.len()).filter(|&i| self.runners[i].is_in));
        // Equal gains are settled by the order of entry, so that the result depends on nothing but the values.
        order.sort_unstable_by(|&a, &b| {
            let (gain_a, gain_b) = (self.gain(a, SILENCE).mean, self.gain(b, SILENCE).mean);
            gain_b.total_cmp(&gain_a).then(a.cmp(&b))
        });
        let kept = order.len().div_ceil(2).max(FEWEST);
        for &i in order.iter().skip(kept) {
            if Some(i) != best && Some(i) != later {
                self.runners[i].is_in = false;
            }
        }
        self.next = order;
    }

    /// Whether more futures would not change what is done now.
    fn is_decided(&self) -> bool {
        let errors = EARLY * self.certainty();
        let later = self.best(|runner| runner.is_in && is_later(&runner.candidate));
        let beats = |i: usize, test: fn(Gain, f64) -> bool| {
            test(self.gain(i, SILENCE), errors)
                && later.is_none_or(|later| test(self.gain(i, later), errors))
        };
        let mut now = (1..self.runners.len())
            .filter(|&i| self.runners[i].is_in && self.runners[i].candidate.begins_now());
        let Some(best) = self.best(|runner| runner.is_in && runner.candidate.begins_now()) else {
            return true;
        };
        beats(best, Gain::is_certain) || !now.any(|i| beats(i, Gain::is_possible))
    }

    /// What gains something over silence and over waiting is communicated now; otherwise what waiting for gains something. Where
    /// there was no time to weigh waiting (`weighed` is false), only what blocks nothing is communicated.
    fn choose(&mut self, weighed: bool) {
        let certainty = self.certainty();
        let verbal = self.items.visual_items()..self.items.count();
        let now = self.best(|runner| {
            let says = runner.candidate.has_any(verbal.clone());
            runner.is_in && runner.candidate.begins_now() && (weighed || !says)
        });
        let later = self.best(|runner| runner.is_in && is_later(&runner.candidate));
        let gains = |i: usize, over: usize| self.gain(i, over).is_certain(certainty);
        let now = now.filter(|&now| gains(now, SILENCE));
        let now = now.filter(|&now| later.is_none_or(|later| gains(now, later)));
        let later = later.filter(|&later| gains(later, SILENCE));
        let best = now.or(later).unwrap_or(SILENCE);
        self.chosen = self.runners[best].candidate;
    }

    /// Adds other items that help, one by one.
    fn combine(&mut self, simulation: &mut dyn Simulation) -> Result<(), PeopleError> {
        let (visual, count) = (self.items.visual_items(), self.items.count());
        let certainty = self.certainty();
        let waits = self.settings.race_decisions() > 1;
        while !self.chosen.is_silent() {
            let Some(base) = self.find(self.chosen) else {
                return Ok(());
            };
            let says = self.chosen.has_any(visual..count);
            let is_full = says && self.items.spoken_at_once() == 1;
            let begin = self.runners.len();
            for at in 0..self.helpful.len() {
                let item = self.helpful[at];
                let is_free = self.chosen.decision(item).is_none();
                if is_free && !(item >= visual && is_full) {
                    self.enter(self.chosen.with(item, 0));
                    if waits {
                        self.enter(self.chosen.with(item, 1));
                    }
                }
            }
            if self.runners.len() == begin {
                return Ok(());
            }
            let futures = self.runners[base].futures;
            for round in 0..self.rounds.len() {
                if self.rounds[round].first >= futures {
                    break;
                }
                self.next.clear();
                self.next.extend(begin..self.runners.len());
                if let Some(left) = simulation.steps_left() {
                    let rows = (self.next.len() + 1) * self.rounds[round].count;
                    if (rows * self.settings.race.steps) as f64 > left {
                        return Ok(());
                    }
                }
                if !self.live(simulation, round)? {
                    return Ok(());
                }
            }
            let step = if waits { 2 } else { 1 };
            let mut best: Option<(f64, usize)> = None;
            for i in (begin..self.runners.len()).step_by(step) {
                let gain = self.gain(i, base);
                let beats = gain.is_certain(certainty)
                    && (!waits || self.gain(i, i + 1).is_certain(certainty));
                if beats && best.is_none_or(|(most, _)| gain.mean > most) {
                    best = Some((gain.mean, i));
                }
            }
            let Some((_, best)) = best else {
                return Ok(());
            };
            self.chosen = self.runners[best].candidate;
            // The others are forgotten.
            let stride = self.settings.race.futures;
            self.runners[begin] = self.runners[best];
            self.values
                .copy_within(best * stride..(best + 1) * stride, begin * stride);
            self.runners.truncate(begin + 1);
        }
        Ok(())
    }

    /// Lets the runners in `next` live through a round, and silence too where it has not; false if there was no time.
    fn live(&mut self, simulation: &mut dyn Simulation, round: usize) -> Result<bool, PeopleError> {
        let round = self.rounds[round];
        let stride = self.settings.race.futures;
        let mut next = core::mem::take(&mut self.next);
        next.sort_unstable_by_key(|&i| (self.runners[i].candidate.begins(), i));
        let at_once = (simulation.most_rows() / round.count)
            .saturating_sub(1)
            .max(1);
        let mut in_time = true;
        for part in next.chunks(at_once) {
            self.batch.clear();
            self.batch.push(Candidate::SILENCE);
            let candidates = part.iter().map(|&i| self.runners[i].candidate);
            self.batch.extend(candidates);
            self.batch_values
                .resize(self.batch.len() * round.count, 0.0);
            in_time = simulation.live(&self.batch, round, &mut self.batch_values)?;
            if !in_time {
                break;
            }
            self.lived += (self.batch.len() * round.count) as u32;
            let rows = self.batch_values.chunks_exact(round.count);
            for (&i, values) in [SILENCE].iter().chain(part).zip(rows) {
                let begin = i * stride + round.first;
                self.values[begin..begin + round.count].copy_from_slice(values);
            }
        }
        if in_time {
            for &i in [SILENCE].iter().chain(&next) {
                let futures = &mut self.runners[i].futures;
                *futures = (*futures).max(round.first + round.count);
            }
        }
        self.next = next;
        Ok(in_time)
    }

    /// What runner `a` gains over runner `b`, in the futures that both lived through.
    fn gain(&self, a: usize, b: usize) -> Gain {
        let stride = self.settings.race.futures;
        let n = self.runners[a].futures.min(self.runners[b].futures);
        if n < 2 {
            return Gain::default();
        }
        let of = |i: usize| &self.values[i * stride..i * stride + n];
        let differences = || of(a).iter().zip(of(b)).map(|(a, b)| f64::from(a - b));
        let mean = differences().sum::<f64>() / n as f64;
        let squares: f64 = differences().map(|d| (d - mean) * (d - mean)).sum();
        Gain {
            mean: mean - (self.runners[a].cost - self.runners[b].cost),
            error: (squares / (n * (n - 1)) as f64).sqrt(),
        }
    }

    /// The runner of the largest gain over silence among those that `is_asked` holds of; of equals, the first.
    fn best(&self, is_asked: impl Fn(&Runner) -> bool) -> Option<usize> {
        let mut best: Option<(f64, usize)> = None;
        for (i, runner) in self.runners.iter().enumerate().skip(1) {
            if is_asked(runner) {
                let mean = self.gain(i, SILENCE).mean;
                if best.is_none_or(|(most, _)| mean > most) {
                    best = Some((mean, i));
                }
            }
        }
        best.map(|(_, i)| i)
    }

    /// The runner of a candidate.
    fn find(&self, candidate: Candidate) -> Option<usize> {
        let mut runners = self.runners.iter();
        runners.position(|runner| runner.candidate == candidate && runner.futures > 0)
    }

    /// Mean value of a candidate, its cost taken off.
    fn value_of(&self, candidate: Candidate) -> f32 {
        let Some(i) = self.find(candidate) else {
            return 0.0;
        };
        let (begin, n) = (i * self.settings.race.futures, self.runners[i].futures);
        let sum: f64 = self.values[begin..begin + n]
            .iter()
            .copied()
            .map(f64::from)
            .sum();
        (sum / n.max(1) as f64 - self.runners[i].cost) as f32
    }

    /// Rounds that any candidate but silence lived through.
    fn rounds_lived(&self) -> u32 {
        let futures = self.runners[SILENCE].futures;
        let lived = self.rounds.iter().filter(|round| round.first < futures);
        lived.count() as u32
    }

    fn certainty(&self) -> f64 {
        f64::from(self.settings.race.certainty)
    }

    /// The decision so far, with its reasons: what the best of those who tell something now and of those who wait gain.
    fn plan(&self, now: Option<usize>, later: Option<usize>) -> Plan {
        let gain = |i: Option<usize>| i.map_or(Gain::default(), |i| self.gain(i, SILENCE));
        let (gain_now, gain_later) = (gain(now), gain(later));
        let over_later = match (now, later) {
            (Some(now), Some(later)) => self.gain(now, later),
            _ => Gain::default(),
        };
        let silent = self.value_of(Candidate::SILENCE);
        Plan {
            value: silent,
            value_silent: silent,
            reasons: Reasons {
                gain_now: gain_now.mean as f32,
                gain_later: gain_later.mean as f32,
                gain_error: gain_now.error.max(over_later.error) as f32,
                futures: now.map_or(0, |now| self.runners[now].futures) as u32,
                rows: self.lived,
                rounds: self.rounds_lived(),
            },
            ..Plan::default()
        }
    }
}

/// Whether a candidate waits with all that it communicates.
fn is_later(candidate: &Candidate) -> bool {
    candidate.begins().is_some_and(|decision| decision > 0)
}

/// The even number below or at `n`: futures go in two groups.
fn even(n: usize) -> usize {
    n & !1
}
