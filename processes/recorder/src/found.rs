//! What is found in a recording besides its messages, and why one cannot be read.

use crate::setup::{self, Setup};
use crate::topics::{PerTopic, TOPICS};
use std::collections::BTreeMap;
use std::io;
use std::path::PathBuf;

/// Why a recording cannot be read at all.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file cannot be opened or read.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// It does not begin as MCAP files do.
    #[error("{}: byte 0: not an MCAP recording", path.display())]
    NotMcap {
        /// The file.
        path: PathBuf,
    },
    /// A topic carries another version of its message.
    #[error("{}: byte {byte}: /{topic} carries another version of its message: {difference}", path.display())]
    Version {
        /// The file.
        path: PathBuf,
        /// Where the record that says so begins.
        byte: u64,
        /// The topic.
        topic: &'static str,
        /// What differs.
        difference: String,
    },
    /// What the run was set up from cannot be understood.
    #[error("{}: byte {byte}: metadata \"{}\": {reason}", path.display(), setup::METADATA)]
    Setup {
        /// The file.
        path: PathBuf,
        /// Where the record begins.
        byte: u64,
        /// What is wrong.
        reason: String,
    },
}

/// How a file ends.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Ending {
    /// As it should.
    #[default]
    Closed,
    /// Before its end mark: the recorder was killed, or the file was cut.
    Cut {
        /// Where the record begins that is not whole, or where the file ends.
        byte: u64,
        /// What is there.
        why: String,
    },
}

impl core::fmt::Display for Ending {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Closed => write!(f, "closed"),
            Self::Cut { byte, why } => write!(f, "cut short at byte {byte}: {why}"),
        }
    }
}

/// Bytes of a file that are not what was written there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// Where the record begins that they stand in.
    pub byte: u64,
    /// What is wrong with it.
    pub why: String,
}

impl core::fmt::Display for Damage {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "damaged at byte {}: {}", self.byte, self.why)
    }
}

/// What was found in a file besides its messages.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// Identity of the run, from the file's head.
    pub run_id: Option<u64>,
    /// What the run was set up from; recordings of earlier versions do not say.
    pub setup: Option<Setup>,
    /// The head's other entries: scene, human, planner, seed, version.
    pub about: BTreeMap<String, String>,
    /// Files that travel with the recording, by name.
    pub attachments: BTreeMap<String, Vec<u8>>,
    /// The closing metadata: what was written and lost. Absent from a file that was not closed.
    pub closing: Option<BTreeMap<String, String>>,
    /// Which topics the file has a channel for, in the order of [`TOPICS`].
    pub channels: [bool; TOPICS.len()],
    /// Messages read, by topic.
    pub messages: PerTopic,
    /// What was passed over because it is damaged, in order.
    pub damage: Vec<Damage>,
    /// How the file ends.
    pub ending: Ending,
}

impl Found {
    /// Messages that were written to the file, as its closing metadata counts them, and are not in it any more.
    pub fn gone(&self) -> u64 {
        let Some(closing) = &self.closing else {
            return 0;
        };
        let gone = TOPICS.iter().zip(self.messages).map(|(topic, read)| {
            let written = closing.get(&format!("written {}", topic.name));
            let written = written.and_then(|count| count.parse::<u64>().ok());
            written.unwrap_or(0).saturating_sub(read)
        });
        gone.sum()
    }

    /// Whether the file has all that was sent, as far as it can tell.
    pub fn is_complete(&self) -> bool {
        let closing = self.closing.as_ref();
        let says_so = closing.is_some_and(|closing| {
            // A recording made elsewhere need not say anything.
            closing.get("complete").is_none_or(|word| word == "true")
        });
        says_so && self.damage.is_empty() && self.ending == Ending::Closed && self.gone() == 0
    }

    /// Messages lost before they reached the file, as its closing metadata counts them; none where it has no such.
    pub fn counted_lost(&self) -> Option<u64> {
        let closing = self.closing.as_ref()?;
        let lost = closing.iter().filter(|(key, _)| key.starts_with("lost "));
        Some(
            lost.filter_map(|(_, value)| value.parse::<u64>().ok())
                .sum(),
        )
    }
}
