//! A run's digest: the same for two runs that sent the same things, however fast and in whatever interleaving.

use messages::{Header, Message};
use std::collections::BTreeMap;

/// Hashes messages per topic in the order of their arrival, and the topics together by name. Left out is what differs
/// between equal runs: run id and times in the header. Sequence, episode and step stay.
#[derive(Clone, Default)]
pub struct Digest {
    topics: BTreeMap<&'static str, (blake3::Hasher, u64)>,
}

impl Digest {
    /// A digest of nothing.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a message.
    pub fn add<M: Message>(&mut self, topic: &'static str, message: &M) {
        let (hasher, count) = self.topics.entry(topic).or_default();
        *count += 1;
        let bytes = message.bytes();
        match message.header() {
            Some(header) => {
                // `message!` puts the header first.
                hasher.update(&header.sequence.to_le_bytes());
                hasher.update(&header.episode.to_le_bytes());
                hasher.update(&header.step.to_le_bytes());
                hasher.update(&bytes[size_of::<Header>()..]);
            }
            None => {
                hasher.update(bytes);
            }
        }
    }

    /// Messages added so far.
    pub fn count(&self) -> u64 {
        self.topics.values().map(|(_, count)| count).sum()
    }

    /// The digest of everything added so far.
    pub fn finish(&self) -> [u8; 32] {
        let mut all = blake3::Hasher::new();
        for (topic, (hasher, count)) in &self.topics {
            all.update(&(topic.len() as u64).to_le_bytes());
            all.update(topic.as_bytes());
            all.update(&count.to_le_bytes());
            all.update(hasher.finalize().as_bytes());
        }
        *all.finalize().as_bytes()
    }

    /// [`Digest::finish`] as 64 hexadecimal digits.
    pub fn hex(&self) -> String {
        blake3::Hash::from_bytes(self.finish()).to_hex().to_string()
    }
}
