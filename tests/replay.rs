//! Replaying recorded drives over real processes: the same decisions bit for bit with the recorded models, others with
//! other models, up to the cut of a recording that was cut, around the gaps of one that has gaps.

mod common;

use common::{Bench, assert_nothing_left, instance, mirror, run, summary, told};
use recorder::recording::{About, Recording};
use recorder::setup::{ModelFile, Setup};
use recorder::topics::{Recorded, TOPICS};
use std::path::{Path, PathBuf};
use std::process::Output;

/// A drive of some dozen steps, planned with few samples.
const SCENE: &str = "name = \"short\"
[fog]
front_m = 15.0
side_m = 8.0
rear_m = 3.0
[communication]
visual_cost = 0.0
verbal_cost = 0.0
speech_interval_s = 0.3
[planning]
race_steps = 6
race_first = 4
race_futures = 16
race_certainty = 0.0
samples = 40
futures = 1
elites = 10
iterations = 2
horizon = 2
[episode]
max_steps = 25
";

struct Recorder {
    test: &'static str,
    bench: Bench,
    drive: PathBuf,
}

impl Recorder {
    /// Records two short episodes with the planner and implants of a person; the implants' file is gone afterwards.
    fn drive(test: &'static str, more: &[&str]) -> Self {
        let bench = Bench::new();
        bench.write_implants();
        let scene = bench.write("short.toml", SCENE);
        let (drive, model) = (bench.path("drive.mcap"), bench.path("self.safetensors"));
        let implants = bench.path("implants.safetensors");
        let name = instance(test);
        let mut command = mirror();
        command.args([
            "up",
            "--episodes",
            "2",
            "--quiet",
            "--instance",
            &name,
            "--scene",
        ]);
        command
            .arg(scene)
            .arg("--self-model")
            .arg(model)
            .arg("--record")
            .arg(&drive);
        if !more.contains(&"--human") {
            command.arg("--implants").arg(&implants);
        }
        let output = run(command.args(more));
        assert!(output.status.success(), "{}", told(&output));
        std::fs::remove_file(implants).unwrap();
        Self { test, bench, drive }
    }

    /// Replays a recording; what came out, and the summary.
    fn replay(&self, recording: &Path, more: &[&str]) -> (Output, serde_json::Value) {
        let (output, summary) = self.ended(recording, more);
        assert!(output.status.success(), "{}", told(&output));
        assert_eq!(summary["complete"], true);
        (output, summary)
    }

    /// Replays a recording in which something is missing, and in the rest of which nothing differs.
    fn replay_part(&self, recording: &Path) -> (Output, serde_json::Value) {
        let (output, summary) = self.ended(recording, &[]);
        assert_eq!(output.status.code(), Some(1), "{}", told(&output));
        assert_eq!(summary["complete"], false);
        assert_eq!(summary["reproduced"], serde_json::Value::Null);
        says(
            &output,
            &["the same bit for bit", "only a part of the drive"],
        );
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(!text.contains("REPRODUCED"), "{text}");
        (output, summary)
    }

    fn ended(&self, recording: &Path, more: &[&str]) -> (Output, serde_json::Value) {
        let file = self.bench.path("replay.json");
        let name = instance(&format!("{}-replay", self.test));
        let mut command = mirror();
        command
            .arg("replay")
            .arg(recording)
            .args(["--instance", &name, "--summary"])
            .arg(&file);
        let output = run(command.args(more));
        assert_nothing_left(&name);
        (output, summary(&file))
    }

    /// Replays what cannot be replayed.
    fn refused(&self, recording: &Path, more: &[&str], words: &[&str]) {
        let name = instance(&format!("{}-bad", self.test));
        let mut command = mirror();
        let output = run(command
            .arg("replay")
            .arg(recording)
            .args(["--instance", &name])
            .args(more));
        assert_eq!(output.status.code(), Some(2), "{}", told(&output));
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        for word in words {
            assert!(error.contains(word), "no {word:?} in {error}");
        }
        assert!(!error.contains("panicked"), "{error}");
        assert_nothing_left(&name);
    }

    /// The recording again, without the messages that `keep` refuses; it keeps the run's setup.
    fn without(&self, name: &str, mut keep: impl FnMut(&Recorded) -> bool) -> PathBuf {
        let mut kept = Vec::new();
        let found = recorder::read::read(&self.drive, |message| {
            if keep(message) {
                kept.push(*message);
            }
        });
        let found = found.unwrap();
        let mut setup: Setup = found.setup.unwrap();
        let attached = self.bench.write("attached", &found.attachments["implants"]);
        let file = ModelFile::identify(&attached, true).unwrap();
        setup.files.insert("implants".to_owned(), file);
        let about = About {
            run_id: found.run_id.unwrap(),
            setup,
            ..About::default()
        };
        let path = self.bench.path(name);
        let mut recording = Recording::create(&path, &about, &[]).unwrap();
        for message in &kept {
            recording.write(message);
        }
        assert!(recording.finish(&Default::default()).is_complete());
        path
    }
}

/// Where the chunks with messages lie in a recording: beginning and length.
fn chunks(recording: &[u8]) -> Vec<(usize, usize)> {
    let summary = mcap::Summary::read(recording).unwrap().unwrap();
    let chunks = summary.chunk_indexes.iter();
    let chunks = chunks.filter(|chunk| chunk.message_end_time > 0);
    chunks
        .map(|chunk| {
            (
                chunk.chunk_start_offset as usize,
                chunk.chunk_length as usize,
            )
        })
        .collect()
}

fn says(output: &Output, words: &[&str]) {
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    for word in words {
        assert!(text.contains(word), "no {word:?} in {text}");
    }
}

#[test]
fn the_recorded_models_decide_the_same_bit_for_bit() {
    let recorder = Recorder::drive("same", &[]);
    let (output, summary) = recorder.replay(&recorder.drive, &[]);
    assert_eq!(summary["schema"], "mirror-replay/1");
    assert_eq!(summary["reproduced"], true, "{}", told(&output));
    assert_eq!(summary["differences"].as_array().unwrap().len(), 0);
    assert!(summary["steps"].as_u64().unwrap() >= 20, "{summary}");
    for what in ["robot_beliefs", "human_beliefs", "decisions"] {
        assert_eq!(summary[what]["compared"], summary["steps"], "{what}");
        assert_eq!(summary[what]["same"], summary["steps"], "{what}");
    }
    assert_eq!(summary["differing_decisions"], 0);
    assert_eq!(summary["skipped_steps"], 0);
    // Not the trivial case: something was communicated, and values differ from step to step.
    assert!(summary["totals_then"]["verbal_items"].as_u64().unwrap() > 0);
    assert_eq!(summary["totals_then"], summary["totals_now"]);
    says(&output, &["REPRODUCED bit for bit"]);
}

/// A replay that reports equality whatever is in the file would pass the test above.
#[test]
fn a_recording_that_was_tampered_with_is_not_reproduced() {
    let recorder = Recorder::drive("tampered", &[]);
    let mut original = None;
    let path = recorder.without("tampered.mcap", |message| {
        if let Recorded::LidarFrame(frame) = message
            && (frame.header.episode, frame.header.step) == (0, 5)
        {
            original = Some(*frame);
        }
        true
    });
    // The frame of one step says something else, far to the front.
    let mut bytes = Vec::new();
    let mut tampered = original.unwrap();
    tampered.range[0] = if tampered.range[0] < 0.5 { 0.9 } else { 0.1 };
    let found = recorder::read::read(&path, |message| {
        bytes.push(match message {
            Recorded::LidarFrame(frame) if frame.header == tampered.header => (&tampered).into(),
            other => *other,
        });
    });
    let found = found.unwrap();
    let about = About {
        run_id: found.run_id.unwrap(),
        setup: found.setup.unwrap(),
        ..About::default()
    };
    let mut recording = Recording::create(&path, &about, &[]).unwrap();
    for message in &bytes {
        recording.write(message);
    }
    recording.finish(&Default::default());
    let file = recorder.bench.path("tampered.json");
    let name = instance("tampered-replay");
    let mut command = mirror();
    command
        .arg("replay")
        .arg(&path)
        .args(["--instance", &name, "--summary"])
        .arg(&file);
    let output = run(&mut command);
    assert_eq!(output.status.code(), Some(1), "{}", told(&output));
    let summary = summary(&file);
    assert_eq!(summary["reproduced"], false);
    assert_eq!(
        summary["robot_beliefs"]["first_difference"],
        serde_json::json!([0, 5])
    );
    says(
        &output,
        &["NOT REPRODUCED", "first difference at episode 0 step 5"],
    );
    assert_nothing_left(&name);
}

#[test]
fn a_cut_recording_replays_up_to_the_cut() {
    let recorder = Recorder::drive("cut", &[]);
    let bytes = std::fs::read(&recorder.drive).unwrap();
    let mut steps = Vec::new();
    let (chunk, length) = chunks(&bytes)[0];
    for end in [bytes.len() * 10 / 11, chunk + length * 6 / 10] {
        let cut = recorder.bench.write("cut.mcap", &bytes[..end]);
        let (output, summary) = recorder.replay_part(&cut);
        let found = &summary["parts"][0];
        assert!(
            found["cut"].as_str().unwrap().contains("at byte"),
            "{found}"
        );
        assert!(found["messages"].as_u64().unwrap() > 0);
        says(&output, &["CUT SHORT"]);
        let replayed = summary["steps"].as_u64().unwrap();
        steps.push(replayed);
        if end < chunk + length {
            // The first episode breaks off, and nobody knows how many steps it had.
            let last = summary["missing"].as_array().unwrap().last().unwrap();
            assert_eq!(last["episode"], 0, "{summary}");
            assert_eq!(last["to"], serde_json::Value::Null);
            let from = last["from"].as_u64().unwrap();
            assert!(from >= replayed, "{summary}");
            says(
                &output,
                &[&format!("MISSING: episode 0 from step {from} on")],
            );
        }
    }
    assert!(steps[1] > 0 && steps[1] < steps[0], "{steps:?}");
    let head = recorder.bench.write("head.mcap", &bytes[..600]);
    recorder.refused(&head, &[], &["head.mcap", "holds no message", "at byte"]);
}

#[test]
fn another_human_model_or_planner_says_something_else() {
    let recorder = Recorder::drive("other", &[]);
    let (output, summary) = recorder.replay(&recorder.drive, &["--human", "self"]);
    assert_eq!(summary["then"]["human"], "mirror");
    assert_eq!(summary["now"]["human"], "self");
    assert_eq!(summary["reproduced"], serde_json::Value::Null);
    // The robot saw the same; the model of the person did not.
    assert_eq!(
        summary["robot_beliefs"]["same"],
        summary["robot_beliefs"]["compared"]
    );
    assert_eq!(summary["human_beliefs"]["same"], 0);
    let (then, now) = (&summary["totals_then"], &summary["totals_now"]);
    assert_ne!(then["log_likelihood_mean"], now["log_likelihood_mean"]);
    let actions = summary["compared_actions"].as_u64().unwrap();
    assert_eq!(
        actions + 2,
        summary["steps"].as_u64().unwrap(),
        "all but each episode's last"
    );
    says(
        &output,
        &["human model self instead of mirror", "mean log-likelihood"],
    );
    // The sums are those of the steps.
    let steps = summary["step_list"].as_array().unwrap();
    let mean = |field: &str| {
        let known = steps.iter().filter_map(|step| step[field].as_f64());
        known.sum::<f64>() / actions as f64
    };
    for (field, totals) in [("log_likelihood_then", then), ("log_likelihood_now", now)] {
        let reported = totals["log_likelihood_mean"].as_f64().unwrap();
        assert!(
            (mean(field) - reported).abs() < 1e-3,
            "{field}: {} {reported}",
            mean(field)
        );
    }

    let (output, summary) =
        recorder.replay(&recorder.drive, &["--planner", "none", "--lines", "2"]);
    assert_eq!(
        summary["human_beliefs"]["same"],
        summary["human_beliefs"]["compared"]
    );
    assert_eq!(summary["totals_now"]["communication_cost"], 0.0);
    let differing = summary["differing_decisions"].as_u64().unwrap();
    assert_eq!(
        summary["totals_then"]["steps_with_communication"],
        differing
    );
    says(
        &output,
        &[
            "planner none instead of race",
            &format!("and {} more", differing - 2),
        ],
    );
}

#[test]
fn gaps_are_replayed_around_and_said() {
    let recorder = Recorder::drive("gaps", &[]);
    // A frame in the first episode, an action in the second.
    let path = recorder.without("gaps.mcap", |message| {
        let header = message.header();
        let at = (header.episode, header.step);
        !match message {
            Recorded::LidarFrame(_) => at == (0, 6),
            Recorded::DriverAction(_) => at == (1, 3),
            _ => false,
        }
    });
    let (output, summary) = recorder.replay_part(&path);
    assert_eq!(summary["gaps"]["world/lidar"], 1);
    assert_eq!(summary["gaps"]["driver/action"], 1);
    assert_eq!(summary["skipped_steps"], 1);
    let rows = summary["step_list"].as_array().unwrap();
    for row in rows {
        let (episode, step) = (
            row["episode"].as_u64().unwrap(),
            row["step"].as_u64().unwrap(),
        );
        let expected = if episode == 0 { step > 6 } else { step >= 3 };
        assert_eq!(row["after_gap"], expected, "episode {episode} step {step}");
    }
    // What comes before the gaps is still the same.
    assert_eq!(summary["decisions"]["compared"], 6 + 3);
    let words = [
        "GAPS: 1 messages missing on /world/lidar",
        "MISSING: episode 0 step 6\n",
    ];
    says(&output, &words);
    // With another planner, too, it is only a part.
    let (output, summary) = recorder.ended(&path, &["--planner", "none"]);
    assert_eq!(output.status.code(), Some(1), "{}", told(&output));
    assert_eq!(summary["reproduced"], serde_json::Value::Null);
    says(
        &output,
        &["need not be the same", "only a part of the drive"],
    );
}

#[test]
fn a_damaged_chunk_costs_its_steps_and_the_word() {
    let recorder = Recorder::drive("damaged", &[]);
    let (_, whole) = recorder.replay(&recorder.drive, &[]);
    let mut bytes = std::fs::read(&recorder.drive).unwrap();
    let chunks = chunks(&bytes);
    assert!(chunks.len() >= 2, "nothing behind the chunk: {chunks:?}");
    let (chunk, length) = chunks[0];
    bytes[chunk + length / 2..][..8].fill(0x5a);
    let path = recorder.bench.write("damaged.mcap", &bytes);
    let (output, found) = recorder.replay_part(&path);
    says(&output, &[&format!("DAMAGED: byte {chunk}: "), "MISSING: "]);
    // What is missing is named, all of it, and what comes behind it is replayed.
    let mut missing = 0;
    for stretch in found["missing"].as_array().unwrap() {
        let episode = stretch["episode"].as_u64().unwrap();
        let of_episode = |row: &&serde_json::Value| row["episode"] == episode;
        let steps = whole["step_list"].as_array().unwrap().iter();
        let last = steps.filter(of_episode).count() as u64 - 1;
        let to = stretch["to"].as_u64().unwrap_or(last);
        missing += to + 1 - stretch["from"].as_u64().unwrap();
    }
    let replayed = found["steps"].as_u64().unwrap();
    assert!(replayed > 0 && missing > 0, "{found}");
    assert_eq!(replayed + missing, whole["steps"].as_u64().unwrap());
}

#[test]
fn a_real_time_recording_is_replayed_step_by_step() {
    let recorder = Recorder::drive("realtime", &["--clock", "realtime", "--human", "self"]);
    let (output, summary) = recorder.replay(&recorder.drive, &[]);
    assert_eq!(summary["clock"], "realtime");
    assert_eq!(summary["reproduced"], serde_json::Value::Null);
    assert!(summary["steps"].as_u64().unwrap() > 10, "{summary}");
    says(&output, &["recorded in real time"]);
}

#[test]
fn a_changed_self_model_is_refused_with_both_digests() {
    let recorder = Recorder::drive("changed", &[]);
    let model = recorder.bench.path("self.safetensors");
    let before = recorder::setup::digest(&model).unwrap();
    let other = recorder.bench.path("other.safetensors");
    let mut bytes = std::fs::read(&model).unwrap();
    std::fs::write(&other, &bytes).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&model, &bytes).unwrap();
    let after = recorder::setup::digest(&model).unwrap();
    let place = model.to_str().unwrap();
    recorder.refused(
        &recorder.drive,
        &[],
        &[place, &before, &after, "--self-model"],
    );
    // The same bytes elsewhere are the same model.
    let (_, summary) = recorder.replay(&recorder.drive, &["--self-model", other.to_str().unwrap()]);
    assert_eq!(summary["reproduced"], true);
    // Another model to compare with is another question.
    let (output, summary) = recorder.replay(&recorder.drive, &["--human", "self"]);
    assert_eq!(summary["now"]["self_model"], after);
    assert!(String::from_utf8_lossy(&output.stderr).contains(&before));
    std::fs::remove_file(&model).unwrap();
    recorder.refused(&recorder.drive, &[], &[place, &before, "--self-model"]);
}

#[test]
fn what_cannot_be_replayed_is_refused() {
    let recorder = Recorder::drive("refused", &[]);
    let path = |name: &str, bytes: &[u8]| recorder.bench.write(name, bytes);
    recorder.refused(
        &path("text.mcap", b"no recording"),
        &[],
        &["text.mcap", "not an MCAP"],
    );
    recorder.refused(
        &path("empty.mcap", b""),
        &[],
        &["empty.mcap", "not an MCAP"],
    );
    recorder.refused(
        Path::new("/nowhere/drive.mcap"),
        &[],
        &["/nowhere/drive.mcap"],
    );
    let magic = path("magic.mcap", &[mcap::MAGIC, &[7; 900]].concat());
    recorder.refused(
        &magic,
        &[],
        &["magic.mcap", "holds no message", "at byte 8"],
    );
    let mute = recorder.without("mute.mcap", |message| {
        !["comm/display", "driver/action"].contains(&TOPICS[message.topic()].name)
    });
    recorder.refused(&mute, &[], &["mute.mcap", "/comm/display, /driver/action"]);
    recorder.refused(&recorder.drive, &["--human", "nobody"], &["--human nobody"]);
    let drive = &recorder.drive;
    recorder.refused(
        drive,
        &["--human", "self", "--implants", "x"],
        &["--implants"],
    );
    recorder.refused(
        drive,
        &["--implants", "/nowhere/i.safetensors"],
        &["/nowhere/i.safetensors"],
    );
    recorder.refused(
        drive,
        &["--summary", "/nowhere/at/all.json"],
        &["/nowhere/at"],
    );
    let random = path("random.safetensors", &[9; 500]);
    recorder.refused(
        drive,
        &["--self-model", random.to_str().unwrap()],
        &["random.safetensors"],
    );
}
