//! The messages of the gridworlds: driving, search and rescue, bomb defusal.

use crate::message::message;
use crate::{Header, VERBAL_NUMBERS, VISUAL_NUMBERS};

message! {
    /// What the robot senses of a gridworld at step k. `domains::Layout` says what the numbers mean.
    pub struct Observation, "2" {
        /// Header; `cause_ns` is the moment of sensing.
        pub header: Header,
        /// The visual modality; if it has an image, that comes first, channel after channel, row after row.
        pub visual: [f32; VISUAL_NUMBERS],
        /// The verbal modality.
        pub verbal: [f32; VERBAL_NUMBERS],
        /// How much of `visual` is used.
        pub visual_len: u32,
        /// How much of `verbal` is used.
        pub verbal_len: u32,
        /// Which domain; see [`DomainNumber`](crate::DomainNumber).
        pub domain: u32,
        /// A bit for each action that can be done now.
        pub legal: u32,
    } header: yes
}

/// Most bytes of a [`Picture`]'s text.
pub const PICTURE_BYTES: usize = 1024;

message! {
    /// The true state of a gridworld, for display and scoring only: belief, human model and planner never read it.
    pub struct Picture, "1" {
        /// Header.
        pub header: Header,
        /// A drawing in text (in memory, zero-padded UTF-8): lines of cells, then a line that says what its letters
        /// stand for.
        pub text: [u8; PICTURE_BYTES] as text,
    } header: yes
}
