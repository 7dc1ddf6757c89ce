//! `profile.json`: everything that a profile says, with a version.

use crate::about::SetDescription;
use crate::activity::Activity;
use crate::cost::Cost;
use crate::graph::GraphTopic;
use crate::metrics::{self, Metric, PathPart, Samples, label, latency, latency_end};
use crate::system;
use crate::watch::{Observed, WatchEnd, Watched};
use crate::work::{StepReader, Stretch, StretchKind};
use messages::PROCESSES;
use messages::Report;
use runtime::{ClockMode, text_of};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Version of the file. Change it when a key changes its meaning or goes.
pub const SCHEMA: &str = "mirror.profile/1";

/// A profile. All times are in nanoseconds unless their name says otherwise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Profile {
    /// [`SCHEMA`].
    pub schema: String,
    /// The program's version.
    pub version: String,
    /// Under which conditions.
    pub measured: Measured,
    /// How much was seen.
    pub counts: Counts,
    /// Every figure.
    pub metrics: BTreeMap<String, Metric>,
    /// Where the latency of all steps goes, along their critical paths.
    pub path: Vec<PathPart>,
    /// The processes.
    pub processes: BTreeMap<String, ProcessProfile>,
    /// What the profiler itself took.
    pub own: Own,
    /// A step of median latency.
    pub typical: Option<Trace>,
    /// The step of greatest latency.
    pub slowest: Option<Trace>,
}

/// Under which conditions a profile was measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Name of the set.
    pub instance: String,
    /// Whether the set ran already; else it was started for this.
    pub attached: bool,
    /// What the set says about itself.
    #[serde(flatten)]
    pub about: SetDescription,
    /// How processes wait.
    pub waiting: String,
    /// Cores that processes may use.
    pub cores: usize,
    /// Load averages (1, 5, 15 minutes) before …
    pub load_before: [f64; 3],
    /// … and after.
    pub load_after: [f64; 3],
    /// Cores' worth of processor time that others than the set and the profiler used.
    pub others_busy_cores: f64,
    /// How long was watched.
    pub seconds: f64,
    /// Why watching ended.
    pub ended: String,
}

/// How much was seen.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Counts {
    /// Steps whose frame was seen.
    pub steps: u64,
    /// Episodes of which something was seen.
    pub episodes: u64,
    /// Messages taken.
    pub messages: u64,
    /// Of these, steps of which a belief, display or action was not seen: at the borders of what was watched, and in
    /// real time where a process passed a frame over.
    pub incomplete_steps: u64,
    /// Messages sent a second time for a step, as a late decision is shown again.
    pub repeated: u64,
    /// Messages whose step fits nowhere.
    pub unplaced: u64,
    /// Decisions that were planned.
    #[serde(default)]
    pub plans: u64,
    /// Futures that a decision rests on, on average.
    #[serde(default)]
    pub futures_per_plan: f64,
    /// Candidates × futures imagined for a decision, on average.
    #[serde(default)]
    pub samples_per_plan: f64,
    /// Messages that the profiler lost, by topic. They are missing above; nobody else lost them.
    pub profiler_lost: BTreeMap<String, u64>,
    /// Deadlines that processes counted as missed while watched.
    pub missed_deadlines: u64,
    /// Messages that processes of the set lost while watched, by topic.
    pub lost_messages: BTreeMap<String, u64>,
}

/// A process.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ProcessProfile {
    /// Process id.
    pub pid: u32,
    /// Processor time since its beginning when watching began and ended, in seconds (its clock
    /// `CLOCK_PROCESS_CPUTIME_ID`).
    pub cpu_s: Option<[f64; 2]>,
    /// Share of a core in between.
    pub cpu_share: Option<f64>,
    /// Share of the time in between that its threads could have run but had no core, summed over threads.
    pub queued_share: Option<f64>,
    /// Switches a second: because it waited, because its time was up (its first thread).
    pub switches_per_s: Option<[f64; 2]>,
    /// Threads.
    pub threads: Option<u64>,
    /// Memory resident, in KiB.
    pub rss_kib: Option<u64>,
    /// Its proportional share of memory: what several processes share is divided among them. In KiB.
    pub pss_kib: Option<u64>,
    /// From its own reports, as differences between the first and the last while watched; none if it gave none.
    pub reported: Option<Reported>,
}

/// What a process reported of itself.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Reported {
    /// Steps.
    pub steps: u64,
    /// Deadlines missed.
    pub missed_deadlines: u64,
    /// Heap allocations in the steady-state loop.
    pub allocations: u64,
    /// Messages lost at its inputs, by topic.
    pub lost: BTreeMap<String, u64>,
}

/// What the profiler itself took.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Own {
    /// Processor time while watching, in seconds.
    pub cpu_s: f64,
    /// As a share of a core.
    pub cpu_share: f64,
    /// Memory resident at the end, in KiB: it keeps every header that it saw.
    pub rss_kib: u64,
    /// How much it slows a tick; none where that was not measured.
    pub slowdown: Option<Cost>,
}

/// One step, in all processes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trace {
    /// Episode.
    pub episode: u32,
    /// Step.
    pub step: u32,
    /// Its latency: in lockstep the tick, in real time from sensing to decision.
    pub latency_ns: u64,
    /// The critical path from its beginning to its end, without gaps.
    pub path: Vec<Span>,
    /// Everything that all processes did in that time.
    pub spans: Vec<Span>,
    /// The messages that went in that time.
    pub arrows: Vec<Arrow>,
}

/// A stretch of a process's time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Span {
    /// The process.
    pub process: String,
    /// `compute`, `wait` (it could begin but has not), `answers` (it waits for them) or `unknown`.
    pub kind: String,
    /// What it does or waits for.
    pub what: String,
    /// From, in ns since the latency's beginning.
    pub from_ns: i64,
    /// To.
    pub to_ns: i64,
}

/// A message that somebody used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Arrow {
    /// Its topic.
    pub topic: String,
    /// Who sent it.
    pub from: String,
    /// When, in ns since the latency's beginning.
    pub sent_ns: i64,
    /// Who used it.
    pub to: String,
    /// When they began with it.
    pub used_ns: i64,
}

impl Profile {
    /// Sums up what was observed.
    pub fn new(
        instance: &str,
        attached: bool,
        observed: &Observed,
        samples: &Samples,
        slowdown: Option<Cost>,
    ) -> Self {
        let reader = observed.reader();
        let processes: BTreeMap<_, _> = observed
            .processes
            .iter()
            .enumerate()
            .filter(|(_, watched)| watched.pid != 0)
            .map(|(place, watched)| {
                let name = PROCESSES.get(place).copied().unwrap_or("launcher");
                (name.to_owned(), ProcessProfile::new(watched))
            })
            .collect();
        let own = own(observed, slowdown);
        let set_cpu: f64 = processes
            .values()
            .filter_map(|process| process.cpu_s)
            .map(|[before, after]| after - before)
            .sum();
        let busy = observed.machine[1]
            .busy_ns
            .saturating_sub(observed.machine[0].busy_ns) as f64
            * 1e-9;
        let measured = Measured {
            instance: instance.to_owned(),
            attached,
            waiting: match observed.about.spin_us {
                0 => "wake-up".to_owned(),
                us => format!("polling for {us} µs, then wake-up"),
            },
            about: observed.about.clone(),
            cores: system::cores(),
            load_before: observed.machine[0].load,
            load_after: observed.machine[1].load,
            others_busy_cores: ((busy - set_cpu - own.cpu_s) / observed.seconds.max(1e-9)).max(0.0),
            seconds: observed.seconds,
            ended: match observed.end {
                WatchEnd::Enough => "everything asked for was seen",
                WatchEnd::Full => "no more steps could be kept",
                WatchEnd::RunOver => "the run ended",
                WatchEnd::Stop => "interrupted",
            }
            .to_owned(),
        };
        let [typical, slowest] = pick(&reader);
        Self {
            schema: SCHEMA.to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            measured,
            counts: counts(observed, &processes),
            metrics: samples.metrics(),
            path: metrics::path_parts(&reader),
            processes,
            own,
            typical: typical.and_then(|(episode, step)| trace(&reader, episode, step)),
            slowest: slowest.and_then(|(episode, step)| trace(&reader, episode, step)),
        }
    }
}

impl Observed {
    /// Reads work out of what was observed.
    pub fn reader(&self) -> StepReader<'_> {
        StepReader {
            table: &self.table,
            clock: self.about.clock.unwrap_or(ClockMode::Lockstep),
        }
    }
}

fn own(observed: &Observed, slowdown: Option<Cost>) -> Own {
    let [before, after] = observed.own;
    let cpu_s = (after.cpu_ns - before.cpu_ns) as f64 * 1e-9;
    Own {
        cpu_s,
        cpu_share: cpu_s / observed.seconds.max(1e-9),
        rss_kib: system::memory_kib(std::process::id()).map_or(0, |(rss, _)| rss),
        slowdown,
    }
}

fn counts(observed: &Observed, processes: &BTreeMap<String, ProcessProfile>) -> Counts {
    let table = &observed.table;
    let answers = [
        GraphTopic::RobotBelief,
        GraphTopic::HumanBelief,
        GraphTopic::Display,
        GraphTopic::Action,
    ];
    let (mut steps, mut incomplete_steps) = (0, 0);
    for (.., step) in table.iter() {
        // What ends an episode has no frame.
        if step.sensed().is_some() {
            steps += 1;
            let complete = answers.iter().all(|topic| step.mark(*topic).is_some());
            incomplete_steps += u64::from(!complete);
        }
    }
    let mut lost_messages = BTreeMap::new();
    let reported = || {
        processes
            .values()
            .filter_map(|process| process.reported.as_ref())
    };
    for (topic, lost) in reported().flat_map(|reported| &reported.lost) {
        *lost_messages.entry(topic.clone()).or_default() += lost;
    }
    Counts {
        steps,
        episodes: table.episodes() as u64,
        messages: observed.messages,
        incomplete_steps,
        repeated: table.repeated,
        unplaced: table.unplaced,
        plans: table.plans.plans,
        futures_per_plan: table.plans.futures as f64 / table.plans.plans.max(1) as f64,
        samples_per_plan: table.plans.samples as f64 / table.plans.plans.max(1) as f64,
        profiler_lost: observed.lost.clone(),
        missed_deadlines: reported().map(|reported| reported.missed_deadlines).sum(),
        lost_messages,
    }
}

impl ProcessProfile {
    fn new(watched: &Watched) -> Self {
        let mut profile = Self {
            pid: watched.pid,
            rss_kib: watched.memory_kib.map(|(rss, _)| rss),
            pss_kib: watched.memory_kib.map(|(_, pss)| pss),
            reported: watched.reports.as_deref().map(Reported::between),
            ..Self::default()
        };
        // Of one that ended before it was looked at again, nothing is known.
        let usage = watched
            .usage
            .filter(|[before, after]| after.at_ns > before.at_ns);
        if let Some([before, after]) = usage {
            let ns = (after.at_ns - before.at_ns) as f64;
            let share = |before: u64, after: u64| after.saturating_sub(before) as f64 / ns;
            profile.cpu_s = Some([before, after].map(|usage| usage.cpu_ns as f64 * 1e-9));
            profile.cpu_share = Some(share(before.cpu_ns, after.cpu_ns));
            profile.queued_share = Some(share(before.queued_ns, after.queued_ns));
            profile.switches_per_s = Some(std::array::from_fn(|kind| {
                share(before.switches[kind], after.switches[kind]) * 1e9
            }));
            profile.threads = Some(after.threads);
        }
        profile
    }
}

impl Reported {
    fn between(reports: &[Report; 2]) -> Self {
        let [first, last] = reports;
        // A restarted process began to count anew.
        let first = Some(first).filter(|first| first.pid == last.pid);
        let since = |count: fn(&Report) -> u64| count(last).saturating_sub(first.map_or(0, count));
        let ports = |report: &Report| {
            let mut lost = BTreeMap::<String, u64>::new();
            for port in report.ports.iter().take(report.port_count as usize) {
                *lost.entry(text_of(&port.topic)).or_default() += port.lost;
            }
            lost
        };
        let mut lost = ports(last);
        for (topic, before) in first.map(ports).unwrap_or_default() {
            if let Some(lost) = lost.get_mut(&topic) {
                *lost = lost.saturating_sub(before);
            }
        }
        Self {
            steps: since(|report| report.steps),
            missed_deadlines: since(|report| report.missed_deadlines),
            allocations: since(|report| report.allocations),
            lost,
        }
    }
}

/// Steps of median and of greatest latency.
fn pick(reader: &StepReader) -> [Option<(u32, u32)>; 2] {
    let mut all: Vec<(u64, u32, u32)> = reader
        .table
        .iter()
        .filter_map(|(episode, step, _)| {
            let (from, to) = latency(reader, episode, step)?;
            Some((to - from, episode, step))
        })
        .collect();
    all.sort_unstable();
    let place = |index: Option<usize>| {
        let (_, episode, step) = *all.get(index?)?;
        Some((episode, step))
    };
    [
        place(all.len().checked_sub(1).map(|last| last / 2)),
        place(all.len().checked_sub(1)),
    ]
}

/// Everything that happened during a step's latency.
fn trace(reader: &StepReader, episode: u32, step: u32) -> Option<Trace> {
    let (from, to) = latency(reader, episode, step)?;
    let end = latency_end(reader, episode, step + 1)?;
    let since = |ns: u64| ns as i64 - from as i64;
    let span = |stretch: &Stretch| Span {
        process: PROCESSES[stretch.process].to_owned(),
        kind: match stretch.kind {
            StretchKind::Compute(_) | StretchKind::Answer => "compute",
            StretchKind::Wait(_) => "wait",
            StretchKind::AwaitAnswers => "answers",
            StretchKind::Unknown => "unknown",
        }
        .to_owned(),
        what: label(stretch.kind),
        from_ns: since(stretch.from),
        to_ns: since(stretch.to),
    };
    let path = reader.path(end, episode, step + 1, from);
    // A process may be behind by as many steps as the world lets the human model be.
    let (first, last) = (step.saturating_sub(20), step + 1);
    let activity = Activity::of(reader, episode, first..=last);
    let overlaps = |a: u64, b: u64| a < to && b > from;
    Some(Trace {
        episode,
        step,
        latency_ns: to - from,
        path: path.iter().map(span).collect(),
        spans: activity
            .stretches
            .iter()
            .filter(|stretch| overlaps(stretch.from, stretch.to))
            .map(span)
            .collect(),
        arrows: activity
            .arrows
            .iter()
            .filter(|flow| overlaps(flow.sent, flow.used.max(flow.sent + 1)))
            .map(|flow| Arrow {
                topic: flow.topic.to_owned(),
                from: PROCESSES[flow.from].to_owned(),
                sent_ns: since(flow.sent),
                to: PROCESSES[flow.to].to_owned(),
                used_ns: since(flow.used),
            })
            .collect(),
    })
}
