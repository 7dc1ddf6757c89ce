//! What cannot be used is refused before anything starts: exit status 2, and a message that names it.

mod common;

use common::{Bench, Live, instance, mirror, run, told};
use std::path::Path;

fn refused(bench: &Bench, arguments: &[&str], words: &[&str]) {
    let name = instance("bad");
    let mut command = bench.up(&name);
    let output = run(command.args(["--episodes", "1"]).args(arguments));
    assert_refused(&output, words, &format!("{arguments:?}"));
    assert!(
        !runtime::instance::root_for(&name).join(&name).exists(),
        "{arguments:?} started something"
    );
}

fn assert_refused(output: &std::process::Output, words: &[&str], what: &str) {
    assert_eq!(output.status.code(), Some(2), "{what}: {}", told(output));
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    for word in words {
        assert!(error.contains(word), "{what}: no {word:?} in {error}");
    }
    assert!(!error.contains("panicked"), "{what}: {error}");
}

/// Bytes that are no text, no TOML, no XML, no safetensors.
fn random_bytes() -> Vec<u8> {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state as u8
    };
    (0..4096).map(|_| next()).collect()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn scenes() {
    let bench = Bench::new();
    refused(
        &bench,
        &["--scene", "highway-dust"],
        &["highway-dust", "highway-fog"],
    );
    refused(
        &bench,
        &["--scene", "/nowhere/scene.toml"],
        &["/nowhere/scene.toml"],
    );
    let random = bench.write("random.toml", random_bytes());
    refused(&bench, &["--scene", text(&random)], &["random.toml:1:"]);
    let cut = bench.write("cut.toml", "name = \"cut\"\n[traffic]\norder = \"cy");
    refused(&bench, &["--scene", text(&cut)], &["cut.toml:3:"]);
    let key = bench.write("key.toml", "name = \"key\"\n[traffic]\nordre = 1\n");
    refused(&bench, &["--scene", text(&key)], &["key.toml:3:1", "ordre"]);
    let range = bench.write("range.toml", "[ego]\nlength_m = -4.0\n");
    refused(
        &bench,
        &["--scene", text(&range)],
        &["range.toml", "ego.length_m", "-4"],
    );
    let elites = bench.write("elites.toml", "[planning]\nsamples = 10\nelites = 11\n");
    refused(
        &bench,
        &["--scene", text(&elites)],
        &["elites.toml", "elites"],
    );
    refused(
        &bench,
        &["--scene", text(bench.directory.path())],
        &[text(bench.directory.path())],
    );
}

#[test]
fn people() {
    let bench = Bench::new();
    for who in [
        "sim:0",
        "sim:22",
        "sim:99999999999",
        "recorded:x",
        "nobody",
        "sim:",
    ] {
        refused(&bench, &["--driver", who], &[]);
    }
    refused(
        &bench,
        &["--driver", "recorded:3"],
        &["recorded:3", "CommonRoad"],
    );
    refused(
        &bench,
        &["--driver", "sim:/nowhere/me.toml"],
        &["/nowhere/me.toml"],
    );
    let random = bench.write("me.toml", random_bytes());
    refused(
        &bench,
        &["--driver", &format!("sim:{}", text(&random))],
        &["me.toml:1:"],
    );
}

#[test]
fn scenarios() {
    let bench = Bench::new();
    refused(&bench, &["--scene", "/nowhere/a.xml"], &["/nowhere/a.xml"]);
    let random = bench.write("random.xml", random_bytes());
    refused(&bench, &["--scene", text(&random)], &["random.xml:1"]);
    let cut = bench.write(
        "cut.xml",
        "<commonRoad commonRoadVersion=\"2020a\">\n<lanelet id=\"1\">\n<leftBound>",
    );
    refused(&bench, &["--scene", text(&cut)], &["cut.xml:"]);
    let old = bench.write(
        "old.xml",
        "<commonRoad commonRoadVersion=\"2017a\" timeStepSize=\"0.1\"></commonRoad>",
    );
    refused(
        &bench,
        &["--scene", text(&old)],
        &["old.xml:1", "2017a", "2020a"],
    );
    let empty = bench.write(
        "empty.xml",
        "<commonRoad commonRoadVersion=\"2020a\" timeStepSize=\"0.1\"></commonRoad>",
    );
    refused(&bench, &["--scene", text(&empty)], &["empty.xml"]);
}

#[test]
fn models() {
    let bench = Bench::new();
    let model = std::fs::read(bench.path("self.safetensors")).unwrap();
    let up = |file: &Path, more: &[&str]| {
        let mut command = mirror();
        command
            .args([
                "up",
                "--planner",
                "none",
                "--episodes",
                "1",
                "--self-model",
                text(file),
            ])
            .args(more);
        run(&mut command)
    };
    let missing = bench.path("missing.safetensors");
    assert_refused(
        &up(&missing, &["--human", "self"]),
        &["missing.safetensors"],
        "missing",
    );
    let random = bench.write("random.safetensors", random_bytes());
    assert_refused(
        &up(&random, &["--human", "self"]),
        &["random.safetensors"],
        "random",
    );
    let cut = bench.write("cut.safetensors", &model[..model.len() / 2]);
    assert_refused(&up(&cut, &["--human", "self"]), &["cut.safetensors"], "cut");
    // A self-model is no person's implants.
    let good = bench.path("self.safetensors");
    let output = up(&good, &["--human", "mirror", "--implants", text(&good)]);
    assert_refused(&output, &["self.safetensors"], "implants");
}

#[test]
fn options() {
    let bench = Bench::new();
    refused(&bench, &["--fog", "-3"], &["--fog"]);
    refused(&bench, &["--fog", "NaN"], &["--fog"]);
    refused(&bench, &["--exec", "world"], &["--exec"]);
    refused(&bench, &["--exec", "moon=/bin/true"], &["moon", "planner"]);
    refused(&bench, &["--exec", "human="], &["human"]);
    refused(
        &bench,
        &["--record", "/nowhere/run.mcap"],
        &["/nowhere/run.mcap"],
    );
    refused(
        &bench,
        &["--summary", "/nowhere/run.json"],
        &["/nowhere/run.json"],
    );
    let again = |arguments: &[&str], words: &[&str]| {
        let mut command = mirror();
        assert_refused(
            &run(command.arg("up").args(arguments)),
            words,
            &format!("{arguments:?}"),
        );
    };
    again(&["--episodes", "0"], &["--episodes"]);
    again(&["--planner", "telepathy"], &["telepathy"]);
    again(&["--human", "stranger"], &["stranger"]);
    again(&["--clock", "sundial"], &["sundial"]);
    again(&["--seed", "-1"], &[]);
    let model = bench.path("self.safetensors");
    let plain = [
        "--human",
        "self",
        "--planner",
        "none",
        "--self-model",
        text(&model),
    ];
    again(&[&plain[..], &["--instance", "a/b"]].concat(), &["a/b"]);
    again(&[&plain[..], &["--instance", ""]].concat(), &["instance"]);
}

#[test]
fn an_instance_in_use() {
    let bench = Bench::new();
    let name = instance("busy");
    let mut live = Live::start(bench.up(&name).args(["--episodes", "1000000"]), &name);
    let output = run(bench.up(&name).args(["--episodes", "1"]));
    assert_refused(
        &output,
        &[&name, &live.child.id().to_string()],
        "instance in use",
    );
    // It was not disturbed.
    live.wait_for_line("START");
    live.signal("launcher", libc::SIGTERM);
    assert_eq!(live.wait().code(), Some(1));
    common::assert_nothing_left(&name);
}
