//! What a world lets be sensed: a message of its domain's, on a topic of its own, at which every step begins.

use crate::{
    Display, DomainNumber, LidarFrame, Message, Observation, Utterance, UtteranceContent, VERBAL,
    topic,
};

/// What is sensed at a step. Loops over it are the same in every domain.
pub trait Sensed: Message {
    /// Its topic.
    const TOPIC: &'static str;

    /// Domain, and how many visual and verbal numbers there are. What another program sends need not be what a model
    /// takes.
    fn measure(&self) -> [u32; 3];
}

impl Sensed for LidarFrame {
    const TOPIC: &'static str = topic::LIDAR;

    fn measure(&self) -> [u32; 3] {
        let visual = self.range.len() + self.ego.len();
        [DomainNumber::Highway.wire(), visual as u32, VERBAL as u32]
    }
}

impl Sensed for Observation {
    const TOPIC: &'static str = topic::OBSERVATION;

    fn measure(&self) -> [u32; 3] {
        [self.domain, self.visual_len, self.verbal_len]
    }
}

impl Observation {
    /// The visual modality.
    pub fn visual(&self) -> &[f32] {
        &self.visual[..self.visual.len().min(self.visual_len as usize)]
    }

    /// The verbal modality.
    pub fn verbal(&self) -> &[f32] {
        &self.verbal[..self.verbal.len().min(self.verbal_len as usize)]
    }
}

impl Utterance {
    /// A notice, as much of it as fits.
    pub fn notice(text: &str) -> Self {
        let mut notice = Self {
            item: Self::NO_ITEM,
            kind: UtteranceContent::Notice.wire(),
            ..Self::ZERO
        };
        // A zero follows.
        let mut end = text.len().min(notice.text.len() - 1);
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        notice.text[..end].copy_from_slice(&text.as_bytes()[..end]);
        notice
    }
}

impl Display {
    /// A bit per verbal item that is said now.
    pub fn said(&self) -> u32 {
        let spoken = self.utterances.len().min(self.utterance_count as usize);
        let items = self.utterances[..spoken].iter().map(|said| said.item);
        items
            .filter(|item| *item < u32::BITS)
            .fold(0, |bits, item| bits | 1 << item)
    }
}
