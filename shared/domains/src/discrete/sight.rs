//! How much of an observation a person perceives by themselves: the true perceptual parameters that MIRROR's implants have to
//! find (paper, Appendix, "Perceptual Implants").

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::{Mask, bomb_defusal, driving, search_rescue};

/// The true limits of a person's sight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Limits {
    /// Driving: how many cells ahead in the left and the right lane, then behind in the left and the right lane, a car is seen.
    Thresholds([f32; 4]),
    /// Search and rescue: a portion of the map is seen if its centre is within so many cells.
    Radius(f32),
    /// Bomb defusal: probability of noticing each terminal within a step.
    Probabilities([f32; bomb_defusal::TERMINALS]),
}

impl Limits {
    /// As numbers, in the order of the domain's [`crate::Perception`].
    pub fn to_vec(&self) -> Vec<f32> {
        match self {
            Self::Thresholds(cells) => cells.to_vec(),
            Self::Radius(cells) => vec![*cells],
            Self::Probabilities(p) => p.to_vec(),
        }
    }
}

/// What a person perceives without an assistant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sight {
    /// What they see.
    pub limits: Limits,
    /// Utterances that they hear without an assistant, a bit each.
    pub heard: u32,
}

impl Sight {
    /// What they perceive of an observation, sensed or imagined; `visual` is the whole modality. Only probabilities draw from
    /// `random` (six numbers each time).
    pub fn perceives(&self, visual: &[f32], random: &mut ChaCha8Rng) -> Mask {
        let visual = match &self.limits {
            Limits::Thresholds(cells) => driving::visible(cells, visual),
            Limits::Radius(cells) => search_rescue::visible(*cells, visual),
            Limits::Probabilities(p) => p.iter().enumerate().fold(0, |bits, (terminal, p)| {
                bits | u64::from(random.random::<f32>() < *p) << terminal
            }),
        };
        Mask {
            visual,
            verbal: self.heard,
        }
    }
}
