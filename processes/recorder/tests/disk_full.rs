//! A disk that takes no more: the run goes on, every loss is counted, and what there is can still be read.
//! Alone in its executable, because the limit that stands for the disk holds for the whole process.

mod common;

use common::{about, step_messages};
use recorder::read::read;
use recorder::recording::{METADATA, Recording};
use recorder::topics::{Recorded, TOPICS};
use std::path::Path;

const LIMIT: u64 = 300_000;
const STEPS: u32 = 1200;

/// Makes the system refuse to let files grow past `bytes`, with an error instead of a signal.
fn limit_file_size(bytes: u64) {
    // SAFETY: both calls take plain values and change only this process.
    unsafe {
        libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
        let limit = libc::rlimit {
            rlim_cur: bytes,
            rlim_max: libc::RLIM_INFINITY,
        };
        assert_eq!(libc::setrlimit(libc::RLIMIT_FSIZE, &limit), 0);
    }
}

#[test]
fn a_full_disk_ends_the_recording_but_not_the_run() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.mcap");
    let mut recording = Recording::create(&path, &about(), &[]).expect("the folder is ours");
    limit_file_size(LIMIT);
    let mut sent = Vec::new();
    for message in (0..STEPS).flat_map(step_messages) {
        recording.write(&message);
        sent.push(message);
    }
    let error = recording.error().expect("the limit was reached").to_owned();
    assert!(error.contains("drive.mcap"), "{error}");
    assert!(error.contains("may not grow any further"), "{error}");
    let outcome = recording.finish(&Default::default());

    assert!(!outcome.is_complete());
    assert_eq!(outcome.error.as_deref(), Some(error.as_str()));
    for topic in 0..TOPICS.len() {
        assert_eq!(
            outcome.written[topic] + outcome.lost.disk[topic],
            u64::from(STEPS)
        );
        assert!(outcome.written[topic] > 0 && outcome.lost.disk[topic] > 0);
    }
    let bytes = std::fs::read(&path).expect("the recording");
    assert!(bytes.len() as u64 <= LIMIT);
    assert_is_sound_to_the_end(&bytes);
    let kept = kept(&path);
    assert_eq!(kept.len() as u64, outcome.written.iter().sum::<u64>());
    assert_eq!(kept[..], sent[..kept.len()]);
    // Where the recording ends is said, and is where it ends.
    let steps = kept.iter().map(|message| message.header().step);
    let last = steps.max().expect("a step");
    let end = format!("it ends after episode 0 step {last}");
    assert!(error.ends_with(&end), "{error}: not {end}");
    let metadata = metadata(&bytes);
    assert_eq!(metadata["complete"], "false");
    assert_eq!(
        metadata["lost world/scene"],
        outcome.lost.disk[topic_of("world/scene")].to_string()
    );
}

/// Our own topics' messages.
fn kept(path: &Path) -> Vec<Recorded> {
    let mut kept = Vec::new();
    read(path, |message| kept.push(*message)).expect("sound");
    kept
}

/// The reader fails where the file does not end as a file of its format must.
fn assert_is_sound_to_the_end(bytes: &[u8]) {
    for message in mcap::MessageStream::new(bytes).expect("a sound head") {
        message.expect("sound to the end");
    }
}

fn metadata(bytes: &[u8]) -> std::collections::BTreeMap<String, String> {
    let mut found = None;
    for record in mcap::read::LinearReader::new(bytes).expect("a sound head") {
        if let mcap::records::Record::Metadata(metadata) = record.expect("sound to the end")
            && metadata.name == METADATA
        {
            found = Some(metadata.metadata);
        }
    }
    found.expect("closing metadata")
}

fn topic_of(name: &str) -> usize {
    TOPICS
        .iter()
        .position(|topic| topic.name == name)
        .expect("a topic")
}
