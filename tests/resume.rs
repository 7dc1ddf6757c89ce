//! Training that was killed at any moment and continued ends with the tensors of training that was not, whatever vectors the
//! machine that it goes on on has.

mod common;

use common::{mirror, run, told};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

/// A short training: the domain, the option that says how long, and how long.
type Course = (&'static str, &'static str, u32);

/// Every learner of a self-model, and the vectors before and after it is killed.
const COURSES: [(Course, [&str; 2]); 4] = [
    (("highway", "--episodes", 3), ["8", "16"]),
    (("driving", "--phases", 8), ["16", "8"]),
    (("search_rescue", "--phases", 3), ["8", "16"]),
    (("bomb_defusal", "--phases", 3), ["16", "8"]),
];

fn train((domain, option, length): Course, vectors: &str, out: &Path) -> Command {
    let mut command = mirror();
    command.args(["train", "self", "--domain", domain, "--vectors", vectors]);
    command.arg(option).arg(length.to_string());
    command.arg("--metrics").arg(out.with_extension("jsonl"));
    command.arg("--out").arg(out).stdin(Stdio::null());
    command
}

/// The tensors' places and bytes, without the metadata, which hold the command.
fn tensors(path: &Path) -> (Value, Vec<u8>) {
    let bytes = std::fs::read(path).unwrap();
    let (length, rest) = bytes.split_at(8);
    let length = u64::from_le_bytes(length.try_into().unwrap()) as usize;
    let mut head: Value = serde_json::from_slice(&rest[..length]).unwrap();
    head.as_object_mut().unwrap().remove("__metadata__");
    (head, rest[length..].to_vec())
}

/// Lines that a training has written of its episodes or phases.
fn lines(metrics: &Path) -> usize {
    std::fs::read_to_string(metrics).map_or(0, |text| text.matches('\n').count())
}

/// Trains, is killed by SIGKILL some moments after it has written a checkpoint, and goes on with the other vectors.
fn killed_and_continued(course: Course, vectors: [&str; 2], out: &Path, rng: &mut ChaCha8Rng) {
    let mut child = train(course, vectors[0], out)
        .args(["--seed", "3"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let checkpoint = out.with_extension("training.safetensors");
    // A random moment after the first checkpoint, in the middle of a phase or of writing, but before the last phase ends.
    let mut looks = 1 + rng.next_u32() % 500;
    while looks > 0 && lines(&out.with_extension("jsonl")) + 1 < course.2 as usize {
        assert!(child.try_wait().unwrap().is_none(), "it ended by itself");
        looks -= u32::from(checkpoint.is_file());
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(checkpoint.is_file());
    child.kill().unwrap();
    assert!(!child.wait().unwrap().success());
    assert!(!out.exists(), "a model was written before the end");

    let output = run(train(course, vectors[1], out).arg("--resume"));
    assert!(output.status.success(), "{}", told(&output));
}

#[test]
fn killed_and_continued_with_other_vectors_is_the_same_as_never_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let rng = &mut ChaCha8Rng::seed_from_u64(u64::from(std::process::id()));
    for (course, vectors) in COURSES {
        let whole = folder.path().join(format!("{}.safetensors", course.0));
        let output = run(train(course, "widest", &whole).args(["--seed", "3"]));
        assert!(output.status.success(), "{}", told(&output));
        let expected = tensors(&whole);
        assert!(!expected.1.is_empty());
        let cut = folder.path().join(format!("{}-cut.safetensors", course.0));
        killed_and_continued(course, vectors, &cut, rng);
        assert!(tensors(&cut) == expected, "{course:?}, {vectors:?}");
    }
}
