//! What became of a recording: how many messages it has and lacks, and the metadata that says so at its end.

use crate::setup::About;
use crate::topics::{PerTopic, TOPICS};
use mcap::records::Metadata;

/// Name of the metadata record that closes a recording.
pub const METADATA: &str = "mirror";

/// Messages that never reached the recording, by topic.
#[derive(Clone, Copy, Debug, Default)]
pub struct Lost {
    /// Gaps in the sequence numbers at the recorder's ports.
    pub ports: PerTopic,
    /// Dropped because the writer fell behind.
    pub queue: PerTopic,
    /// Dropped because the file could not take them.
    pub disk: PerTopic,
    /// Sent between the last chunk of a recorder that was killed and the start of the one that took its place.
    pub restart: PerTopic,
}

impl Lost {
    /// All losses of each topic.
    pub fn by_topic(&self) -> PerTopic {
        core::array::from_fn(|topic| {
            self.ports[topic] + self.queue[topic] + self.disk[topic] + self.restart[topic]
        })
    }

    /// All losses.
    pub fn total(&self) -> u64 {
        self.by_topic().iter().sum()
    }
}

/// What became of a recording.
#[derive(Clone, Debug, Default)]
pub struct Written {
    /// Messages in the file, by topic.
    pub written: PerTopic,
    /// Messages that are not.
    pub lost: Lost,
    /// Why writing ended early, if it did.
    pub error: Option<String>,
}

impl Written {
    /// Whether the file has every message that was sent.
    pub fn is_complete(&self) -> bool {
        self.error.is_none() && self.lost.total() == 0
    }
}

/// The record that closes a recording.
pub fn metadata(about: &About, outcome: &Written) -> Metadata {
    let mut entries = about.entries();
    entries.insert("complete".to_owned(), outcome.is_complete().to_string());
    let lost = outcome.lost.by_topic();
    for (index, topic) in TOPICS.iter().enumerate() {
        entries.insert(
            format!("written {}", topic.name),
            outcome.written[index].to_string(),
        );
        entries.insert(format!("lost {}", topic.name), lost[index].to_string());
    }
    if let Some(error) = &outcome.error {
        entries.insert("error".to_owned(), error.clone());
    }
    Metadata {
        name: METADATA.to_owned(),
        metadata: entries,
    }
}
