//! Reading recordings back: whole, cut anywhere, damaged, of another version, or of random bytes.

mod common;

use common::{about, step_messages};
use proptest::prelude::*;
use recorder::queue::{Queue, WhenFull};
use recorder::read::{Ending, Found, ReadError, read, run_of};
use recorder::recording::{About, Recording};
use recorder::setup::{ModelFile, SCHEMA, Setup};
use recorder::topics::{Recorded, TOPICS};
use std::collections::BTreeMap;
use std::path::Path;

const STEPS: u32 = 100;

fn write(path: &Path, about: &About) -> Vec<Recorded> {
    let messages: Vec<_> = (0..STEPS).flat_map(step_messages).collect();
    let recording = Recording::create(path, about, &[]).expect("the folder is ours");
    let mut queue = Queue::start(recording, WhenFull::Grow, 8).expect("a thread");
    for message in &messages {
        queue.push(message);
    }
    assert!(
        queue
            .finish(&[0; TOPICS.len()], &[0; TOPICS.len()])
            .is_complete()
    );
    messages
}

fn read_all(path: &Path) -> Result<(Found, Vec<Recorded>), ReadError> {
    let mut messages = Vec::new();
    let found = read(path, |message| messages.push(*message))?;
    Ok((found, messages))
}

#[test]
fn everything_that_was_written_is_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, model) = (
        folder.path().join("drive.mcap"),
        folder.path().join("implants"),
    );
    std::fs::write(&model, b"what was learned").expect("a file");
    let mut about = about();
    about.setup = Setup {
        schema: SCHEMA,
        clock: "lockstep".to_owned(),
        driver: "sim:1".to_owned(),
        options: BTreeMap::from([("human".to_owned(), serde_json::json!({"kind": "mirror"}))]),
        files: BTreeMap::from([(
            "implants".to_owned(),
            ModelFile::identify(&model, true).expect("it is there"),
        )]),
        exec: BTreeMap::new(),
    };
    let sent = write(&path, &about);
    std::fs::remove_file(&model).expect("it was ours");
    let (found, messages) = read_all(&path).expect("sound");
    assert_eq!(messages, sent);
    assert_eq!(found.messages, [u64::from(STEPS); TOPICS.len()]);
    assert_eq!(found.ending, Ending::Closed);
    assert_eq!(found.setup, Some(about.setup.clone()));
    assert_eq!(found.run_id, Some(about.run_id));
    assert_eq!(found.about["scene"], about.scene);
    assert_eq!(found.attachments["implants"], b"what was learned");
    let digest = blake3::hash(&found.attachments["implants"]).to_hex();
    assert_eq!(about.setup.files["implants"].blake3, digest.as_str());
    assert_eq!(found.closing.as_ref().expect("closed")["complete"], "true");
    assert_eq!(found.counted_lost(), Some(0));
    assert_eq!(run_of(&path), Some(about.run_id));
}

/// Every length at which a file may end: what is read is a beginning of what was sent, never less for a longer file,
/// and more than the chunks before the cut.
#[test]
fn a_cut_file_is_read_up_to_the_cut() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, cut) = (
        folder.path().join("drive.mcap"),
        folder.path().join("cut.mcap"),
    );
    let sent = write(&path, &about());
    let bytes = std::fs::read(&path).expect("the recording");
    let (mut most, mut beside_chunks) = (0, 0);
    let lengths = (8..bytes.len())
        .step_by(397)
        .chain(bytes.len() - 60..bytes.len());
    for length in lengths {
        std::fs::write(&cut, &bytes[..length]).expect("ours");
        let (found, messages) = read_all(&cut).expect("a beginning is no error");
        assert_eq!(messages, sent[..messages.len()], "cut at {length}");
        assert!(messages.len() >= most, "cut at {length}");
        beside_chunks += usize::from(messages.len() > most);
        most = messages.len();
        let Ending::Cut { byte, why } = found.ending else {
            panic!("cut at {length} of {} and called closed", bytes.len());
        };
        assert!(byte <= length as u64 && !why.is_empty());
    }
    assert_eq!(most, sent.len());
    assert!(
        beside_chunks > 10,
        "only whole chunks were read: {beside_chunks}"
    );
}

/// Where the chunks with messages are: beginning and length.
fn chunks(bytes: &[u8]) -> Vec<(usize, usize)> {
    let summary = mcap::Summary::read(bytes)
        .expect("sound")
        .expect("an index");
    let chunks = summary
        .chunk_indexes
        .iter()
        .filter(|chunk| chunk.message_end_time > 0);
    chunks
        .map(|chunk| {
            (
                chunk.chunk_start_offset as usize,
                chunk.chunk_length as usize,
            )
        })
        .collect()
}

/// Whether `read` is `sent` without one stretch; where that stretch is.
fn stretch(read: &[Recorded], sent: &[Recorded]) -> Option<core::ops::Range<usize>> {
    let before = read.iter().zip(sent).take_while(|(a, b)| a == b).count();
    let missing = sent.len().checked_sub(read.len())?;
    let is_rest = read[before..] == sent[before + missing..];
    is_rest.then_some(before..before + missing)
}

#[test]
fn a_damaged_chunk_is_passed_over_and_the_reading_goes_on_behind_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.mcap");
    let sent = write(&path, &about());
    let sound = std::fs::read(&path).expect("the recording");
    let chunks = chunks(&sound);
    assert!(chunks.len() > 4);
    let (start, length) = chunks[2];
    let middle = start + length / 2;
    // A changed byte; many; a length that leads into another chunk, or past the file's end; no chunk at all.
    let damages: [(usize, &[u8]); 6] = [
        (middle, &[sound[middle] ^ 0x55]),
        (middle, &[7; 300]),
        (start + 3, &[1]),
        (start + 6, &[1]),
        (start, &[0x3f]),
        (start, &[0; 64]),
    ];
    for (place, bytes) in damages {
        let mut damaged = sound.clone();
        damaged[place..][..bytes.len()].copy_from_slice(bytes);
        std::fs::write(&path, &damaged).expect("ours");
        let (found, messages) = read_all(&path).expect("what is around is sound");
        let missing = stretch(&messages, &sent).expect("a stretch is missing and nothing else");
        assert!(missing.start > 0 && missing.end < sent.len() && !missing.is_empty());
        assert!(
            missing.len() < sent.len() / 3,
            "more than a chunk: {missing:?}"
        );
        assert_eq!(found.ending, Ending::Closed);
        assert_eq!(found.gone(), missing.len() as u64);
        assert!(!found.is_complete());
        let damage = &found.damage[0];
        let at = start as u64..=(start + length) as u64;
        assert!(
            at.contains(&damage.byte) && !damage.why.is_empty(),
            "{damage}"
        );
        assert_eq!(run_of(&path), Some(about().run_id));
    }
}

#[test]
fn channels_that_were_damaged_are_found_at_the_files_end() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.mcap");
    let sent = write(&path, &about());
    let mut bytes = std::fs::read(&path).expect("the recording");
    let summary = mcap::Summary::read(&bytes)
        .expect("sound")
        .expect("an index");
    let first = &summary.chunk_indexes[0];
    assert_eq!(
        first.message_end_time, 0,
        "the first chunk has channels only"
    );
    bytes[(first.chunk_start_offset + first.chunk_length / 2) as usize] ^= 0x10;
    std::fs::write(&path, &bytes).expect("ours");
    let (found, messages) = read_all(&path).expect("sound but for its channels");
    assert_eq!(messages, sent);
    assert!(!found.is_complete() && found.damage.len() == 1);
}

/// Wherever a byte is changed: what is read is what was sent, without a stretch of it; and where anything is missing or
/// may be wrong, the file is not called complete.
#[test]
fn a_changed_byte_is_never_taken_for_the_truth() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.mcap");
    let sent = write(&path, &about());
    let sound = std::fs::read(&path).expect("the recording");
    let (complete, _) = read_all(&path).expect("sound");
    assert!(complete.is_complete());
    let last = *chunks(&sound).last().expect("chunks");
    let head = 0..3000;
    let places = head.chain((3000..last.0 + last.1).step_by(431));
    for place in places.step_by(7) {
        let mut damaged = sound.clone();
        damaged[place] ^= 0x41;
        std::fs::write(&path, &damaged).expect("ours");
        // What is refused says so in words: see the tests of errors.
        if let Ok((found, messages)) = read_all(&path) {
            assert!(stretch(&messages, &sent).is_some(), "byte {place}");
            assert!(!found.is_complete(), "byte {place}");
        }
    }
}

/// As the version before this one wrote it: text is bytes.
#[test]
fn an_older_recording_is_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("old.mcap");
    let sent: Vec<_> = (0..3).flat_map(step_messages).collect();
    let mut writer =
        mcap::Writer::new(std::fs::File::create(&path).expect("ours")).expect("a head");
    let channels = TOPICS.map(|topic| {
        let definition = (topic.memory_definition)();
        assert!(!definition.contains("string "));
        let name = topic.ros_type.replacen('/', "/msg/", 1);
        let schema = writer.add_schema(&name, "ros2msg", definition.as_bytes());
        let topic = format!("/{}", topic.name);
        writer.add_channel(schema.expect("a schema"), &topic, "cdr", &BTreeMap::new())
    });
    for message in &sent {
        let header = mcap::records::MessageHeader {
            channel_id: *channels[message.topic()].as_ref().expect("a channel"),
            sequence: 0,
            log_time: message.header().sent_ns,
            publish_time: 0,
        };
        let body = [&[0, 1, 0, 0], message.bytes()].concat();
        writer.write_to_known_channel(&header, &body).expect("ours");
    }
    writer.finish().expect("ours");
    let (_, messages) = read_all(&path).expect("an older version");
    assert_eq!(messages, sent);
}

#[test]
fn another_version_of_a_message_is_refused_with_both_lines() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("old.mcap");
    let definition =
        (TOPICS[0].definition)().replace("float32[36] speed_mps", "float64[36] speed_mps");
    let mut writer =
        mcap::Writer::new(std::fs::File::create(&path).expect("ours")).expect("a head");
    let schema = writer.add_schema(
        "mirror_msgs/msg/LidarFrame",
        "ros2msg",
        definition.as_bytes(),
    );
    let channel = writer.add_channel(
        schema.expect("a schema"),
        "/world/lidar",
        "cdr",
        &BTreeMap::new(),
    );
    channel.expect("a channel");
    writer.finish().expect("ours");
    let error = read_all(&path).expect_err("another version").to_string();
    for word in [
        "old.mcap",
        "byte ",
        "/world/lidar",
        "float64[36] speed_mps",
        "float32[36] speed_mps",
    ] {
        assert!(error.contains(word), "no {word:?} in {error}");
    }
}

#[test]
fn what_is_no_recording_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, bytes) in [
        ("empty", &b""[..]),
        ("text", b"not a recording at all"),
        ("short", b"\x89MCA"),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("ours");
        let error = read_all(&path).expect_err(name).to_string();
        assert!(
            error.contains(name) && error.contains("not an MCAP"),
            "{error}"
        );
        assert_eq!(run_of(&path), None);
    }
    let error = read_all(&folder.path().join("missing"))
        .expect_err("missing")
        .to_string();
    assert!(error.contains("missing"), "{error}");
    read_all(folder.path()).expect_err("a folder");
}

/// Records of every kind with too few bytes: a reader that takes for granted what an attachment must have comes down
/// here.
#[test]
fn records_that_are_too_short_are_damage() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("short.mcap");
    for (opcode, fill) in (0..=0x10).flat_map(|opcode| [(opcode, 0), (opcode, 1), (opcode, 0xff)]) {
        for length in 0..70_u64 {
            let mut bytes = mcap::MAGIC.to_vec();
            bytes.push(opcode);
            bytes.extend_from_slice(&length.to_le_bytes());
            bytes.resize(bytes.len() + length as usize, fill);
            bytes.extend_from_slice(&[0; 20]);
            std::fs::write(&path, &bytes).expect("ours");
            if let Ok((found, messages)) = read_all(&path) {
                assert!(messages.is_empty());
                assert!(!found.is_complete(), "kind {opcode} of {length} bytes");
            }
            let _ = (run_of(&path), recorder::read::end_of(&path));
        }
    }
}

fn short_recording() -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.mcap");
    let mut recording = Recording::create(&path, &about(), &[]).expect("ours");
    for message in (0..3).flat_map(step_messages) {
        recording.write(&message);
    }
    assert!(recording.finish(&Default::default()).is_complete());
    std::fs::read(&path).expect("the recording")
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    /// Neither random bytes, nor random bytes behind a sound beginning, nor bytes that were changed bring the reader
    /// down.
    #[test]
    fn nothing_brings_the_reader_down(
        random in proptest::collection::vec(any::<u8>(), 0..600),
        keep in 0.0..1.0_f64,
        changes in proptest::collection::vec((0.0..1.0_f64, any::<u8>()), 0..8),
    ) {
        thread_local! {
            static SOUND: Vec<u8> = short_recording();
        }
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("any.mcap");
        let sound = SOUND.with(Clone::clone);
        let kept = (keep * sound.len() as f64) as usize;
        let mut changed = sound.clone();
        for (place, value) in changes {
            let place = (place * changed.len() as f64) as usize;
            changed[place] = value;
        }
        let mut behind_magic = mcap::MAGIC.to_vec();
        behind_magic.extend_from_slice(&random);
        let mut behind_sound = sound[..kept].to_vec();
        behind_sound.extend_from_slice(&random);
        for bytes in [&random, &behind_magic, &behind_sound, &changed] {
            std::fs::write(&path, bytes).expect("ours");
            if let Err(error) = read_all(&path) {
                prop_assert!(error.to_string().contains("any.mcap"), "{}", error);
            }
            let _ = run_of(&path);
        }
    }
}
