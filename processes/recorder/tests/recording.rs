//! What a recording promises: readers that we did not write find every message in it, with every value.

mod common;

use common::{STEP_NS, about, known, step_messages, values};
use messages::{CommAction, Display, DriverAction, LidarFrame, Outcome, RobotBelief, Scene};
use recorder::body::Body;
use recorder::parts::part_path;
use recorder::queue::{Queue, WhenFull};
use recorder::recording::{METADATA, Recording, RecordingError};
use recorder::topics::{Recorded, TOPICS};
use recorder::visual::RoadLine;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{SystemTime, UNIX_EPOCH};

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
        let (topic, mut memory) = (&TOPICS[sent.topic()], Vec::new());
        let body = Body::of((topic.fields)());
        assert_eq!(body.read(&read.data, &mut memory), Ok(()));
        assert_eq!(memory, sent.bytes());
        let elapsed_ns = u64::from(sent.header().step) * STEP_NS;
        assert_eq!(read.log_time, ours[0].log_time + elapsed_ns);
        assert_eq!(read.publish_time, read.log_time);
    }
}

fn is_derived(topic: &str) -> bool {
    topic.starts_with("/viz/") || ["/tf", "/clock"].contains(&topic)
}

/// Log times of a whole file in the file's order, by topic.
fn times(path: &Path) -> Vec<(String, u64)> {
    let bytes = std::fs::read(path).expect("the recording");
    let messages = mcap::MessageStream::new(&bytes).expect("sound");
    let times = messages.map(|message| {
        let message = message.expect("sound");
        assert_eq!(message.publish_time, message.log_time);
        (message.channel.topic.clone(), message.log_time)
    });
    times.collect()
}

/// What a set sends from `from` to `to`, as a recorder receives it that was kept waiting: topic after topic.
fn batch(episode: u32, from: u32, to: u32) -> Vec<Recorded> {
    let in_episode = |mut message: Recorded| {
        message.header_mut().episode = episode;
        // A fast machine: a thousand steps a second.
        message.header_mut().sent_ns =
            5_000_000_000 + u64::from(episode * 1000 + message.header().step) * 1_000_000;
        message
    };
    let mut batch: Vec<Recorded> = Vec::new();
    let steps = || from..to;
    batch.extend(steps().map(|step| Recorded::from(&known::<LidarFrame>(step, 0))));
    batch.extend(steps().map(|step| Recorded::from(&known::<Scene>(step, 1))));
    batch.extend(steps().map(|step| Recorded::from(&known::<Outcome>(step + 1, 2))));
    batch.extend(steps().map(|step| Recorded::from(&known::<RobotBelief>(step, 3))));
    batch.extend(steps().map(|step| Recorded::from(&known::<CommAction>(step + 1, 5))));
    batch.extend(steps().map(|step| Recorded::from(&known::<Display>(step, 6))));
    batch.extend(steps().map(|step| Recorded::from(&known::<DriverAction>(step, 7))));
    batch.into_iter().map(in_episode).collect()
}

/// Two episodes of 145 and 50 steps, as [`batch`]es.
fn drive() -> Vec<Recorded> {
    let mut messages = Vec::new();
    for from in (0..144).step_by(36) {
        messages.extend(batch(0, from, from + 36));
    }
    messages.extend(batch(1, 0, 50));
    messages
}

#[test]
fn a_recording_plays_as_long_as_the_drive_took_from_today_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.mcap");
    let since_1970 = || {
        SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .expect("a clock")
    };
    let before = since_1970().as_nanos() as u64;
    assert!(write(&path, &drive()).is_complete());
    let times = times(&path);
    let (first, last) = (times[0].1, times[times.len() - 1].1);
    assert!((before..since_1970().as_nanos() as u64).contains(&first));
    // 144 steps to the end of the first episode, one to the next, 50 to its end: 29.25 s, in which 0.2 s went by.
    assert_eq!(last - first, (144 + 1 + 50) * STEP_NS);
    // The clock ticks once a step.
    let clock: Vec<u64> = times
        .iter()
        .filter(|(topic, _)| topic == "/clock")
        .map(|(_, time)| *time)
        .collect();
    let expected = (0..=144 + 1 + 50).map(|step| first + step * STEP_NS);
    assert_eq!(clock, expected.collect::<Vec<_>>());
}

/// What is checked by `mcap doctor`, too, and asked for by readers that take chunks one after the other.
#[test]
fn messages_chunks_and_index_are_in_the_order_of_the_drive() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.mcap");
    let messages = drive();
    assert!(write(&path, &messages).is_complete());
    let times = times(&path);
    assert!(times.is_sorted_by_key(|(_, time)| *time));
    // What is drawn stands beside what it is drawn from.
    let markers = times.iter().filter(|(topic, _)| topic == "/viz/markers");
    let scenes = drive().len() / 7;
    assert!(markers.count() >= 2 * scenes);

    let bytes = std::fs::read(&path).expect("the recording");
    let summary = mcap::Summary::read(&bytes)
        .expect("sound")
        .expect("an index");
    let stats = summary.stats.as_ref().expect("statistics");
    assert_eq!(stats.message_count, times.len() as u64);
    assert_eq!(stats.message_start_time, times[0].1);
    assert_eq!(stats.message_end_time, times[times.len() - 1].1);
    let mut counts = BTreeMap::new();
    for (topic, _) in &times {
        *counts.entry(topic.as_str()).or_insert(0) += 1;
    }
    for (channel, count) in &stats.channel_message_counts {
        let topic = summary.channels[channel].topic.as_str();
        assert_eq!(counts.get(topic).copied().unwrap_or(0), *count, "{topic}");
    }
    assert_eq!(stats.chunk_count as usize, summary.chunk_indexes.len());
    let with_messages = summary
        .chunk_indexes
        .iter()
        .filter(|c| c.message_end_time > 0);
    let chunks: Vec<_> = with_messages.collect();
    assert!(
        chunks.len() > 3,
        "one chunk only: order between chunks is not exercised"
    );
    for pair in chunks.windows(2) {
        assert!(pair[0].message_end_time <= pair[1].message_start_time);
    }
    for chunk in chunks {
        for (channel, entries) in summary.read_message_indexes(&bytes, chunk).expect("sound") {
            let topic = &channel.topic;
            assert!(entries.is_sorted_by_key(|entry| entry.log_time), "{topic}");
            for entry in entries {
                let message = summary.seek_message(&bytes, chunk, &entry).expect("sound");
                assert_eq!(
                    (&message.channel.topic, message.log_time),
                    (topic, entry.log_time)
                );
            }
        }
    }
}

#[test]
fn what_is_sent_once_says_so_and_is_sent_in_every_part() {
    let folder = tempfile::tempdir().expect("a folder");
    let first = folder.path().join("drive.mcap");
    let second = part_path(&first, 2);
    assert!(write(&first, &batch(0, 0, 40)).is_complete());
    let mut recording = Recording::create(&second, &about(), &road()).expect("ours");
    let anchor = recorder::read::end_of(&first).expect("it has steps");
    assert_eq!((anchor.episode, anchor.step), (0, 40));
    recording.go_on_from(anchor);
    for message in batch(0, 45, 60) {
        recording.write(&message);
    }
    assert!(recording.finish(&Default::default()).is_complete());
    let (before, after) = (times(&first), times(&second));
    for part in [&before, &after] {
        let roads = part.iter().filter(|(topic, _)| topic == "/viz/road");
        assert_eq!(roads.count(), 1);
    }
    // Five steps were lost between the parts; time went on.
    assert_eq!(after[0].1, before[0].1 + 45 * STEP_NS);

    let bytes = std::fs::read(&second).expect("the recording");
    let summary = mcap::Summary::read(&bytes)
        .expect("sound")
        .expect("an index");
    for channel in summary.channels.values() {
        let qos = &channel.metadata["offered_qos_profiles"];
        let durability = match channel.topic.as_str() {
            "/viz/road" => "\n  durability: 1\n", // transient local
            _ => "\n  durability: 2\n",
        };
        assert!(qos.contains(durability), "{}: {qos}", channel.topic);
    }
}

#[test]
fn pythons_ros2_reader_decodes_every_message_to_the_values_sent() {
    let Some(python) = python() else {
        testing::skipped(
            "pythons_ros2_reader_decodes_every_message_to_the_values_sent",
            "no Python into which mcap and mcap-ros2-support could be installed",
        );
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let (path, expected) = (
        folder.path().join("drive.mcap"),
        folder.path().join("sent.jsonl"),
    );
    let messages: Vec<_> = (0..12).flat_map(step_messages).collect();
    assert!(write(&path, &messages).is_complete());
    let start_ns = times(&path)[0].1;
    let lines: Vec<String> = messages
        .iter()
        .map(|message| {
            let time_ns = start_ns + u64::from(message.header().step) * STEP_NS;
            json!({
                "topic": format!("/{}", TOPICS[message.topic()].name),
                "log_time": time_ns,
                "publish_time": time_ns,
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
        text.contains("156 messages of 13 topics equal what was sent"),
        "{text}"
    );
}

fn python() -> Option<PathBuf> {
    testing::python(
        Path::new(env!("CARGO_TARGET_TMPDIR")),
        "python",
        &["mcap>=1.2", "mcap-ros2-support>=0.5"],
        "import mcap.reader, mcap_ros2.decoder",
    )
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
