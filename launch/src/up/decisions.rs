//! How many steps of a real-time run had a decision of the assistant in time.
//!
//! A decision is in time if it was sent before its step began; the step's outcome says when that was. Where there is no
//! planner, none is due, and neither is one for an episode's first step.

use messages::{CommAction, DecisionReason, EpisodeEnd, Outcome};
use runtime::Position;
use serde::Serialize;
use std::collections::BTreeMap;

/// Steps for which a decision may still come.
const MOST_WAITING: usize = 64;

/// Steps for which a decision was due, and what came of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Decisions {
    /// All of them.
    pub steps: u64,
    /// The decision was there when the step began.
    pub in_time: u64,
    /// It came later.
    pub late: u64,
    /// None came.
    pub none: u64,
}

impl Decisions {
    /// In words.
    pub fn text(&self) -> String {
        let Self {
            steps,
            in_time,
            late,
            none,
        } = self;
        format!("{in_time} of {steps} steps had a decision in time; {late} came late, {none} never")
    }

    /// Whether the person was assisted throughout, by and large: 19 of 20 decisions were in time.
    pub fn keeps_up(&self) -> bool {
        self.in_time * 20 >= self.steps * 19
    }
}

/// Counts them.
#[derive(Debug, Default)]
pub struct DecisionCount {
    /// So far.
    pub so_far: Decisions,
    /// Whether there is a planner.
    plans: bool,
    /// When what was decided for steps that have not begun yet was sent.
    decided: BTreeMap<Position, u64>,
    /// Steps without a decision, oldest first; one may still come.
    waiting: Vec<Position>,
}

impl DecisionCount {
    /// `plans`: whether there is a planner at the beginning.
    pub fn new(plans: bool) -> Self {
        Self {
            plans,
            ..Self::default()
        }
    }

    /// Takes note of a decision.
    pub fn decide(&mut self, decision: &CommAction) {
        self.plans = decision.reason() != Ok(DecisionReason::NoPlanner);
        if !decision.is_decided() {
            return;
        }
        let position = (decision.header.episode, decision.header.step);
        match self.waiting.iter().position(|waiting| *waiting == position) {
            Some(at) => {
                self.waiting.remove(at);
                self.so_far.none -= 1;
                self.so_far.late += 1;
            }
            None => drop(self.decided.insert(position, decision.header.sent_ns)),
        }
    }

    /// Takes note of a step's beginning.
    pub fn begin(&mut self, outcome: &Outcome) {
        let header = &outcome.header;
        let position = (header.episode, header.step);
        let sent_ns = self.decided.remove(&position);
        // What was decided for steps that never came.
        self.decided = self.decided.split_off(&position);
        if !self.plans || header.step == 0 || outcome.end() != Ok(EpisodeEnd::Running) {
            return;
        }
        self.so_far.steps += 1;
        match sent_ns {
            Some(sent_ns) if sent_ns <= header.sent_ns => self.so_far.in_time += 1,
            Some(_) => self.so_far.late += 1,
            None => {
                self.so_far.none += 1;
                self.waiting.push(position);
                let old = self.waiting.len().saturating_sub(MOST_WAITING);
                self.waiting.drain(..old);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::Message;

    fn decision(step: u32, sent_ns: u64, reason: DecisionReason) -> CommAction {
        let mut decision = CommAction::ZERO;
        decision.header.step = step;
        decision.header.sent_ns = sent_ns;
        decision.reason = reason.wire();
        decision
    }

    fn step(step: u32, sent_ns: u64, end: EpisodeEnd) -> Outcome {
        let mut outcome = Outcome::ZERO;
        outcome.header.step = step;
        outcome.header.sent_ns = sent_ns;
        outcome.end = end.wire();
        outcome
    }

    #[test]
    fn every_step_counts_once_however_its_decision_is_heard_of() {
        let mut count = DecisionCount::new(true);
        count.begin(&step(0, 100, EpisodeEnd::Running));
        count.decide(&decision(1, 190, DecisionReason::Planned));
        count.begin(&step(1, 200, EpisodeEnd::Running)); // in time
        count.decide(&decision(2, 310, DecisionReason::Late));
        count.begin(&step(2, 300, EpisodeEnd::Running)); // late, though heard of before its step
        count.begin(&step(3, 400, EpisodeEnd::Running)); // late, heard of after it
        count.decide(&decision(3, 430, DecisionReason::Late));
        count.decide(&decision(4, 480, DecisionReason::HumanSilent));
        count.begin(&step(4, 500, EpisodeEnd::Running)); // none
        count.begin(&step(5, 600, EpisodeEnd::Collision)); // the end: nobody acts any more
        let expected = Decisions {
            steps: 4,
            in_time: 1,
            late: 2,
            none: 1,
        };
        assert_eq!(count.so_far, expected);
    }

    #[test]
    fn where_nobody_plans_no_decision_is_due() {
        let mut count = DecisionCount::new(false);
        for k in 0..5 {
            count.begin(&step(k, 100 * u64::from(k), EpisodeEnd::Running));
            count.decide(&decision(
                k + 1,
                100 * u64::from(k) + 10,
                DecisionReason::NoPlanner,
            ));
        }
        assert_eq!(count.so_far, Decisions::default());
    }
}
