//! What could be communicated over the horizon, as a few whole candidates rather than as many bits: silence, an item now or
//! at a later moment, and combinations of these.

use crate::items::Items;
use crate::planner::Settings;
use models::Communicated;

/// Most items, visual and verbal together: [`Communicated`] has bits for no more.
pub const MOST_ITEMS: usize = 24;
/// A decision that never comes.
const NEVER: u8 = u8::MAX;

/// One way of communicating over the horizon: for each item, the decision at which it is shown or said.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Candidate {
    /// By item: visual items, then verbal ones.
    at: [u8; MOST_ITEMS],
}

impl Candidate {
    /// Nothing is communicated.
    pub const SILENCE: Self = Self {
        at: [NEVER; MOST_ITEMS],
    };

    /// The same with `item` at a decision, counted from 0, which is now.
    pub fn with(mut self, item: usize, decision: usize) -> Self {
        self.at[item] = decision.min(usize::from(NEVER)) as u8;
        self
    }

    /// The decision at which an item is communicated, if it is.
    pub fn decision(&self, item: usize) -> Option<usize> {
        (self.at[item] != NEVER).then_some(usize::from(self.at[item]))
    }

    /// Whether nothing is communicated.
    pub fn is_silent(&self) -> bool {
        *self == Self::SILENCE
    }

    /// Whether something is communicated now.
    pub fn begins_now(&self) -> bool {
        self.at.contains(&0)
    }

    /// The first decision at which something is communicated, none of silence.
    pub fn begins(&self) -> Option<usize> {
        let first = self.at.iter().copied().min().unwrap_or(NEVER);
        (first != NEVER).then_some(usize::from(first))
    }

    /// Whether an item of `items`, a range of numbers, is communicated at any moment.
    pub fn has_any(&self, mut items: core::ops::Range<usize>) -> bool {
        items.any(|item| self.at[item] != NEVER)
    }

    /// What is communicated at a decision; `visual` items come before the verbal ones.
    pub fn told(&self, decision: usize, visual: usize) -> Communicated {
        let (mut shown, mut said) = (0, 0);
        for (item, at) in self.at.iter().enumerate() {
            if usize::from(*at) == decision && *at != NEVER {
                match item.checked_sub(visual) {
                    None => shown |= 1 << item,
                    Some(utterance) => said |= 1 << utterance,
                }
            }
        }
        Communicated::new(shown, said)
    }

    /// Σ_t γ^t C(ω_t): an utterance costs once, a highlight in every step of its decision.
    pub fn cost(&self, settings: &Settings, items: &impl Items) -> f32 {
        let (hold, visual) = (settings.hold, items.visual_items());
        let mut sum = 0.0;
        for decision in 0..settings.race_decisions() {
            let told = self.told(decision, visual);
            let shown = Communicated::new(told.visual_bits(), 0);
            for t in decision * hold..((decision + 1) * hold).min(settings.race.steps) {
                let told = if t == decision * hold { told } else { shown };
                if told != Communicated::default() {
                    sum += settings.discount.powi(t as i32) * items.cost(settings, told);
                }
            }
        }
        sum
    }
}

/// The moments at which something can be communicated, as decisions from now on: every one of the next few, then fewer and
/// fewer, since what lies farther ahead is decided anew before it comes.
pub fn moments(decisions: usize) -> impl Iterator<Item = usize> {
    let gap = |decision: usize| match decision {
        0..4 => 1,
        4..8 => 2,
        _ => 4,
    };
    core::iter::successors(Some(0), move |&decision| Some(decision + gap(decision)))
        .take_while(move |decision| *decision < decisions)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::items::Sectors;

    #[test]
    fn what_is_told_when() {
        let candidate = Candidate::SILENCE.with(1, 0).with(9, 0).with(8, 3);
        assert!(candidate.begins_now() && !candidate.is_silent());
        assert_eq!(candidate.told(0, 6), Communicated::new(0b10, 0b1000));
        assert_eq!(candidate.told(3, 6), Communicated::new(0, 0b100));
        assert_eq!(candidate.told(1, 6), Communicated::default());
        assert_eq!(Candidate::SILENCE.begins(), None);
        assert_eq!(Candidate::SILENCE.with(7, 5).begins(), Some(5));
        assert!(candidate.has_any(6..12) && !candidate.has_any(2..6));
    }

    #[test]
    fn an_utterance_costs_once_and_a_highlight_in_every_step() {
        let settings = Settings {
            discount: 0.5,
            ..Settings::default()
        };
        assert_eq!(settings.hold, 2);
        let (shows, says) = (Candidate::SILENCE.with(0, 0), Candidate::SILENCE.with(6, 1));
        let near = |a: f32, b: f32| assert!((a - b).abs() < 1e-6, "{a} for {b}");
        near(shows.cost(&settings, &Sectors), 0.02 * (1.0 + 0.5));
        near(says.cost(&settings, &Sectors), 0.4 * 0.25);
        near(Candidate::SILENCE.cost(&settings, &Sectors), 0.0);
    }

    #[test]
    fn moments_lie_closest_near_now() {
        let of = |decisions| moments(decisions).collect::<Vec<_>>();
        assert_eq!(of(1), [0]);
        assert_eq!(of(5), [0, 1, 2, 3, 4]);
        assert_eq!(of(12), [0, 1, 2, 3, 4, 6, 8]);
        assert_eq!(of(18), [0, 1, 2, 3, 4, 6, 8, 12, 16]);
    }
}
