//! The messages of the gridworlds (DESIGN §3): driving, search and rescue, bomb defusal.

use crate::Header;
use crate::message::message;

/// Most numbers of a gridworld's visual modality; search and rescue has 246.
pub const GRID_VISUAL: usize = 256;
/// Most numbers of a gridworld's verbal modality; search and rescue says five utterances of 8 numbers each.
pub const GRID_VERBAL: usize = 128;

message! {
    /// What the robot senses of a gridworld at step k. `domains::discrete::Layout` says what the numbers mean.
    pub struct Observation, "1" {
        /// Header; `cause_ns` is the moment of sensing.
        pub header: Header,
        /// The visual modality; if it has an image, that comes first, channel after channel, row after row.
        pub visual: [f32; GRID_VISUAL],
        /// The verbal modality.
        pub verbal: [f32; GRID_VERBAL],
        /// How much of `visual` is used.
        pub visual_len: u32,
        /// How much of `verbal` is used.
        pub verbal_len: u32,
        /// 0 driving, 1 search and rescue, 2 bomb defusal.
        pub domain: u32,
        /// A bit for each action that can be done now.
        pub legal: u32,
    } header: yes
}
