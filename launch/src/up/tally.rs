//! Counts what happens in a run from the messages themselves: rewards, collisions, what was shown and said, and when.

use super::decisions::{DecisionCount, Decisions};
use super::plans::{PlanCount, Plans};
use crate::place::ItemNames;
use anyhow::Result;
use messages::{CommAction, Display, EpisodeEnd, Outcome, VISUAL_ITEMS, topic};
use runtime::{ClockMode, Input, InputOptions, Launcher, StageTimer, text_of};
use serde::Serialize;
use std::collections::BTreeMap;

/// How an episode ended that nobody drove to its end.
pub const VOID: &str = "void";

/// Something said.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SaidItem {
    /// Simulated seconds since the episode began.
    pub time_s: f64,
    /// The item that it was about: on the highway, a sector.
    pub item: &'static str,
    /// The words.
    pub text: String,
    /// Why.
    pub why: Why,
}

/// What the planner expected of what it communicates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Why {
    /// Gain over silence (`race`).
    pub gain_now: f32,
    /// Gain of the best way of waiting (`race`).
    pub gain_later: f32,
    /// Cost of the step.
    pub cost: f32,
    /// Futures that the decision rests on.
    pub futures: u32,
}

impl Why {
    fn of(decision: &CommAction) -> Self {
        Self {
            gain_now: decision.gain_now,
            gain_later: decision.gain_later,
            cost: decision.cost,
            futures: decision.futures,
        }
    }
}

/// What the person was told of the assistant itself.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Notice {
    /// Simulated seconds since the episode began.
    pub time_s: f64,
    /// The words.
    pub text: String,
}

/// A visual item shown without a break: on the highway, a highlighted sector.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ShownItem {
    /// Simulated seconds since the episode began.
    pub time_s: f64,
    /// How long, in simulated seconds.
    pub duration_s: f64,
    /// The item.
    pub item: &'static str,
    /// Why it was first shown.
    pub why: Why,
}

/// An episode.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct EpisodeTally {
    /// Its number, from 0.
    pub episode: u32,
    /// Control steps driven.
    pub steps: u32,
    /// `goal`, `collision`, `out of time`, or `running` if the run ended before it.
    pub end: &'static str,
    /// What was hit: a car's identity, −2 for the road's edge.
    pub hit: Option<i32>,
    /// Sum of the rewards.
    pub reward: f64,
    /// Visual items shown, summed over steps.
    pub visual_items: u64,
    /// Utterances.
    pub verbal_items: u64,
    /// Cost of all that was communicated.
    pub communication_cost: f64,
    /// Utterances, in order.
    pub said: Vec<SaidItem>,
    /// Highlights, in order of their beginnings.
    pub shown: Vec<ShownItem>,
    /// What the person was told of the assistant itself: that it does not keep up, and that it does again.
    pub notices: Vec<Notice>,
    /// For each visual item, the place in `shown` of the highlight that lasts.
    #[serde(skip)]
    lit: [Option<usize>; VISUAL_ITEMS],
    /// Step and cost of the newest decision.
    #[serde(skip)]
    decided: (u32, f64),
    /// Why something is communicated at a step, for steps whose display has not been seen yet.
    #[serde(skip)]
    reasons: BTreeMap<u32, Why>,
}

/// A late decision is shown at most so many steps after its own.
const LATEST_STEPS: u32 = 4;

/// The launcher's view of a run.
pub struct Tally {
    outcome: Input<Outcome>,
    display: Input<Display>,
    decision: Input<CommAction>,
    step_s: f64,
    /// In real time, what came of the decisions.
    decisions: Option<DecisionCount>,
    /// What the decisions rested on.
    plans: PlanCount,
    /// What can be communicated.
    pub items: ItemNames,
    /// Every episode that began.
    pub episodes: Vec<EpisodeTally>,
    /// From the world's sensing to the display that shows it, in ns.
    pub sensing_to_display: StageTimer,
    /// From the world's sensing to the decision about it, in ns.
    pub sensing_to_decision: StageTimer,
}

impl Tally {
    /// Listens without being woken; call [`Tally::update`] some times a second. `plans`: whether there is a planner.
    ///
    /// # Errors
    /// When a port cannot be made.
    pub fn new(launcher: &Launcher, step_s: f64, items: ItemNames, plans: bool) -> Result<Self> {
        let clock = launcher.arguments().clock;
        Ok(Self {
            outcome: launcher.input_with(topic::OUTCOME, InputOptions::recorder())?,
            display: launcher
                .input_with(topic::DISPLAY, InputOptions::recorder())?
                .once_in(clock),
            decision: launcher
                .input_with(topic::COMM_ACTION, InputOptions::recorder())?
                .once_in(clock),
            step_s,
            decisions: match clock {
                ClockMode::Lockstep => None,
                ClockMode::RealTime => Some(DecisionCount::new(plans)),
            },
            plans: PlanCount::default(),
            items,
            episodes: Vec::new(),
            sensing_to_display: StageTimer::new(),
            sensing_to_decision: StageTimer::new(),
        })
    }

    /// Takes in what came since the last call.
    ///
    /// # Errors
    /// When a port fails.
    pub fn update(&mut self) -> Result<()> {
        while let Some(decision) = self.decision.next()? {
            if let Some(decisions) = &mut self.decisions {
                decisions.decide(decision);
            }
            self.plans.decide(decision);
            self.sensing_to_decision.record(
                decision
                    .header
                    .sent_ns
                    .saturating_sub(decision.header.cause_ns),
            );
            let episode = entry(&mut self.episodes, decision.header.episode);
            episode.communication_cost += f64::from(decision.cost);
            let step = decision.header.step;
            episode.decided = (step, f64::from(decision.cost));
            if decision.visual | decision.verbal != 0 {
                episode.reasons.insert(step, Why::of(decision));
            }
        }
        while let Some(display) = self.display.next()? {
            self.sensing_to_display.record(
                display
                    .header
                    .sent_ns
                    .saturating_sub(display.header.cause_ns),
            );
            entry(&mut self.episodes, display.header.episode).show(
                display,
                self.step_s,
                self.items,
            );
        }
        while let Some(outcome) = self.outcome.next()? {
            if let Some(decisions) = &mut self.decisions {
                decisions.begin(outcome);
            }
            entry(&mut self.episodes, outcome.header.episode).step(outcome);
        }
        Ok(())
    }

    /// Messages that the launcher itself did not see, by topic.
    pub fn lost(&self) -> [(&'static str, u64); 3] {
        [
            (topic::OUTCOME, self.outcome.lost()),
            (topic::DISPLAY, self.display.lost()),
            (topic::COMM_ACTION, self.decision.lost()),
        ]
    }

    /// What came of the decisions, where there is a deadline for them and somebody to make them.
    pub fn decisions(&self) -> Option<Decisions> {
        let so_far = self.decisions.as_ref()?.so_far;
        (so_far.steps > 0).then_some(so_far)
    }

    /// What the decisions rested on; none without a decision.
    pub fn plans(&self) -> Option<Plans> {
        self.plans.so_far()
    }

    /// Control steps of all episodes.
    pub fn steps(&self) -> u64 {
        self.episodes
            .iter()
            .map(|episode| u64::from(episode.steps))
            .sum()
    }

    /// Ends the count: what was decided for a step that never came cost nothing.
    pub fn close(&mut self) {
        for episode in &mut self.episodes {
            let (step, cost) = episode.decided;
            if step >= episode.steps {
                episode.communication_cost -= cost;
            }
        }
    }
}

fn entry(episodes: &mut Vec<EpisodeTally>, number: u32) -> &mut EpisodeTally {
    while episodes.len() <= number as usize {
        let episode = episodes.len() as u32;
        episodes.push(EpisodeTally {
            episode,
            end: "running",
            ..EpisodeTally::default()
        });
    }
    &mut episodes[number as usize]
}

impl EpisodeTally {
    fn step(&mut self, outcome: &Outcome) {
        self.steps = self.steps.max(outcome.header.step);
        self.reward += f64::from(outcome.reward);
        if outcome.collided != 0 {
            self.hit = Some(outcome.other);
        }
        match outcome.end() {
            Ok(EpisodeEnd::Goal) => self.end = "goal",
            Ok(EpisodeEnd::Collision) => self.end = "collision",
            Ok(EpisodeEnd::OutOfTime) => self.end = "out of time",
            Ok(EpisodeEnd::Voided) => self.end = VOID,
            Ok(EpisodeEnd::Running) | Err(_) => {}
        }
    }

    /// Why something is communicated at a step: as the newest decision says that is not for a later one.
    fn why(&mut self, step: u32) -> Why {
        let oldest = step.saturating_sub(LATEST_STEPS);
        self.reasons = self.reasons.split_off(&oldest);
        let known = self.reasons.range(..=step).next_back();
        known.map_or(Why::default(), |(_, why)| *why)
    }

    fn show(&mut self, display: &Display, step_s: f64, items: ItemNames) {
        let time_s = f64::from(display.header.step) * step_s;
        let why = self.why(display.header.step);
        for (item, name) in items.visual.iter().enumerate().take(VISUAL_ITEMS) {
            if display.highlighted >> item & 1 == 0 {
                self.lit[item] = None;
                continue;
            }
            self.visual_items += 1;
            let place = *self.lit[item].get_or_insert_with(|| {
                self.shown.push(ShownItem {
                    time_s,
                    duration_s: 0.0,
                    item: name,
                    why,
                });
                self.shown.len() - 1
            });
            self.shown[place].duration_s = time_s + step_s - self.shown[place].time_s;
        }
        for utterance in display
            .utterances
            .iter()
            .take(display.utterance_count as usize)
        {
            if utterance.is_notice() {
                let text = text_of(&utterance.text);
                self.notices.push(Notice { time_s, text });
                continue;
            }
            self.verbal_items += 1;
            let name = items
                .verbal
                .get(utterance.item as usize)
                .copied()
                .unwrap_or("?");
            self.said.push(SaidItem {
                time_s,
                item: name,
                text: text_of(&utterance.text),
                why,
            });
        }
    }
}
