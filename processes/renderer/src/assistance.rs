//! Whether the assistant keeps up in real time, so that a person who is not assisted is told so: once when it begins
//! and once when it ends.

use messages::{CommAction, DecisionReason, Display, Header, Utterance};

/// Steps that are looked back over.
const RECENT: u32 = 10;
/// With fewer decisions in time than this, the person is not assisted …
const FEWEST: u32 = 5;
/// … and with as many as this, again.
const ENOUGH: u32 = 9;

/// What was in time lately.
#[derive(Clone, Debug, Default)]
pub struct Assistance {
    /// A bit per recent step, the newest lowest: whether its decision was there in time.
    in_time: u32,
    /// Steps looked at, up to [`RECENT`].
    seen: u32,
    /// Whether the person was told that they are not assisted.
    is_missing: bool,
}

impl Assistance {
    /// Takes note of a new frame and of the newest decision that is there with it, and tells the person in `display` if
    /// something has changed.
    pub fn look(&mut self, sensed: &Header, decision: Option<&CommAction>, display: &mut Display) {
        if decision.is_some_and(|decision| decision.reason() == Ok(DecisionReason::NoPlanner)) {
            *self = Self::default(); // nobody is promised anything
            return;
        }
        if sensed.step == 0 {
            return; // for an episode's first step nothing is decided
        }
        let is_in_time = decision.is_some_and(|decision| {
            decision.reason() != Ok(DecisionReason::HumanSilent)
                && (decision.header.episode, decision.header.step) == (sensed.episode, sensed.step)
        });
        let window = (1 << RECENT) - 1;
        self.in_time = (self.in_time << 1 | u32::from(is_in_time)) & window;
        self.seen = (self.seen + 1).min(RECENT);
        let in_time = self.in_time.count_ones();
        if self.seen < RECENT {
            return;
        }
        let is_missing = match self.is_missing {
            true => in_time < ENOUGH,
            false => in_time < FEWEST,
        };
        if std::mem::replace(&mut self.is_missing, is_missing) != is_missing {
            let word = match is_missing {
                true => "Not assisted",
                false => "Assisted again",
            };
            let text = format!("{word}: {in_time} of the last {RECENT} decisions came in time");
            tell(&text, display);
        }
    }
}

/// Adds a notice to what the person is told, if there is room for it.
fn tell(text: &str, display: &mut Display) {
    let count = display.utterance_count as usize;
    if let Some(place) = display.utterances.get_mut(count) {
        *place = Utterance::notice(text);
        display.utterance_count += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lines::text_of;
    use messages::Message;

    /// What a person is told over steps whose decisions are there in time, or not.
    fn told(in_time: impl IntoIterator<Item = bool>, reason: DecisionReason) -> Vec<(u32, String)> {
        let mut assistance = Assistance::default();
        let mut found = Vec::new();
        for (step, in_time) in (0..).zip(in_time) {
            let mut decision = CommAction::ZERO;
            decision.reason = reason.wire();
            decision.header.step = if in_time {
                step
            } else {
                step.saturating_sub(2)
            };
            let sensed = Header {
                step,
                ..Header::default()
            };
            let mut display = Display::ZERO;
            assistance.look(&sensed, Some(&decision), &mut display);
            if display.utterance_count > 0 {
                assert!(display.utterances[0].is_notice());
                assert_eq!(display.said(), 0, "nothing is said about an item");
                found.push((step, text_of(&display.utterances[0]).into_owned()));
            }
        }
        found
    }

    #[test]
    fn who_is_not_assisted_is_told_once_when_it_begins_and_once_when_it_ends() {
        let steps = (0..60).map(|step| !(15..40).contains(&step));
        assert_eq!(
            told(steps, DecisionReason::Planned),
            [
                (
                    20,
                    "Not assisted: 4 of the last 10 decisions came in time".to_owned()
                ),
                (
                    48,
                    "Assisted again: 9 of the last 10 decisions came in time".to_owned()
                ),
            ]
        );
        assert!(
            told((0..60).map(|step| step % 2 == 0), DecisionReason::Planned).is_empty(),
            "half of them"
        );
    }

    #[test]
    fn a_silent_human_model_leaves_the_person_alone_and_no_planner_promises_nothing() {
        assert_eq!(told([true; 30], DecisionReason::HumanSilent).len(), 1);
        assert!(told([false; 30], DecisionReason::NoPlanner).is_empty());
    }
}
