//! What a world lets be sensed: a message of its domain's, on a topic of its own, at which every step begins.

use crate::{LidarFrame, Message, Observation, topic};

/// What is sensed at a step. Loops over it are the same in every domain.
pub trait Sensed: Message {
    /// Its topic.
    const TOPIC: &'static str;
}

impl Sensed for LidarFrame {
    const TOPIC: &'static str = topic::LIDAR;
}

impl Sensed for Observation {
    const TOPIC: &'static str = topic::OBSERVATION;
}
