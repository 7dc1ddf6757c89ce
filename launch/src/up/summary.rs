//! The end of a run as JSON; `summary_text.rs` has the same as a table for people.

use super::decisions::Decisions;
use super::ended::Cause;
use super::plan::RunPlan;
use super::plans::Plans;
use super::supervise::Death;
use super::swap_report::SwapReport;
use super::tally::{EpisodeTally, Tally, VOID};
use crate::place::ItemNames;
use crate::process::NAMES;
use anyhow::{Context, Result};
use messages::{ProcessState, Report};
use recorder::result::RecorderResult;
use runtime::{ClockMode, text_of};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Compute time per step, in µs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 90th percentile.
    pub p90: f64,
    /// 99th percentile.
    pub p99: f64,
    /// 99.9th percentile.
    pub p999: f64,
    /// Longest.
    pub max: f64,
}

impl Percentiles {
    /// From nanoseconds, in this order.
    pub fn from_ns(ns: [u64; 5]) -> Self {
        let [p50, p90, p99, p999, max] = ns.map(|ns| ns as f64 / 1000.0);
        Self {
            p50,
            p90,
            p99,
            p999,
            max,
        }
    }
}

/// How a process fared.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ProcessSummary {
    /// Steps done.
    pub steps: u64,
    /// Deadlines missed.
    pub missed_deadlines: u64,
    /// Heap allocations in its steady-state loop.
    pub allocations: u64,
    /// Messages that waited for it to look up, because the transport lost the wake-up.
    pub lost_wakeups: u64,
    /// `finished`, or how it ended.
    pub end: String,
}

/// The summary's JSON.
#[derive(Clone, Debug, Serialize)]
pub struct RunSummary {
    /// Scene.
    pub scene: String,
    /// What the scene's reader passed over: which of several planning problems is driven, what was left out.
    pub notes: Vec<String>,
    /// Human model.
    pub human: String,
    /// Planner.
    pub planner: String,
    /// Who drove.
    pub driver: String,
    /// `lockstep` or `realtime`.
    pub clock: ClockMode,
    /// Seed.
    pub seed: u64,
    /// Whether every episode was driven to its end.
    pub completed: bool,
    /// Why the run ended before that.
    pub ended_early: Option<String>,
    /// Processes that ended before the run did, in order.
    pub deaths: Vec<Death>,
    /// Those of them that crashed: a signal for what they did themselves, such as SIGSEGV, or a panic.
    pub crashes: u64,
    /// Those of them that were killed by another signal, which the launcher did not send.
    pub killed: u64,
    /// Episodes driven to their ends.
    pub episodes: u32,
    /// Control steps.
    pub steps: u64,
    /// Episodes that ended in a collision.
    pub collisions: u64,
    /// Mean over episodes of an episode's summed reward; none without an episode.
    pub reward_mean: Option<f64>,
    /// Visual items shown (on the highway, sectors highlighted), summed over steps.
    pub visual_items: u64,
    /// Utterances.
    pub verbal_items: u64,
    /// Cost of all that was communicated.
    pub communication_cost: f64,
    /// Deadlines missed, over all processes; only the real-time clock has any.
    pub missed_deadlines: u64,
    /// In real time, how many steps had a decision in time; none in lockstep, where everybody waits for it, and without
    /// a planner.
    pub decisions: Option<Decisions>,
    /// What the decisions rested on; none where nothing was planned.
    pub plans: Option<Plans>,
    /// Messages lost at any port, by topic.
    pub lost_messages: BTreeMap<String, u64>,
    /// Messages that waited for a process to look up, because the transport lost the wake-up, over all processes.
    pub lost_wakeups: u64,
    /// Processes started again.
    pub restarts: u64,
    /// Processes that did not answer and were killed; their deaths count, too.
    pub hangs: u64,
    /// Processes replaced on request, in order.
    pub swaps: Vec<SwapReport>,
    /// Episodes that ended with the world's death, or because nobody was at the wheel any more; they do not count.
    pub void_episodes: u32,
    /// Lines that were not printed because nobody read them.
    pub dropped_lines: u64,
    /// Seconds from the start of the first episode to the end of the last.
    pub wall_seconds: f64,
    /// Digest of every recorded message of a lockstep run.
    pub digest: Option<String>,
    /// Per process, compute time per step.
    pub compute_us: BTreeMap<String, Percentiles>,
    /// Per process, heap allocations in the steady-state loop.
    pub allocations: BTreeMap<String, u64>,
    /// From sensing to decision and to display.
    pub latency_us: BTreeMap<String, Percentiles>,
    /// Per process, the rest.
    pub processes: BTreeMap<String, ProcessSummary>,
    /// What was recorded.
    pub recording: Option<RecorderResult>,
    /// What happened in each episode.
    pub episode_list: Vec<EpisodeTally>,
    /// What can be communicated.
    #[serde(skip)]
    pub items: ItemNames,
}

/// What the launcher learned besides the tally.
#[derive(Default)]
pub struct RunEnding {
    /// Each process's last report.
    pub reports: [Option<Report>; NAMES.len()],
    /// Who ended before the run did.
    pub deaths: Vec<Death>,
    /// Processes started again.
    pub restarts: u64,
    /// Processes that hung.
    pub hangs: u64,
    /// Reports that waited for the launcher to look up, because the transport lost the wake-up.
    pub launcher_lost_wakeups: u64,
    /// Processes replaced.
    pub swaps: Vec<SwapReport>,
    /// Why the run ended early, if it did.
    pub ended_early: Option<String>,
    /// Seconds from start to end.
    pub wall_seconds: f64,
    /// What the recorder says.
    pub recording: Option<RecorderResult>,
}

impl RunSummary {
    /// Puts it together.
    pub fn new(plan: &RunPlan, tally: &Tally, ending: RunEnding) -> Self {
        let done = tally
            .episodes
            .iter()
            .filter(|episode| !["running", VOID].contains(&episode.end));
        let rewards: Vec<f64> = done.clone().map(|episode| episode.reward).collect();
        let given_up = tally.episodes.iter().filter(|episode| episode.end == VOID);
        let given_up = given_up.count();
        let sum = |of: fn(&EpisodeTally) -> u64| tally.episodes.iter().map(of).sum();
        let died_of = |cause| {
            let of_it = ending.deaths.iter().filter(|death| death.cause == cause);
            of_it.count() as u64
        };
        let (crashes, killed) = (died_of(Cause::Crash), died_of(Cause::Signal));
        let mut summary = Self {
            scene: plan.scene.name.clone(),
            notes: plan.scene.notes().to_vec(),
            human: plan.kind_of_process("human"),
            planner: plan.planner.name().to_owned(),
            driver: plan.driver.name.clone(),
            clock: plan.clock,
            seed: plan.seed,
            completed: tally.episodes.len() == plan.episodes as usize
                && tally
                    .episodes
                    .last()
                    .is_some_and(|episode| episode.end != "running"),
            ended_early: ending.ended_early,
            episodes: rewards.len() as u32,
            steps: tally.steps(),
            collisions: sum(|episode| u64::from(episode.hit.is_some())),
            reward_mean: (!rewards.is_empty())
                .then(|| rewards.iter().sum::<f64>() / rewards.len() as f64),
            visual_items: sum(|episode| episode.visual_items),
            verbal_items: sum(|episode| episode.verbal_items),
            communication_cost: tally
                .episodes
                .iter()
                .fold(0.0, |sum, episode| sum + episode.communication_cost),
            missed_deadlines: 0,
            decisions: tally.decisions(),
            plans: tally.plans(),
            lost_messages: BTreeMap::new(),
            lost_wakeups: ending.launcher_lost_wakeups,
            crashes,
            killed,
            restarts: ending.restarts,
            hangs: ending.hangs,
            void_episodes: tally
                .episodes
                .iter()
                .rev()
                .skip(1)
                .filter(|episode| episode.end == "running")
                .count() as u32
                + given_up as u32,
            dropped_lines: 0,
            wall_seconds: ending.wall_seconds,
            digest: None,
            compute_us: BTreeMap::new(),
            allocations: BTreeMap::new(),
            latency_us: BTreeMap::from([
                (
                    "sensing_to_decision".to_owned(),
                    Percentiles::from_ns(tally.sensing_to_decision.summary_ns()),
                ),
                (
                    "sensing_to_display".to_owned(),
                    Percentiles::from_ns(tally.sensing_to_display.summary_ns()),
                ),
            ]),
            processes: BTreeMap::new(),
            recording: ending.recording,
            episode_list: tally.episodes.clone(),
            items: tally.items,
            deaths: ending.deaths,
            swaps: ending.swaps,
        };
        for (name, report) in NAMES.into_iter().zip(&ending.reports) {
            summary.add_process(name, report.as_ref());
        }
        for (topic, lost) in tally.lost() {
            *summary.lost_messages.entry(topic.to_owned()).or_default() += lost;
        }
        let undisturbed = summary.deaths.is_empty() && summary.swaps.is_empty();
        if plan.clock == ClockMode::Lockstep && summary.completed && undisturbed {
            summary.digest = summary
                .recording
                .as_ref()
                .map(|recording| recording.digest.clone())
                .filter(|digest| !digest.is_empty());
        }
        summary
    }

    fn add_process(&mut self, name: &str, report: Option<&Report>) {
        let finished = report.is_some_and(|report| report.state() == Ok(ProcessState::Finished));
        let death = self.deaths.iter().rev().find(|death| death.process == name);
        let end = match death {
            _ if finished => "finished".to_owned(),
            Some(death) => death.how.clone(),
            None => "was ended".to_owned(),
        };
        let mut process = ProcessSummary {
            end,
            ..ProcessSummary::default()
        };
        if let Some(report) = report {
            process.steps = report.steps;
            process.missed_deadlines = report.missed_deadlines;
            process.allocations = report.allocations;
            process.lost_wakeups = report.lost_wakeups;
            self.lost_wakeups += report.lost_wakeups;
            self.missed_deadlines += report.missed_deadlines;
            self.compute_us
                .insert(name.to_owned(), Percentiles::from_ns(report.compute_ns));
            self.allocations.insert(name.to_owned(), report.allocations);
            for port in report.ports.iter().take(report.port_count as usize) {
                *self.lost_messages.entry(text_of(&port.topic)).or_default() += port.lost;
            }
        }
        self.processes.insert(name.to_owned(), process);
    }

    /// Whether all went as asked, and none of our own processes crashed.
    pub fn is_success(&self) -> bool {
        let recorded = self
            .recording
            .as_ref()
            .is_none_or(|recording| recording.complete);
        let crashed = self.deaths.iter().any(is_our_crash);
        self.completed && self.ended_early.is_none() && recorded && !crashed
    }

    /// Writes the JSON.
    ///
    /// # Errors
    /// Names the file.
    pub fn save(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).context("the summary")?;
        Ok(files::write(path, (text + "\n").as_bytes())?)
    }
}

/// Whether one of our own processes crashed: a bug.
pub fn is_our_crash(death: &Death) -> bool {
    death.is_ours && death.cause == Cause::Crash
}
