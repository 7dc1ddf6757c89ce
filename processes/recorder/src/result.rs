//! What the recorder tells the launcher at its end, as a JSON file: counts, losses, the digest.

use crate::recording::{Lost, Written};
use crate::topics::{PerTopic, TOPICS};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

/// Counts of one topic.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct TopicResult {
    /// Messages that reached the recorder; of a recorder that was killed before, those in its part of the file.
    pub received: u64,
    /// Messages in the file, all its parts together.
    pub written: u64,
    /// Messages that were sent and did not reach the recorder.
    pub lost_ports: u64,
    /// Messages dropped because the writer fell behind.
    pub lost_queue: u64,
    /// Messages dropped because the file could not take them.
    pub lost_disk: u64,
    /// Messages sent between the last chunk of a recorder that was killed and the start of the one after it.
    pub lost_restart: u64,
}

impl TopicResult {
    /// All messages of the topic that are missing.
    pub fn lost(&self) -> u64 {
        self.lost_ports + self.lost_queue + self.lost_disk + self.lost_restart
    }
}

/// The recorder's result.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecorderResult {
    /// Digest of every message of the repeatable topics, as 64 hexadecimal digits (see
    /// [`Topic::is_repeatable`](crate::topics::Topic::is_repeatable)); empty where some never reached a recorder.
    pub digest: String,
    /// The recording, if one was asked for.
    pub file: Option<PathBuf>,
    /// All files that it consists of: more than one where a recorder was killed or replaced.
    #[serde(default)]
    pub parts: Vec<PathBuf>,
    /// Whether nothing was lost: all that was sent was received and, if there is a file, is in it.
    pub complete: bool,
    /// Why writing ended early, if it did.
    pub error: Option<String>,
    /// By topic name.
    pub topics: BTreeMap<String, TopicResult>,
}

impl RecorderResult {
    /// The result of a run whose messages were counted in `received`, as yet without a digest; `lost` holds what never
    /// reached the recorder; `written` is `None` where no file was asked for.
    pub fn new(received: &PerTopic, lost: &Lost, written: Option<(&Path, &Written)>) -> Self {
        let counts = |topic: usize| {
            let (lost, in_file) = match written {
                Some((_, written)) => (written.lost, written.written[topic]),
                None => (*lost, 0),
            };
            TopicResult {
                received: received[topic],
                written: in_file,
                lost_ports: lost.ports[topic],
                lost_queue: lost.queue[topic],
                lost_disk: lost.disk[topic],
                lost_restart: lost.restart[topic],
            }
        };
        let topics: BTreeMap<_, _> = TOPICS
            .iter()
            .enumerate()
            .map(|(index, topic)| (topic.name.to_owned(), counts(index)))
            .collect();
        let error = written.and_then(|(_, written)| written.error.clone());
        Self {
            digest: String::new(),
            file: written.map(|(path, _)| path.to_owned()),
            parts: written
                .map(|(path, _)| path.to_owned())
                .into_iter()
                .collect(),
            complete: error.is_none() && topics.values().all(|topic| topic.lost() == 0),
            error,
            topics,
        }
    }

    /// Takes in the parts that recorders of the same run wrote before: all of them hold `written` messages together, if
    /// they could be read.
    pub fn join(&mut self, parts: &[PathBuf], written: Option<&PerTopic>) {
        self.file = parts.first().cloned();
        self.parts = parts.to_vec();
        let Some(written) = written else {
            self.complete = false;
            let unreadable = || "an earlier part of the recording cannot be read".to_owned();
            self.error.get_or_insert_with(unreadable);
            return;
        };
        for (topic, written) in TOPICS.iter().zip(written) {
            if let Some(counts) = self.topics.get_mut(topic.name) {
                counts.received = written + counts.lost_queue + counts.lost_disk;
                counts.written = *written;
            }
        }
    }

    /// Writes the result to a file.
    ///
    /// # Errors
    /// The system's, with the file's name.
    pub fn save(&self, path: &Path) -> io::Result<()> {
        let named =
            |error: io::Error| io::Error::new(error.kind(), format!("{}: {error}", path.display()));
        let text = serde_json::to_vec_pretty(self).map_err(io::Error::other);
        text.and_then(|text| std::fs::write(path, text))
            .map_err(named)
    }

    /// Reads what [`Self::save`] wrote.
    ///
    /// # Errors
    /// The system's or the format's, with the file's name and the place in it.
    pub fn load(path: &Path) -> io::Result<Self> {
        let named =
            |error: io::Error| io::Error::new(error.kind(), format!("{}: {error}", path.display()));
        let text = std::fs::read(path).map_err(named)?;
        serde_json::from_slice(&text).map_err(|error| named(io::Error::other(error)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_result_survives_its_file() -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("recorder.json");
        let mut ports = [0; TOPICS.len()];
        let outcome = TOPICS
            .iter()
            .position(|topic| topic.name == "world/outcome");
        ports[outcome.unwrap_or_default()] = 3;
        let lost = Lost {
            ports,
            ..Lost::default()
        };
        let mut result = RecorderResult::new(&[7; TOPICS.len()], &lost, None);
        result.digest = "ab".to_owned();
        assert!(!result.complete);
        assert_eq!(result.topics["world/outcome"].lost(), 3);
        result.save(&path)?;
        assert_eq!(RecorderResult::load(&path)?, result);
        Ok(())
    }

    #[test]
    fn a_broken_file_is_named() -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("recorder.json");
        std::fs::write(&path, "{\"digest\": 3")?;
        let error = RecorderResult::load(&path).expect_err("broken").to_string();
        assert!(
            error.contains("recorder.json") && error.contains("line 1"),
            "{error}"
        );
        Ok(())
    }
}
