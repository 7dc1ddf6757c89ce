//! The topics that are recorded, and one type that holds a message of any of them.
//!
//! `human/imagine` is left out on purpose: a question carries half a megabyte, dozens of them make one plan, and each
//! is a pure function of what is recorded (beliefs, actions, seeds).

use messages::{
    Cockpit, CommAction, Control, Display, DriverAction, Field, Header, HumanBelief, LidarFrame,
    Message, Observation, Outcome, Picture, Report, RobotBelief, Scene, topic,
};
use runtime::{Digest, Input, InputOptions, Node, PortError};

/// What the recorder knows about a topic.
#[derive(Clone, Copy, Debug)]
pub struct RecordedTopic {
    /// Such as `world/lidar`.
    pub name: &'static str,
    /// Such as `mirror_msgs/LidarFrame`.
    pub ros_type: &'static str,
    /// The `ros2msg` text of what is recorded.
    pub definition: fn() -> String,
    /// The `ros2msg` text of the message's memory, which versions before this one recorded as it was.
    pub memory_definition: fn() -> String,
    /// The message's fields.
    pub fields: fn() -> &'static [Field],
    /// Bytes of a message in memory.
    pub size: usize,
}

macro_rules! topics {
    ($($field:ident: $variant:ident on $topic:path;)*) => {
        /// A message of any recorded topic, in place: as large as the largest, so that a block of this type takes
        /// each of them without allocation.
        #[derive(Clone, Copy, Debug, PartialEq)]
        // The large variant is the point; see above.
        #[allow(clippy::large_enum_variant)]
        pub enum Recorded {
            $(
                #[doc = concat!("A [`", stringify!($variant), "`].")]
                $variant($variant),
            )*
        }

        $(impl From<&$variant> for Recorded {
            fn from(message: &$variant) -> Self {
                Self::$variant(*message)
            }
        })*

        /// Every recorded topic, in the order of [`Recorded`]'s variants.
        pub const TOPICS: [RecordedTopic; [$(stringify!($variant)),*].len()] = [$(RecordedTopic {
            name: $topic,
            ros_type: <$variant as Message>::ROS_TYPE,
            definition: <$variant as Message>::ros_definition,
            memory_definition: <$variant as Message>::definition,
            fields: <$variant as Message>::fields,
            size: size_of::<$variant>(),
        },)*];

        impl Recorded {
            /// Index into [`TOPICS`].
            pub fn topic(&self) -> usize {
                #[allow(clippy::enum_variant_names)]
                enum Index { $($variant,)* }
                match self { $(Self::$variant(_) => Index::$variant as usize,)* }
            }

            /// The message that these bytes are, on the topic with this index into [`TOPICS`]; none if they are not
            /// as many as the message has.
            pub fn from_bytes(topic: usize, bytes: &[u8]) -> Option<Self> {
                let mut index = 0;
                $(
                    if topic == index {
                        return read_message::<$variant>(bytes).map(Self::$variant);
                    }
                    index += 1;
                )*
                let _ = index;
                None
            }

            /// The message's bytes in memory.
            pub fn bytes(&self) -> &[u8] {
                match self { $(Self::$variant(message) => message.bytes(),)* }
            }

            /// The message's header.
            pub fn header(&self) -> &Header {
                match self { $(Self::$variant(message) => &message.header,)* }
            }

            /// The same, to be changed.
            pub fn header_mut(&mut self) -> &mut Header {
                match self { $(Self::$variant(message) => &mut message.header,)* }
            }

            /// Adds the message to a run's digest.
            pub fn digest(&self, digest: &mut Digest) {
                match self { $(Self::$variant(message) => digest.add($topic, message),)* }
            }
        }

        /// The recorder's ports, one per topic.
        pub struct Inputs {
            $($field: Input<$variant>,)*
        }

        impl Inputs {
            /// Makes them, with large buffers that do not wake.
            ///
            /// # Errors
            /// [`PortError`], as when a topic carries another version of its message.
            pub fn new(node: &Node) -> Result<Self, PortError> {
                Ok(Self { $($field: node.input_with($topic, InputOptions::recorder())?,)* })
            }

            /// Takes every message that waits and hands it to `take`, with how many were lost on its topic so far; how
            /// many there were.
            ///
            /// # Errors
            /// [`PortError::Receive`].
            pub fn drain(&mut self, mut take: impl FnMut(&Recorded, u64)) -> Result<u64, PortError> {
                let mut count = 0;
                $(while self.$field.take()? {
                    let lost = self.$field.lost();
                    if let Some(message) = self.$field.message() {
                        take(&message.into(), lost);
                        count += 1;
                    }
                })*
                Ok(count)
            }

            /// Messages lost at each port: gaps in the sequence numbers.
            pub fn lost(&self) -> PerTopic {
                [$(self.$field.lost(),)*]
            }
        }
    };
}

topics! {
    lidar: LidarFrame on topic::LIDAR;
    observation: Observation on topic::OBSERVATION;
    picture: Picture on topic::PICTURE;
    scene: Scene on topic::SCENE;
    outcome: Outcome on topic::OUTCOME;
    robot_belief: RobotBelief on topic::ROBOT_BELIEF;
    human_belief: HumanBelief on topic::HUMAN_BELIEF;
    comm_action: CommAction on topic::COMM_ACTION;
    display: Display on topic::DISPLAY;
    driver_action: DriverAction on topic::DRIVER_ACTION;
    cockpit: Cockpit on topic::COCKPIT;
    control: Control on topic::CONTROL;
    report: Report on topic::REPORT;
}

impl Inputs {
    /// As [`Inputs::drain`], of what the launcher and the processes tell each other alone: nobody waits until it was
    /// taken.
    ///
    /// # Errors
    /// [`PortError::Receive`].
    pub fn drain_run(&mut self, mut take: impl FnMut(&Recorded, u64)) -> Result<u64, PortError> {
        let mut count = 0;
        while self.control.take()? {
            let lost = self.control.lost();
            if let Some(message) = self.control.message() {
                take(&message.into(), lost);
                count += 1;
            }
        }
        while self.report.take()? {
            let lost = self.report.lost();
            if let Some(message) = self.report.message() {
                take(&message.into(), lost);
                count += 1;
            }
        }
        Ok(count)
    }
}

/// A message from its bytes.
fn read_message<M: Message>(bytes: &[u8]) -> Option<M> {
    // SAFETY: as many bytes as the message has, and messages are plain numbers without padding, for which all bytes are
    // valid.
    (bytes.len() == size_of::<M>())
        .then(|| unsafe { core::ptr::read_unaligned(bytes.as_ptr().cast()) })
}

/// A count per topic, in the order of [`TOPICS`].
pub type PerTopic = [u64; TOPICS.len()];

impl RecordedTopic {
    /// Whether the topic belongs to what a lockstep run repeats byte for byte. `run/control` and `run/report` do not:
    /// they carry operating-system process ids and times; nor does `driver/cockpit`, which says when a person's page
    /// did something.
    pub fn is_repeatable(&self) -> bool {
        ![topic::CONTROL, topic::REPORT, topic::COCKPIT].contains(&self.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_knows_its_topic() {
        let mut display = Display::ZERO;
        display.header.step = 7;
        let recorded = Recorded::from(&display);
        assert_eq!(TOPICS[recorded.topic()].name, "comm/display");
        assert_eq!(recorded.bytes(), display.bytes());
        assert_eq!(recorded.header().step, 7);
        let read = Recorded::from_bytes(recorded.topic(), recorded.bytes());
        assert_eq!(read, Some(recorded));
        assert_eq!(
            Recorded::from_bytes(recorded.topic(), &recorded.bytes()[1..]),
            None
        );
        assert_eq!(Recorded::from_bytes(TOPICS.len(), recorded.bytes()), None);
    }
}
