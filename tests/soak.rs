//! Many lockstep steps: no process's memory or file handles grow, no stretch of them is slow, and no wake-up is lost.
//!
//! `MIRROR_SOAK=100000 cargo test --release -p mirror --test soak -- --nocapture` is the long form, which also prints how
//! long a tick took at the beginning and at the end; the default is short.

mod common;

use common::{Bench, Live, instance, status};
use messages::{LidarFrame, topic};
use runtime::{InputOptions, Node, RunArguments};
use std::time::Duration;

/// Steps of the short form.
const FEW: u64 = 10_000;
/// Steps of a stretch, and what half of them may take at most on the slowest of machines: a set that no wake-up reaches looks
/// up four times a second.
const STRETCH: usize = 1000;
const SLOW_NS: u64 = 20_000_000;
/// What a process may grow by after the first tenth: its allocator's rounding, and the launcher's list of episodes.
const MOST_GROWTH_KIB: u64 = 1024;

/// Heap and stack of a process in KiB, and its file handles.
fn held(pid: u64) -> (u64, usize) {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find(|line| line.starts_with("RssAnon:"));
    let kib = line
        .and_then(|line| line.split_whitespace().nth(1))
        .unwrap();
    let handles = std::fs::read_dir(format!("/proc/{pid}/fd"))
        .unwrap()
        .count();
    (kib.parse().unwrap(), handles)
}

fn p99_us(ticks_ns: &mut [u64]) -> f64 {
    ticks_ns.sort_unstable();
    ticks_ns[ticks_ns.len() * 99 / 100] as f64 / 1000.0
}

#[test]
fn memory_and_handles_are_flat() {
    let steps = match std::env::var("MIRROR_SOAK") {
        Ok(text) => text.parse().expect("MIRROR_SOAK is a number"),
        Err(_) => FEW,
    };
    let bench = Bench::new();
    let name = instance("soak");
    let mut command = bench.up(&name);
    let file = bench.path("summary.json");
    command.args(["--episodes", "1000000", "--quiet", "--summary"]);
    command.arg(&file);
    let mut live = Live::start_quietly(&mut command, &name);
    let arguments = RunArguments {
        index: 99,
        ..RunArguments::new(
            &runtime::instance::root_for(&name),
            &name,
            0,
            runtime::ClockMode::Lockstep,
        )
        .unwrap()
    };
    let node = Node::join(&arguments).unwrap();
    let mut frames = node
        .input_with::<LidarFrame>(topic::LIDAR, InputOptions::recorder())
        .unwrap();
    let mut ticks_ns = Vec::with_capacity(steps as usize + 4096);
    let mut last = None;
    let mut warm = Vec::new();
    while (ticks_ns.len() as u64) < steps {
        if warm.is_empty() && ticks_ns.len() as u64 > steps / 10 {
            let processes = status(&name).expect("the run goes on")["processes"].clone();
            for process in processes.as_array().unwrap() {
                let pid = process["pid"].as_u64().unwrap();
                warm.push((
                    process["process"].as_str().unwrap().to_owned(),
                    pid,
                    held(pid),
                ));
            }
            let launcher = u64::from(live.child.id());
            warm.push(("launcher".to_owned(), launcher, held(launcher)));
        }
        let mut came = false;
        while let Some(frame) = frames.next().unwrap() {
            came = true;
            let (episode, sent_ns) = (frame.header.episode, frame.header.sent_ns);
            if let Some((before, at)) = last.replace((episode, sent_ns))
                && before == episode
            {
                ticks_ns.push(sent_ns - at);
            }
        }
        if !came {
            std::thread::sleep(Duration::from_millis(5)); // the buffer holds a thousand frames
        }
    }
    assert_eq!(frames.lost(), 0);
    let tenth = ticks_ns.len() / 10;
    let (first, last) = (
        p99_us(&mut ticks_ns[..tenth].to_vec()),
        p99_us(&mut ticks_ns[9 * tenth..].to_vec()),
    );
    eprintln!(
        "{} ticks; p99 of the first tenth {first:.1} µs, of the last {last:.1} µs",
        ticks_ns.len()
    );
    for (process, pid, (kib, handles)) in warm {
        let (kib_now, handles_now) = held(pid);
        eprintln!(
            "{process:<10} {kib:>7} KiB → {kib_now:>7} KiB   {handles} → {handles_now} handles"
        );
        assert!(
            kib_now <= kib + MOST_GROWTH_KIB,
            "{process}: {kib} → {kib_now} KiB"
        );
        assert!(
            handles_now <= handles,
            "{process}: {handles} → {handles_now} handles"
        );
    }
    drop(frames);
    drop(node);
    live.interrupt();
    live.wait();
    common::assert_nothing_left(&name);
    let slow = ticks_ns.chunks_exact_mut(STRETCH).filter_map(|stretch| {
        let (_, median, _) = stretch.select_nth_unstable(STRETCH / 2);
        (*median > SLOW_NS).then_some(*median)
    });
    let slow: Vec<_> = slow.collect();
    assert!(
        slow.is_empty(),
        "medians of slow stretches, in ns: {slow:?}"
    );
    let summary = common::summary(&file);
    assert_eq!(summary["lost_wakeups"], 0, "{}", summary["processes"]);
}
