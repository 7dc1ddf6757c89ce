//! Where a recorder writes: `drive.mcap`, or behind a recorder of the same run that was killed or replaced,
//! `drive.part2.mcap`, `drive.part3.mcap` …
//!
//! A part belongs to a run if the run's identity stands at its head. What a restarted recorder finds of its own run it
//! leaves as it is and goes on in the next part; what it finds of another run it sets aside ([`files::set_aside`]).

use crate::read::{Found, ReadError, read, run_of};
use crate::topics::{PerTopic, Recorded, TOPICS};
use std::path::{Path, PathBuf};

/// The path of a part, counted from 1: the first is the recording's own path.
pub fn part_path(path: &Path, part: usize) -> PathBuf {
    if part <= 1 {
        return path.to_owned();
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let name = match path.extension() {
        Some(extension) => format!("{stem}.part{part}.{}", extension.to_string_lossy()),
        None => format!("{stem}.part{part}"),
    };
    path.with_file_name(name)
}

/// The parts of a run's recording that there are, in order.
pub fn parts_of(path: &Path, run_id: u64) -> Vec<PathBuf> {
    (1..)
        .map(|part| part_path(path, part))
        .take_while(|part| run_of(part) == Some(run_id))
        .collect()
}

/// Reads parts one after the other, and passes over what an earlier one has already: a recorder that takes over from
/// another listens beside it for a while. What was found in each part.
///
/// # Errors
/// As [`read`].
pub fn read_parts(
    parts: &[PathBuf],
    mut visit: impl FnMut(&Recorded),
) -> Result<Vec<Found>, ReadError> {
    let mut last_sent_ns: PerTopic = [0; TOPICS.len()];
    let read_next = |part: &PathBuf| {
        let before = last_sent_ns;
        read(part, |message| {
            let (topic, sent_ns) = (message.topic(), message.header().sent_ns);
            // Several senders share the other topics, each with its own time.
            if TOPICS[topic].is_repeatable() && sent_ns <= before[topic] {
                return;
            }
            last_sent_ns[topic] = last_sent_ns[topic].max(sent_ns);
            visit(message);
        })
    };
    parts.iter().map(read_next).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_is_named_after_the_first() {
        let path = |part| part_path(Path::new("/tmp/a.b/drive.mcap"), part);
        assert_eq!(path(1), Path::new("/tmp/a.b/drive.mcap"));
        assert_eq!(path(2), Path::new("/tmp/a.b/drive.part2.mcap"));
        assert_eq!(part_path(Path::new("drive"), 3), Path::new("drive.part3"));
    }

    #[test]
    fn nothing_is_no_part() {
        assert!(parts_of(Path::new("/nowhere/drive.mcap"), 1).is_empty());
    }
}
