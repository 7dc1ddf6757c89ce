//! `trace.json`: what every process did, in Chrome's trace format, which Perfetto and `chrome://tracing` open.
//!
//! One track per process; slices for computing and waiting; a flow arrow for every message that somebody used.

use crate::activity::{Activity, Flow};
use crate::metrics::label;
use crate::work::{StepReader, Stretch, StretchKind};
use messages::PROCESSES;
use serde_json::{Value, json};

/// Steps on either side of the typical and of the slowest step …
const AROUND: u32 = 250;
/// … and where each of them holds a plan with its questions and answers.
const AROUND_PLANS: u32 = 40;

/// A trace of the steps around these, each an episode and a step. Overlapping stretches of steps are written once.
/// `pids`: of the processes in launch order. `about` goes into the file's `otherData`, with the moment of the trace's
/// zero on the monotonic clock.
pub fn trace(reader: &StepReader, around: &[(u32, u32)], pids: &[u32], about: Value) -> Value {
    let mut windows: Vec<(u32, u32, u32)> = around
        .iter()
        .map(|(episode, step)| {
            let plans = reader.imagination(*episode, *step).is_some();
            let around = if plans { AROUND_PLANS } else { AROUND };
            (*episode, step.saturating_sub(around), step + around)
        })
        .collect();
    windows.sort_unstable();
    let mut merged: Vec<(u32, u32, u32)> = Vec::new();
    for window in windows {
        match merged.last_mut() {
            Some(last) if last.0 == window.0 && window.1 <= last.2 => last.2 = last.2.max(window.2),
            _ => merged.push(window),
        }
    }
    let activities: Vec<(u32, Activity)> = merged
        .into_iter()
        .map(|(episode, from, to)| (episode, Activity::of(reader, episode, from..=to)))
        .collect();
    let starts = activities
        .iter()
        .flat_map(|(_, activity)| &activity.stretches);
    let start = starts.map(|stretch| stretch.from).min().unwrap_or(0);
    let mut writer = Writer {
        pids,
        start,
        events: Vec::new(),
        flows: 0,
    };
    writer.name_tracks();
    for (episode, activity) in &activities {
        for stretch in &activity.stretches {
            writer.slice(*episode, stretch);
        }
        for flow in &activity.arrows {
            writer.flow(flow, &activity.stretches);
        }
    }
    json!({
        "traceEvents": writer.events, "displayTimeUnit": "ns",
        "otherData": { "start_monotonic_ns": start, "measured": about },
    })
}

struct Writer<'a> {
    pids: &'a [u32],
    start: u64,
    events: Vec<Value>,
    flows: u64,
}

impl Writer<'_> {
    fn pid(&self, process: usize) -> u32 {
        match self.pids.get(process) {
            // A process that was not found still has its own track.
            None | Some(0) => process as u32 + 1,
            Some(pid) => *pid,
        }
    }

    /// Microseconds since the beginning; the format's unit.
    fn us(&self, ns: u64) -> f64 {
        ns.saturating_sub(self.start) as f64 / 1000.0
    }

    fn name_tracks(&mut self) {
        for (place, name) in PROCESSES.iter().enumerate() {
            let pid = self.pid(place);
            for (what, arguments) in [
                ("process_name", json!({ "name": name })),
                ("process_sort_index", json!({ "sort_index": place })),
                ("thread_name", json!({ "name": "steps" })),
            ] {
                self.events.push(json!({
                    "ph": "M", "pid": pid, "tid": pid, "name": what, "args": arguments,
                }));
            }
        }
    }

    fn slice(&mut self, episode: u32, stretch: &Stretch) {
        let category = match stretch.kind {
            StretchKind::Compute(_) | StretchKind::Answer => "compute",
            StretchKind::Wait(_) | StretchKind::AwaitAnswers => "wait",
            StretchKind::Unknown => "unknown",
        };
        let pid = self.pid(stretch.process);
        self.events.push(json!({
            "ph": "X", "pid": pid, "tid": pid, "cat": category, "name": label(stretch.kind),
            "ts": self.us(stretch.from), "dur": (stretch.to - stretch.from) as f64 / 1000.0,
            "args": { "episode": episode },
        }));
    }

    /// An arrow binds to the slices that enclose its ends: the sender's last moment, the receiver's first.
    fn flow(&mut self, flow: &Flow, stretches: &[Stretch]) {
        let encloses = |process: usize, at: u64| {
            let after = stretches
                .partition_point(|stretch| (stretch.process, stretch.from) <= (process, at));
            let before = after.checked_sub(1).map(|place| &stretches[place]);
            before.is_some_and(|stretch| stretch.process == process && at < stretch.to)
        };
        let ends = [
            (flow.from, flow.sent.saturating_sub(1)),
            (flow.to, flow.used),
        ];
        let [from, mut to] = ends;
        if !encloses(to.0, to.1) {
            to.1 = to.1.saturating_sub(1);
        }
        // What was sent before the first step of the trace has no slice to come from.
        if to.1 < from.1 || !encloses(from.0, from.1) || !encloses(to.0, to.1) {
            return;
        }
        self.flows += 1;
        for (phase, (process, at)) in [("s", from), ("f", to)] {
            let pid = self.pid(process);
            let mut event = json!({
                "ph": phase, "pid": pid, "tid": pid, "cat": "message", "name": flow.topic,
                "id": self.flows, "ts": self.us(at),
            });
            if phase == "f" {
                event["bp"] = json!("e");
            }
            self.events.push(event);
        }
    }
}
