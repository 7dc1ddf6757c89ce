//! What the planner's decisions rested on: how many futures, and how much was imagined for them.

use messages::{CommAction, DecisionReason};
use serde::Serialize;
use std::collections::BTreeMap;

/// Over all decisions of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Plans {
    /// Decisions that were planned.
    pub decisions: u64,
    /// Of these, for which there was something that could have been communicated, and time to imagine it.
    pub weighed: u64,
    /// Futures that those rest on.
    pub futures: Spread,
    /// Candidates × futures that were imagined for those.
    pub imagined: Spread,
}

/// Three of many numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Spread {
    /// The least.
    pub min: u32,
    /// The median.
    pub p50: u32,
    /// The most.
    pub max: u32,
}

impl Plans {
    /// In words.
    pub fn text(&self) -> String {
        let Self {
            decisions,
            weighed,
            futures,
            imagined,
        } = self;
        format!(
            "{weighed} of {decisions} weighed what to communicate, on {} futures (median; {} to {}) and {} imagined lives (median; at most {})",
            futures.p50, futures.min, futures.max, imagined.p50, imagined.max
        )
    }
}

/// Counts them.
#[derive(Debug, Default)]
pub struct PlanCount {
    decisions: u64,
    futures: Counted,
    imagined: Counted,
}

/// How often each number came.
#[derive(Debug, Default)]
struct Counted(BTreeMap<u32, u64>);

impl Counted {
    fn add(&mut self, number: u32) {
        *self.0.entry(number).or_default() += 1;
    }

    fn spread(&self) -> Spread {
        let all: u64 = self.0.values().sum();
        let mut below = 0;
        let median = self.0.iter().find(|(_, count)| {
            below += **count;
            2 * below >= all
        });
        let end = |entry: Option<(&u32, &u64)>| entry.map_or(0, |(number, _)| *number);
        Spread {
            min: end(self.0.first_key_value()),
            p50: end(median),
            max: end(self.0.last_key_value()),
        }
    }
}

impl PlanCount {
    /// Takes note of a decision.
    pub fn decide(&mut self, decision: &CommAction) {
        let is_planned = matches!(
            decision.reason(),
            Ok(DecisionReason::Planned | DecisionReason::Late)
        );
        self.decisions += u64::from(is_planned);
        if is_planned && decision.futures > 0 {
            self.futures.add(decision.futures);
            self.imagined.add(decision.samples);
        }
    }

    /// So far; none without a decision.
    pub fn so_far(&self) -> Option<Plans> {
        (self.decisions > 0).then(|| Plans {
            decisions: self.decisions,
            weighed: self.futures.0.values().sum(),
            futures: self.futures.spread(),
            imagined: self.imagined.spread(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::Message;

    #[test]
    fn decisions_are_counted_by_what_they_rest_on() {
        let mut count = PlanCount::default();
        assert_eq!(count.so_far(), None);
        let mut decision = CommAction::ZERO;
        for (futures, samples) in [(8, 80), (8, 90), (64, 700), (0, 0)] {
            (decision.futures, decision.samples) = (futures, samples);
            count.decide(&decision);
        }
        decision.reason = DecisionReason::HumanSilent.wire();
        count.decide(&decision);
        let plans = count.so_far().expect("four were planned");
        assert_eq!((plans.decisions, plans.weighed), (4, 3));
        let spread = |min, p50, max| Spread { min, p50, max };
        assert_eq!(plans.futures, spread(8, 8, 64));
        assert_eq!(plans.imagined, spread(80, 90, 700));
        assert!(plans.text().starts_with("3 of 4 weighed"));
    }
}
