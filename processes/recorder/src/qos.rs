//! Quality of service of a channel, as rosbag2 keeps it in the channel's metadata: whoever plays a recording offers
//! what is sent once to those who join later, too.

use std::collections::BTreeMap;

/// Key of the channel's metadata.
const KEY: &str = "offered_qos_profiles";
/// A duration that never ends, as rmw has it.
const FOR_EVER: &str = "\n    sec: 9223372036\n    nsec: 854775807";

/// How a topic's messages reach those who listen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Qos {
    /// Every message, to those who listen when it is sent.
    Stream,
    /// The last message, to those who come later, too: it is sent once.
    Latched,
    /// The newest message alone matters, as of a clock.
    Newest,
}

impl Qos {
    /// The channel's metadata. In numbers, as versions of rosbag2 up to 8 write it: all of them read that from a file
    /// without rosbag2's own metadata.
    pub fn metadata(self) -> BTreeMap<String, String> {
        const KEEP_LAST: u32 = 1;
        const RELIABLE: u32 = 1;
        const BEST_EFFORT: u32 = 2;
        const TRANSIENT_LOCAL: u32 = 1;
        const VOLATILE: u32 = 2;
        let (depth, reliability, durability) = match self {
            Self::Stream => (10, RELIABLE, VOLATILE),
            Self::Latched => (1, RELIABLE, TRANSIENT_LOCAL),
            Self::Newest => (1, BEST_EFFORT, VOLATILE),
        };
        let profile = format!(
            "- history: {KEEP_LAST}\n  depth: {depth}\n  reliability: {reliability}\n  durability: {durability}\n  \
             deadline:{FOR_EVER}\n  lifespan:{FOR_EVER}\n  liveliness: 1\n  \
             liveliness_lease_duration:{FOR_EVER}\n  avoid_ros_namespace_conventions: false"
        );
        BTreeMap::from([(KEY.to_owned(), profile)])
    }
}
