//! Random processes of a real-time run are killed or stopped at random moments: the run ends by itself, every death is
//! counted, the recording decodes, and nothing stays behind.
//!
//! `MIRROR_TORTURE=200 cargo test --release -p mirror --test torture` is the long form; the default is short. Time is what
//! this test is about: the moments are drawn, and the run has to last longer than they do.

mod common;

use common::{Bench, Live, assert_nothing_left, instance, quick_scene, status, summary};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Accidents of the short form.
const FEW: u64 = 24;

/// The scene that ships ten times as fast, with plans that take a few milliseconds.
const HASTE: &str = "[clock]\nrate = 10.0\n";

#[test]
fn a_run_survives_whatever_happens_to_its_processes() {
    let accidents = match std::env::var("MIRROR_TORTURE") {
        Ok(text) => text.parse().expect("MIRROR_TORTURE is a number"),
        Err(_) => FEW,
    };
    let seed = 0x70_72_74;
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    let bench = Bench::new();
    let name = instance("torture");
    let file = bench.path("summary.json");
    let recording = bench.path("torture.mcap");
    let mut command = bench.planned(&name, &quick_scene(24, HASTE));
    command
        .args(["--clock", "realtime", "--quiet", "--restarts", "1000"])
        .args(["--episodes", &(accidents / 2 + 4).to_string(), "--record"])
        .arg(&recording)
        .arg("--summary")
        .arg(&file);
    let mut live = Live::start_quietly(&mut command, &name);
    let mut victims = BTreeMap::new();
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
            victims.insert(pid, (victim["process"].clone(), signal));
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
    assert_eq!(deaths.len(), victims.len(), "{died:?} of {victims:?}");
    assert_nothing_left(&name);
    let (messages, missing) = decode_parts(&recording);
    assert!(messages > 0);
    for (topic, counts) in summary["recording"]["topics"].as_object().unwrap() {
        // On these, every process counts for itself.
        if topic.starts_with("run/") {
            continue;
        }
        let lost = ["lost_ports", "lost_queue", "lost_disk", "lost_restart"];
        let counted: u64 = lost.iter().map(|lost| counts[lost].as_u64().unwrap()).sum();
        let missing = missing.get(topic).copied().unwrap_or(0);
        assert!(missing <= counted, "{topic}: {missing} missing, {counts}");
    }
    eprintln!(
        "{accidents} accidents, {} deaths, {} hangs, {} restarts, {messages} messages recorded, {} steps",
        deaths.len(),
        summary["hangs"],
        summary["restarts"],
        summary["steps"],
    );
}

/// Reads every part of a recording up to where its recorder was killed; returns how many messages there are, and by topic
/// how many the sequence numbers say are missing.
fn decode_parts(first: &std::path::Path) -> (usize, BTreeMap<String, u64>) {
    let mut messages = 0;
    // By topic: when sent, and sequence number.
    let mut found: BTreeMap<String, BTreeSet<(u64, u64)>> = BTreeMap::new();
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
        for message in stream.map_while(Result::ok) {
            messages += 1;
            let name = message.channel.topic.trim_start_matches('/');
            let word = |at: usize| {
                let bytes = message.data.get(at..at + 8)?;
                Some(u64::from_le_bytes(bytes.try_into().ok()?))
            };
            // Behind four bytes of CDR, every message of ours begins with run, sequence number and time sent.
            if let (Some(sequence), Some(sent_ns)) = (word(12), word(20))
                && message
                    .channel
                    .schema
                    .as_ref()
                    .is_some_and(|schema| schema.name.starts_with("mirror_msgs/"))
            {
                let topic = found.entry(name.to_owned()).or_default();
                topic.insert((sent_ns, sequence));
            }
        }
    }
    let missing = |(topic, sent): (String, BTreeSet<(u64, u64)>)| {
        let (mut missing, mut next) = (0, 0);
        for (_, sequence) in sent {
            // A sender that took another's place counts from 0 again.
            missing += if sequence >= next {
                sequence - next
            } else {
                sequence
            };
            next = sequence + 1;
        }
        (topic, missing)
    };
    (messages, found.into_iter().map(missing).collect())
}
