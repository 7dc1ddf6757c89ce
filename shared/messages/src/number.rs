//! The numbers with a meaning that messages carry, as enums.
//!
//! A message's field stays a plain `u32`: whatever another program puts there is a number, and none of them makes a
//! Rust value invalid. The message's accessor gives the number its meaning, or says that it has none.

use core::fmt;

/// A number to which a field of a message gives no meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnknownNumber {
    /// What the number should have been, such as `ImaginePhase`.
    pub what: &'static str,
    /// The number.
    pub number: u32,
}

impl fmt::Display for UnknownNumber {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{} {} has no meaning", self.what, self.number)
    }
}

impl std::error::Error for UnknownNumber {}

/// An enum of numbers, described for those who write it in another language.
#[derive(Clone, Copy, Debug)]
pub struct Numbers {
    /// The enum's name, in Rust and in Python.
    pub name: &'static str,
    /// What it is, as its documentation says.
    pub doc: &'static str,
    /// Names in Rust and numbers, in the order of the numbers.
    pub values: &'static [(&'static str, u32)],
}

/// Declares an enum of numbers on the wire.
macro_rules! numbers {
    ($($(#[doc = $doc:literal])* pub enum $name:ident {
        $($(#[doc = $value_doc:literal])* $value:ident = $number:literal,)*
    })*) => {
        $(
            $(#[doc = $doc])*
            #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
            #[repr(u32)]
            pub enum $name {
                $($(#[doc = $value_doc])* $value = $number,)*
            }

            impl $name {
                /// The meaning of a message's number.
                ///
                /// # Errors
                /// [`UnknownNumber`] if it has none.
                pub const fn from_wire(number: u32) -> Result<Self, UnknownNumber> {
                    match number {
                        $($number => Ok(Self::$value),)*
                        _ => Err(UnknownNumber { what: stringify!($name), number }),
                    }
                }

                /// The number that messages carry.
                pub const fn wire(self) -> u32 {
                    self as u32
                }
            }

            impl TryFrom<u32> for $name {
                type Error = UnknownNumber;

                fn try_from(number: u32) -> Result<Self, UnknownNumber> {
                    Self::from_wire(number)
                }
            }

            impl From<$name> for u32 {
                fn from(value: $name) -> u32 {
                    value.wire()
                }
            }
        )*

        /// Every enum of numbers, in the order in which a step uses them.
        pub const NUMBERS: &[Numbers] = &[$(Numbers {
            name: stringify!($name),
            doc: concat!($($doc, "\n"),*),
            values: &[$((stringify!($value), $number),)*],
        },)*];
    };
}

numbers! {
    /// A domain.
    pub enum DomainNumber {
        /// The highway.
        Highway = 0,
        /// Gridworld driving.
        Driving = 1,
        /// Search and rescue.
        SearchRescue = 2,
        /// Bomb defusal.
        BombDefusal = 3,
    }

    /// What an object on the highway is.
    pub enum ObjectKind {
        /// A car.
        Car = 0,
        /// Something taller, such as a lorry.
        Other = 1,
    }

    /// Whether an episode goes on, and how it ended.
    pub enum EpisodeEnd {
        /// It goes on.
        Running = 0,
        /// The goal is reached.
        Goal = 1,
        /// A collision.
        Collision = 2,
        /// Out of time.
        OutOfTime = 3,
        /// The person at the wheel went away and did not come back: the round does not count.
        Voided = 4,
    }

    /// Whether a person is at the wheel.
    pub enum Presence {
        /// Nobody is: the world stands still.
        Absent = 0,
        /// Somebody is.
        Present = 1,
        /// Nobody has been for so long that the round is given up.
        GivenUp = 2,
    }

    /// What a cockpit tells.
    pub enum CockpitEvent {
        /// How old the input is, once a step, and whether somebody is there, whenever that changes.
        Presence = 0,
        /// A sentence begins to be heard.
        Heard = 1,
        /// A sentence was not played: the page has no sound.
        Unheard = 2,
        /// A display is seen for the first time.
        Seen = 3,
    }

    /// How a decision came about.
    pub enum DecisionReason {
        /// It was planned.
        Planned = 0,
        /// There is no planner: nothing is ever communicated.
        NoPlanner = 1,
        /// The human model gave no answer: nothing was decided.
        HumanSilent = 2,
        /// It was planned, but came after its step had begun.
        Late = 3,
    }

    /// What an utterance says.
    pub enum UtteranceContent {
        /// Highway: no car is in the sector.
        Nothing = 0,
        /// Highway: the nearest car in the sector is slow.
        Slow = 1,
        /// Highway: the nearest car in the sector is fast.
        Fast = 2,
        /// Gridworlds: what the text says.
        InWords = 3,
        /// The text is about the assistant itself, and about no item.
        Notice = 4,
    }

    /// What a question to the human model asks.
    pub enum ImaginePhase {
        /// Start a group from the current belief, and act.
        Start = 0,
        /// Perceive what is imagined, then act.
        Perceive = 1,
        /// Forget the group.
        Forget = 2,
        /// Without a group: how far from the robot's belief would the person's be, had they perceived what is imagined?
        Compare = 3,
    }

    /// How the human model answered.
    pub enum ImagineStatus {
        /// As asked.
        Answered = 0,
        /// It has no belief for that step.
        NoBelief = 1,
        /// It has no such group.
        NoGroup = 2,
        /// Its belief cannot be compared with the robot's.
        Incomparable = 3,
    }

    /// What the launcher asks of a process.
    pub enum ControlCommand {
        /// Start.
        Start = 1,
        /// End.
        Stop = 2,
        /// Send from the header's episode and step on, and start if not started.
        TakeOver = 3,
        /// Send a report.
        Report = 4,
        /// Connect to who joined.
        Connect = 5,
        /// Be silent from the header's episode and step on.
        HandOver = 6,
    }

    /// Why a process reports.
    pub enum ProcessState {
        /// All ports stand.
        Ready = 1,
        /// An answer to the launcher's question, or a line for people.
        Running = 2,
        /// The run ended well.
        Finished = 3,
        /// The process cannot go on.
        Failed = 4,
        /// It is on standby and knows enough to take over.
        CaughtUp = 5,
        /// It will take over, or hand over, at the step that it was given.
        HandoverAgreed = 6,
        /// That step has passed already.
        TooLate = 7,
        /// It has come to the step from which on it is silent; only those say so that hand over between two episodes.
        Retired = 8,
    }
}
