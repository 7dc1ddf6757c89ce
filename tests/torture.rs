//! Random processes of a real-time run are killed or stopped at random moments: the run ends by itself, every death is
//! counted, the recording decodes, and nothing stays behind.
//!
//! `MIRROR_TORTURE=200 cargo test --release -p mirror --test torture` is the long form; the default is short. Time is what
//! this test is about: the moments are drawn, and the run has to last longer than they do.

mod common;

use common::{Bench, Live, assert_nothing_left, instance, status, summary};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::collections::BTreeSet;
use std::time::Duration;

/// Accidents of the short form.
const FEW: u64 = 24;

/// The scene that ships ten times as fast, with plans that take a few milliseconds.
const SCENE: &str = "name = \"hasty\"
[clock]
rate = 10.0
[fog]
front_m = 13.0
side_m = 8.0
rear_m = 3.0
[planning]
horizon = 2
samples = 24
elites = 6
iterations = 2
";

#[test]
fn a_run_survives_whatever_happens_to_its_processes() {
    let accidents = match std::env::var("MIRROR_TORTURE") {
        Ok(text) => text.parse().expect("MIRROR_TORTURE is a number"),
        Err(_) => FEW,
    };
    let seed = 0x70_72_74;
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    let bench = Bench::new();
    bench.write_implants();
    let name = instance("torture");
    let file = bench.path("summary.json");
    let recording = bench.path("torture.mcap");
    let mut command = common::mirror();
    command
        .args(["up", "--clock", "realtime", "--quiet", "--restarts", "1000"])
        .args(["--episodes", &(accidents / 2 + 4).to_string()])
        .args(["--instance", &name, "--self-model"])
        .arg(bench.path("self.safetensors"))
        .arg("--implants")
        .arg(bench.path("implants.safetensors"))
        .arg("--scene")
        .arg(bench.write("hasty.toml", SCENE))
        .arg("--record")
        .arg(&recording)
        .arg("--summary")
        .arg(&file);
    let mut live = Live::start_quietly(&mut command, &name);
    let mut victims = BTreeSet::new();
    let mut done = 0;
    while done < accidents {
        std::thread::sleep(Duration::from_millis(u64::from(rng.next_u32() % 300)));
        let Some(state) = status(&name) else {
            panic!("the run ended after {done} of {accidents} accidents");
        };
        let processes = state["processes"].as_array().unwrap();
        if processes.is_empty() {
            continue;
        }
        let victim = &processes[rng.next_u32() as usize % processes.len()];
        let pid = victim["pid"].as_u64().unwrap() as libc::pid_t;
        let signal = [libc::SIGKILL, libc::SIGKILL, libc::SIGSTOP][rng.next_u32() as usize % 3];
        // SAFETY: signals a process of this test's set; one that has just died is not there to be signalled.
        if unsafe { libc::kill(pid, signal) } == 0 {
            victims.insert(pid);
            done += 1;
        }
    }
    let status = live.wait();
    let summary = summary(&file);
    assert_eq!(summary["completed"], true, "{summary:#}");
    // What is missing in the recording is counted, and the status says so.
    let recorded = summary["recording"]["complete"].as_bool();
    assert_eq!(status.success(), recorded == Some(true), "{summary:#}");
    assert_eq!(summary["ended_early"], serde_json::Value::Null);
    let deaths = summary["deaths"].as_array().unwrap();
    let died: Vec<_> = deaths.iter().map(|death| &death["process"]).collect();
    assert_eq!(deaths.len(), victims.len(), "{died:?}");
    assert_nothing_left(&name);
    let messages = decode_parts(&recording);
    assert!(messages > 0);
    eprintln!(
        "{accidents} accidents, {} deaths, {} hangs, {} restarts, {messages} messages recorded, {} steps",
        deaths.len(),
        summary["hangs"],
        summary["restarts"],
        summary["steps"],
    );
}

/// Reads every part of a recording up to where its recorder was killed; returns the messages.
fn decode_parts(first: &std::path::Path) -> usize {
    let mut messages = 0;
    let folder = first.parent().unwrap();
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        let path = entry.path();
        if path.extension().is_none_or(|extension| extension != "mcap") {
            continue;
        }
        let bytes = std::fs::read(&path).unwrap();
        let options = mcap::read::Options::IgnoreEndMagic;
        let Ok(stream) = mcap::MessageStream::new_with_options(&bytes, options.into()) else {
            continue; // killed before it wrote its first bytes
        };
        messages += stream.map_while(Result::ok).count();
    }
    messages
}
