//! What a recording promises: readers that we did not write find every message in it, with every value.

mod common;

use common::{about, step_messages, values};
use recorder::queue::{Queue, WhenFull};
use recorder::recording::{METADATA, Recording, RecordingError};
use recorder::topics::{Recorded, TOPICS};
use recorder::visual::RoadLine;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

const STEPS: u32 = 120;

fn road() -> Vec<RoadLine> {
    let line = |y: f64, dashed| RoadLine {
        points_m: (0..10).map(|x| [f64::from(x), y]).collect(),
        dashed,
    };
    vec![line(-3.5, false), line(0.0, true), line(3.5, false)]
}

fn write(path: &Path, messages: &[Recorded]) -> recorder::recording::Written {
    let recording = Recording::create(path, &about(), &road()).expect("the folder is ours");
    let mut queue = Queue::start(recording, WhenFull::Grow, 8).expect("a thread");
    for message in messages {
        queue.push(message);
    }
    queue.finish(&[0; TOPICS.len()], &[0; TOPICS.len()])
}

fn all_messages() -> Vec<Recorded> {
    (0..STEPS).flat_map(step_messages).collect()
}

/// The closing metadata, as the Rust reader finds it through the index.
fn closing_metadata(bytes: &[u8]) -> BTreeMap<String, String> {
    let summary = mcap::Summary::read(bytes)
        .expect("a sound file")
        .expect("an index");
    // The head's comes first.
    assert_eq!(summary.metadata_indexes.len(), 2);
    let metadata = mcap::read::metadata(bytes, &summary.metadata_indexes[1]).expect("metadata");
    assert_eq!(metadata.name, METADATA);
    metadata.metadata
}

#[test]
fn the_rust_reader_finds_every_message_byte_for_byte() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.mcap");
    let messages = all_messages();
    let written = write(&path, &messages);
    assert!(written.is_complete(), "{written:?}");
    assert_eq!(written.written, [u64::from(STEPS); TOPICS.len()]);

    let bytes = std::fs::read(&path).expect("the recording");
    let metadata = closing_metadata(&bytes);
    assert_eq!(metadata["complete"], "true");
    assert_eq!(metadata["planner"], "ce");
    assert_eq!(metadata["written world/lidar"], STEPS.to_string());
    let summary = mcap::Summary::read(&bytes)
        .expect("sound")
        .expect("an index");
    assert!(
        summary.chunk_indexes.len() > 3,
        "one chunk only: chunking is not exercised"
    );
    assert!(
        summary
            .chunk_indexes
            .iter()
            .all(|chunk| chunk.compression == "zstd")
    );

    let ours: Vec<_> = mcap::MessageStream::new(&bytes)
        .expect("sound")
        .map(|message| message.expect("sound"))
        .filter(|message| !is_derived(&message.channel.topic))
        .collect();
    assert_eq!(ours.len(), messages.len());
    for (read, sent) in ours.iter().zip(&messages) {
        assert_eq!(
            read.channel.topic,
            format!("/{}", TOPICS[sent.topic()].name)
        );
        assert_eq!(&read.data[..4], [0, 1, 0, 0]);
        assert_eq!(&read.data[4..], sent.bytes());
        assert_eq!(read.log_time, sent.header().sent_ns);
        assert_eq!(read.publish_time, sent.header().cause_ns);
    }
}

fn is_derived(topic: &str) -> bool {
    topic.starts_with("/viz/") || topic == "/tf"
}

#[test]
fn pythons_ros2_reader_decodes_every_message_to_the_values_sent() {
    let Some(python) = python() else {
        eprintln!("skipped: no Python with mcap and mcap-ros2-support (MIRROR_PYTHON, python3)");
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let (path, expected) = (
        folder.path().join("drive.mcap"),
        folder.path().join("sent.jsonl"),
    );
    let messages: Vec<_> = (0..12).flat_map(step_messages).collect();
    assert!(write(&path, &messages).is_complete());
    let lines: Vec<String> = messages
        .iter()
        .map(|message| {
            json!({
                "topic": format!("/{}", TOPICS[message.topic()].name),
                "log_time": message.header().sent_ns,
                "publish_time": message.header().cause_ns,
                "values": values(message),
            })
            .to_string()
        })
        .collect();
    std::fs::write(&expected, lines.join("\n")).expect("our folder");
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/read_recording.py");
    let output = Command::new(&python)
        .arg(script)
        .arg(&path)
        .arg(&expected)
        .output();
    let output = output.expect("Python ran a moment ago");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(
        output.status.success(),
        "{text}\n{}",
        String::from_utf8_lossy(&output.stderr)
    );
    assert!(
        text.contains("144 messages of 12 topics equal what was sent"),
        "{text}"
    );
}

fn python() -> Option<String> {
    let candidates = [
        std::env::var("MIRROR_PYTHON").ok(),
        Some("python3".to_owned()),
    ];
    candidates.into_iter().flatten().find(|python| {
        let check = Command::new(python)
            .args(["-c", "import mcap, mcap_ros2.decoder"])
            .output();
        check.is_ok_and(|output| output.status.success())
    })
}

#[test]
fn losses_mark_the_recording_incomplete() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.mcap");
    let recording = Recording::create(&path, &about(), &[]).expect("the folder is ours");
    let mut queue = Queue::start(recording, WhenFull::Drop, 64).expect("a thread");
    for message in step_messages(0) {
        queue.push(&message);
    }
    let mut ports = [0; TOPICS.len()];
    let belief = TOPICS.iter().position(|topic| topic.name == "belief/robot");
    ports[belief.expect("it is recorded")] = 5;
    let written = queue.finish(&ports, &[0; TOPICS.len()]);
    assert!(!written.is_complete());
    assert_eq!(written.lost.total(), 5);
    let metadata = closing_metadata(&std::fs::read(&path).expect("the recording"));
    assert_eq!(metadata["complete"], "false");
    assert_eq!(metadata["lost belief/robot"], "5");
}

#[test]
fn a_queue_without_blocks_counts_every_message() {
    let folder = tempfile::tempdir().expect("a folder");
    let recording = Recording::create(&folder.path().join("drive.mcap"), &about(), &[]);
    let recording = recording.expect("the folder is ours");
    let mut queue = Queue::start(recording, WhenFull::Drop, 0).expect("a thread");
    for message in all_messages() {
        queue.push(&message);
    }
    let written = queue.finish(&[0; TOPICS.len()], &[0; TOPICS.len()]);
    assert_eq!(written.lost.queue, [u64::from(STEPS); TOPICS.len()]);
    assert_eq!(written.written, [0; TOPICS.len()]);
    assert!(!written.is_complete());
}

#[test]
fn a_path_that_cannot_be_written_is_named() {
    let path = Path::new("/nowhere/at/all/drive.mcap");
    let Err(error) = Recording::create(path, &about(), &[]) else {
        panic!("created a file in a folder that does not exist");
    };
    assert!(matches!(error, RecordingError::Create { .. }));
    assert!(
        error.to_string().contains("/nowhere/at/all/drive.mcap"),
        "{error}"
    );
}
