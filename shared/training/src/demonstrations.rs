//! Demonstrations: rounds that a person drove, with what the robot sensed and what the person did.

use crate::replay::VISUAL;

/// One moment of a round.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// x^visual_t as the robot senses it, unmasked.
    pub visual: [f32; VISUAL],
    /// a_t: what the person then did.
    pub action: [f32; 2],
}

/// One round.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Round {
    /// Moments in the order of time.
    pub steps: Vec<Moment>,
    /// Whether it ended in a collision.
    pub collided: bool,
}

/// Rounds of one person.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Demonstrations {
    /// Rounds.
    pub rounds: Vec<Round>,
    /// Who drove and how, for error messages and metadata.
    pub source: String,
}
