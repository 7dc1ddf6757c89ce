//! Drives read from recordings: in parts, with gaps, with senders that were replaced, and with any numbers in them.

use messages::{
    CommAction, Display, DriverAction, HumanBelief, LidarFrame, Message, Outcome, RobotBelief,
};
use proptest::prelude::*;
use recorder::parts::part_path;
use recorder::recording::{About, Recording};
use recorder::topics::Recorded;
use replay::{Drive, DriveError};
use std::path::Path;

const RUN: u64 = 7;

fn stamped<M: Message>(step: u32, sequence: u64, salt: u64) -> M {
    let mut message = M::ZERO;
    if let Some(header) = message.header_mut() {
        header.run_id = RUN;
        header.step = step;
        header.sequence = sequence;
        header.sent_ns = 1_000 + u64::from(step) * 1_000 + salt;
    }
    message
}

/// What a set says at a step.
fn step(step: u32) -> Vec<Recorded> {
    let sequence = u64::from(step);
    vec![
        (&stamped::<Outcome>(step, sequence, 0)).into(),
        (&stamped::<LidarFrame>(step, sequence, 1)).into(),
        (&stamped::<RobotBelief>(step, sequence, 2)).into(),
        (&stamped::<Display>(step, sequence, 3)).into(),
        (&stamped::<HumanBelief>(step, sequence, 4)).into(),
        (&stamped::<CommAction>(step + 1, sequence, 5)).into(),
        (&stamped::<DriverAction>(step, sequence, 6)).into(),
    ]
}

fn write(path: &Path, run_id: u64, messages: &[Recorded]) {
    let about = About {
        run_id,
        ..About::default()
    };
    let mut recording = Recording::create(path, &about, &[]).expect("the folder is ours");
    for message in messages {
        recording.write(message);
    }
    assert!(recording.finish(&Default::default()).is_complete());
}

fn steps(from: u32, to: u32) -> Vec<Recorded> {
    (from..to).flat_map(step).collect()
}

#[test]
fn parts_are_one_drive_and_what_both_have_counts_once() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.mcap");
    write(&path, RUN, &steps(0, 10));
    write(&part_path(&path, 2), RUN, &steps(7, 20));
    write(&part_path(&path, 3), RUN, &steps(23, 30));
    write(&part_path(&path, 4), RUN + 1, &steps(30, 40)); // left by another run
    let drive = Drive::read(&path).expect("sound");
    assert_eq!(drive.parts.len(), 3);
    let whole = drive.steps.values().filter(|step| step.is_whole()).count();
    assert_eq!(whole, 27);
    assert_eq!(drive.gaps.len(), 7);
    assert!(
        drive.gaps.values().all(|lost| *lost == 3),
        "{:?}",
        drive.gaps
    );
    assert!(drive.successions.is_empty(), "{:?}", drive.successions);
}

#[test]
fn missing_steps_are_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.mcap");
    let missing = |messages: &[Recorded]| {
        write(&path, RUN, messages);
        let drive = Drive::read(&path).expect("sound");
        let missing = drive.missing_steps();
        let words: Vec<String> = missing.iter().map(ToString::to_string).collect();
        (drive.is_complete(), words)
    };
    assert_eq!(missing(&steps(0, 10)), (true, vec![]));
    let mut messages = steps(0, 10);
    messages.retain(|message| !(4..6).contains(&message.header().step));
    let expected = vec!["episode 0 steps 4 to 5".to_owned()];
    assert_eq!(missing(&messages), (false, expected));
    // Of three episodes the second, the end of the first and the beginning of the last.
    let mut messages = Vec::new();
    for (episode, range) in [(0, steps(0, 8)), (2, steps(2, 6))] {
        messages.extend(range.into_iter().map(|mut message| {
            let header = message.header_mut();
            header.episode = episode;
            header.sequence += u64::from(episode) * 20;
            header.sent_ns += u64::from(episode) * 20_000;
            message
        }));
    }
    let (complete, words) = missing(&messages);
    assert!(!complete);
    let expected = [
        "episode 0 from step 8 on",
        "all of episode 1",
        "episode 2 steps 0 to 1",
    ];
    assert_eq!(words, expected);
    // An episode that ends is not expected to go on.
    for message in &mut messages {
        if let Recorded::Outcome(outcome) = message
            && (outcome.header.episode, outcome.header.step) == (0, 7)
        {
            outcome.end = messages::EpisodeEnd::Goal.wire();
        }
    }
    assert_eq!(missing(&messages).1, expected[1..]);
}

#[test]
fn a_sender_that_took_over_is_noticed_where_a_replay_asks_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.mcap");
    let mut messages = steps(0, 10);
    for message in &mut messages {
        match message {
            Recorded::HumanBelief(belief) if belief.header.step >= 6 => belief.header.sequence -= 6,
            Recorded::Display(display) if display.header.step >= 4 => display.header.sequence -= 4,
            _ => {}
        }
    }
    write(&path, RUN, &messages);
    let drive = Drive::read(&path).expect("sound");
    assert_eq!(drive.successions, [("belief/human", (0, 6))]);
    assert!(drive.gaps.is_empty(), "{:?}", drive.gaps);
}

#[test]
fn words_of_a_display_outlive_the_display_that_follows_in_its_step() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.mcap");
    let mut messages = steps(0, 3);
    let (mut first, mut second) = (stamped::<Display>(3, 3, 0), stamped::<Display>(3, 4, 1));
    first.utterance_count = 1;
    first.utterances[0].kind = messages::UtteranceContent::Fast.wire();
    second.highlighted = 5;
    messages.extend([Recorded::from(&first), Recorded::from(&second)]);
    write(&path, RUN, &messages);
    let drive = Drive::read(&path).expect("sound");
    let shown = drive.steps[&(0, 3)].display.as_ref().expect("shown");
    assert_eq!(
        (
            shown.highlighted,
            shown.utterance_count,
            shown.utterances[0].kind
        ),
        (5, 1, 2)
    );
}

#[test]
fn what_is_missing_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.mcap");
    write(&path, RUN, &[]);
    let error = Drive::read(&path).expect_err("nothing in it");
    assert!(matches!(error, DriveError::Empty { .. }) && error.to_string().contains("drive.mcap"));
    let mut messages = steps(0, 4);
    messages.retain(|message| !matches!(message, Recorded::CommAction(_)));
    write(&path, RUN, &messages);
    let error = Drive::read(&path).expect_err("no decisions").to_string();
    assert!(
        error.contains("drive.mcap: no message on /comm/action (closed)"),
        "{error}"
    );
    let mut messages = steps(0, 4);
    messages.retain(|message| match message {
        Recorded::LidarFrame(frame) => frame.header.step < 2,
        Recorded::Display(display) => display.header.step >= 2,
        _ => true,
    });
    write(&path, RUN, &messages);
    let error = Drive::read(&path).expect_err("no whole step");
    assert!(matches!(error, DriveError::NoStep { .. }), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 100, ..ProptestConfig::default() })]

    /// Messages with any bytes at all, as of a run that went mad or a disk that did.
    #[test]
    fn any_numbers_are_read(bytes in proptest::collection::vec(any::<u8>(), 8000), extreme in any::<bool>()) {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("mad.mcap");
        let mut messages = steps(0, 3);
        for (topic, kind) in recorder::topics::TOPICS.iter().enumerate() {
            let mut bytes = bytes.repeat(kind.size / bytes.len() + 1);
            if extreme {
                bytes[..48].fill(0xff); // the header's numbers as large as can be
            }
            messages.extend(Recorded::from_bytes(topic, &bytes[..kind.size]));
        }
        messages.extend(steps(3, 5));
        write(&path, RUN, &messages);
        let drive = Drive::read(&path);
        prop_assert!(drive.is_ok(), "{}", drive.expect_err("printed"));
    }
}
