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

/// Every length at which a file may end: what is read is a beginning of what was sent, never less for a longer file, and
/// more than the chunks before the cut.
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

#[test]
fn a_damaged_chunk_ends_the_reading_and_is_placed() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.mcap");
    let sent = write(&path, &about());
    let mut bytes = std::fs::read(&path).expect("the recording");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x55;
    std::fs::write(&path, &bytes).expect("ours");
    let (found, messages) = read_all(&path).expect("what comes before is sound");
    assert_eq!(messages, sent[..messages.len()]);
    assert!(!messages.is_empty() && messages.len() < sent.len());
    let Ending::Cut { byte, why } = found.ending else {
        panic!("damaged and called closed");
    };
    assert!(
        byte <= middle as u64 && why.contains("damaged"),
        "{byte}: {why}"
    );
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

    /// Neither random bytes, nor random bytes behind a sound beginning, nor bytes that were changed bring the reader down.
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
