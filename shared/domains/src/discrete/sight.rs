//! How much of an observation a person perceives by themselves: the true perceptual parameters that MIRROR's implants have to
//! find (paper, Appendix, "Perceptual Implants").

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::Mask;
use crate::{bomb_defusal, driving, search_rescue};

/// Perceptual parameters of a domain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Perception {
    /// Driving: how many cells ahead in the left and the right lane, then behind in the left and the right lane, a car is seen.
    Thresholds([f32; 4]),
    /// Search and rescue: a portion of the map is seen if its centre is within so many cells.
    Radius(f32),
    /// Bomb defusal: probability of noticing each terminal within a step.
    Probabilities([f32; bomb_defusal::TERMINALS]),
}

/// What a person perceives without an assistant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sight {
    /// What they see.
    pub perception: Perception,
    /// Utterances that they hear without an assistant, a bit each.
    pub heard: u32,
}

impl Sight {
    /// What they perceive of an observation, sensed or imagined; `visual` is the whole modality. Only probabilities draw from
    /// `random` (six numbers each time).
    pub fn perceives(&self, visual: &[f32], random: &mut ChaCha8Rng) -> Mask {
        let visual = match &self.perception {
            Perception::Thresholds(cells) => driving::visible(cells, visual),
            Perception::Radius(cells) => search_rescue::visible(*cells, visual),
            Perception::Probabilities(p) => p.iter().enumerate().fold(0, |bits, (terminal, p)| {
                bits | u32::from(random.random::<f32>() < *p) << terminal
            }),
        };
        Mask {
            visual,
            verbal: self.heard,
        }
    }
}
