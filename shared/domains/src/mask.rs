//! A set of visual regions and utterances: what is perceived, what is communicated.

use std::ops::{BitAnd, BitOr, BitOrAssign};

/// Bit i of `visual` is visual region i, bit i of `verbal` is utterance i, as [`crate::Layout`] numbers them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Mask {
    /// Visual regions.
    pub visual: u64,
    /// Utterances.
    pub verbal: u32,
}

impl Mask {
    /// Nothing.
    pub const NONE: Self = Self {
        visual: 0,
        verbal: 0,
    };

    /// Whether a visual region is in the set.
    pub fn sees(self, region: usize) -> bool {
        self.visual >> region & 1 == 1
    }

    /// Whether an utterance is in the set.
    pub fn hears(self, utterance: usize) -> bool {
        self.verbal >> utterance & 1 == 1
    }

    /// How many visual regions and utterances are in the set.
    pub fn count(self) -> (u32, u32) {
        (self.visual.count_ones(), self.verbal.count_ones())
    }
}

impl BitOr for Mask {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self {
            visual: self.visual | other.visual,
            verbal: self.verbal | other.verbal,
        }
    }
}

impl BitOrAssign for Mask {
    fn bitor_assign(&mut self, other: Self) {
        *self = *self | other;
    }
}

impl BitAnd for Mask {
    type Output = Self;
    fn bitand(self, other: Self) -> Self {
        Self {
            visual: self.visual & other.visual,
            verbal: self.verbal & other.verbal,
        }
    }
}
