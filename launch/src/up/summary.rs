//! The end of a run: a table for people, and the same as JSON.

use super::decisions::Decisions;
use super::plan::Plan;
use super::supervise::{Cause, Death};
use super::swap::SwapReport;
use super::tally::{Episode, Tally};
use crate::place::ItemNames;
use crate::process::NAMES;
use anyhow::{Context, Result};
use messages::{ProcessState, Report};
use profiler::units::{count, time_us};
use recorder::result::RecorderResult;
use runtime::{ClockMode, text_of};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

/// Episodes that the text lists.
const MOST_EPISODES: usize = 40;

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
pub struct Summary {
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
    /// In real time, how many steps had a decision in time; none in lockstep, where everybody waits for it, and without a
    /// planner.
    pub decisions: Option<Decisions>,
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
    /// Episodes that ended with the world's death.
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
    pub episode_list: Vec<Episode>,
    /// What can be communicated.
    #[serde(skip)]
    items: ItemNames,
}

/// What the launcher learned besides the tally.
#[derive(Default)]
pub struct Ending {
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

impl Summary {
    /// Puts it together.
    pub fn new(plan: &Plan, tally: &Tally, ending: Ending) -> Self {
        let done = tally
            .episodes
            .iter()
            .filter(|episode| episode.end != "running");
        let rewards: Vec<f64> = done.clone().map(|episode| episode.reward).collect();
        let sum = |of: fn(&Episode) -> u64| tally.episodes.iter().map(of).sum();
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
                .count() as u32,
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

    /// The summary for people, with colours or without.
    pub fn text(&self, colours: bool) -> String {
        let mut out = String::new();
        self.write_episodes(&mut out);
        self.write_totals(&mut out);
        self.write_processes(&mut out);
        self.write_signals(&mut out, colours);
        out
    }

    /// The last word: who died of a signal that the launcher did not send, for the run went on without them.
    fn write_signals(&self, out: &mut String, colours: bool) {
        let (red, plain) = match colours {
            true => ("\x1b[1;31m", "\x1b[0m"),
            false => ("", ""),
        };
        for (cause, word) in [(Cause::Signal, "KILLED"), (Cause::Crash, "CRASHED")] {
            let died: Vec<_> = self.deaths.iter().filter(|d| d.cause == cause).collect();
            if died.is_empty() {
                continue;
            }
            let listed: Vec<String> = died.iter().take(20).map(|death| brief(death)).collect();
            let more = match died.len() - listed.len() {
                0 => String::new(),
                more => format!(", and {more} more"),
            };
            let status = match died.iter().any(|death| is_our_crash(death)) {
                true => " · exit status 1",
                false => "",
            };
            let _ = writeln!(
                out,
                "{red}{word} {}{more}{status}{plain}",
                listed.join(", ")
            );
        }
    }

    fn write_episodes(&self, out: &mut String) {
        if self.episode_list.is_empty() {
            return;
        }
        let _ = writeln!(
            out,
            "\nepisode  steps  end            reward  highlights  utterances"
        );
        // After a long run, its beginning and its end; the summary file has all.
        let all = self.episode_list.len();
        let (first, last) = match all > MOST_EPISODES {
            true => (MOST_EPISODES / 2, all - MOST_EPISODES / 2),
            false => (all, all),
        };
        for episode in &self.episode_list[..first] {
            self.write_episode(episode, out);
        }
        if first < last {
            let left_out = count((last - first) as u64, "episode");
            let _ = writeln!(out, "      …  {left_out} more (--summary FILE has all)");
        }
        for episode in &self.episode_list[last..] {
            self.write_episode(episode, out);
        }
    }

    fn write_episode(&self, episode: &Episode, out: &mut String) {
        let Episode {
            episode: number,
            steps,
            end,
            reward,
            said,
            shown,
            notices,
            ..
        } = episode;
        let (highlights, utterances) = (shown.len(), said.len());
        let end = match *end {
            "running" => "not ended",
            end => end,
        };
        let _ = writeln!(
            out,
            "{number:>7}  {steps:>5}  {end:<11}  {reward:>8.1}  {highlights:>10}  {utterances:>10}"
        );
        for said in said {
            let _ = writeln!(out, "         {:>6.2} s  “{}”", said.time_s, said.text);
        }
        for name in self.items.visual {
            let mut of_item = shown.iter().filter(|shown| shown.item == *name).peekable();
            if let Some(first) = of_item.peek() {
                let from_s = first.time_s;
                let lit_s = of_item.fold(0.0, |sum, shown| sum + shown.duration_s);
                let _ = writeln!(
                    out,
                    "         {from_s:>6.2} s  highlighted {name}, for {lit_s:.1} s in all"
                );
            }
        }
        for notice in notices {
            let _ = writeln!(out, "         {:>6.2} s  {}", notice.time_s, notice.text);
        }
    }

    fn write_totals(&self, out: &mut String) {
        let Self {
            scene,
            human,
            planner,
            driver,
            seed,
            episodes,
            steps,
            ..
        } = self;
        let _ = writeln!(
            out,
            "\nscene {scene} · driver {driver} · human model {human} · planner {planner} · seed {seed}"
        );
        let seconds = self.wall_seconds;
        let _ = write!(
            out,
            "{}, {} in {} ({:.0} steps/s) · {} with a collision",
            count(u64::from(*episodes), "whole episode"),
            count(*steps, "step"),
            time_us(seconds * 1e6),
            *steps as f64 / seconds.max(1e-9),
            self.collisions,
        );
        let _ = match self.reward_mean {
            Some(mean) => writeln!(out, " · mean reward {mean:.1}"),
            None => writeln!(out),
        };
        let _ = write!(
            out,
            "highlighted {} × steps {} · utterances {} · cost {:.2}",
            self.items.word, self.visual_items, self.verbal_items, self.communication_cost,
        );
        let _ = match self.clock {
            ClockMode::Lockstep => write!(out, " · lockstep"),
            ClockMode::RealTime => write!(
                out,
                " · real time, missed deadlines of all processes {}",
                self.missed_deadlines
            ),
        };
        let _ = writeln!(out, " · restarts {}", self.restarts);
        if let Some(decisions) = &self.decisions {
            let _ = match decisions.keeps_up() {
                true => writeln!(out, "decisions: {}", decisions.text()),
                false => writeln!(
                    out,
                    "NOT ASSISTED IN TIME: {} (`mirror doctor` says what this machine can do)",
                    decisions.text()
                ),
            };
        }
        let lost: Vec<_> = self
            .lost_messages
            .iter()
            .filter(|(_, lost)| **lost > 0)
            .collect();
        if lost.is_empty() {
            let _ = writeln!(out, "no message lost");
        }
        for (topic, lost) in lost {
            let _ = writeln!(out, "LOST {} on {topic}", count(*lost, "message"));
        }
        if self.lost_wakeups > 0 {
            let counts = |(name, process): (&String, &ProcessSummary)| {
                (process.lost_wakeups > 0).then(|| format!("{name} {}", process.lost_wakeups))
            };
            let by: Vec<_> = self.processes.iter().filter_map(counts).collect();
            let by = by.join(", "); // what is missing, the launcher lost
            let _ = writeln!(
                out,
                "LOST {} wake-ups ({by}): found by looking up, which slowed the run",
                self.lost_wakeups
            );
        }
        if let Some(digest) = &self.digest {
            let _ = writeln!(out, "digest {digest}");
        }
        if let Some(recording) = &self.recording
            && let Some(file) = &recording.file
        {
            let word = if recording.complete {
                "complete"
            } else {
                "INCOMPLETE"
            };
            let _ = writeln!(out, "recording {} ({word})", file.display());
            if let Some(error) = &recording.error {
                let _ = writeln!(out, "  {error}");
            }
        }
        self.write_deaths(out);
        if let Some(reason) = &self.ended_early {
            let _ = writeln!(out, "ENDED EARLY: {reason}");
        }
    }

    fn write_deaths(&self, out: &mut String) {
        // After a long run of accidents, numbers say more than a list.
        let listed = self.deaths.len().min(20);
        for Death {
            process,
            how,
            position,
            back_after_ms,
            ..
        } in &self.deaths[..listed]
        {
            let at = position.map_or(String::new(), |(e, s)| {
                format!(" after episode {e} step {s}")
            });
            let back = back_after_ms.map_or(String::new(), |ms| format!("; back after {ms:.0} ms"));
            let _ = writeln!(out, "DIED {process} {how}{at}{back}");
        }
        if listed < self.deaths.len() {
            let _ = writeln!(out, "… {} deaths in all", self.deaths.len());
        }
        if self.void_episodes > 0 {
            let _ = writeln!(
                out,
                "{} void",
                count(u64::from(self.void_episodes), "episode")
            );
        }
        for swap in &self.swaps {
            let (episode, step) = swap.handover.unwrap_or_default();
            let _ = writeln!(
                out,
                "SWAPPED {}: {} → {} from episode {episode} step {step} on; steps without an answer {}",
                swap.process, swap.from, swap.to, swap.ticks_without_answer
            );
        }
    }

    fn write_processes(&self, out: &mut String) {
        if self.compute_us.is_empty() {
            return;
        }
        let _ = writeln!(
            out,
            "\ncompute time per step      p50       p90       p99     p99.9       max   allocations"
        );
        for name in NAMES {
            let (Some(times), Some(process)) =
                (self.compute_us.get(name), self.processes.get(name))
            else {
                continue;
            };
            let Percentiles {
                p50,
                p90,
                p99,
                p999,
                max,
            } = *times;
            let columns = [p50, p90, p99, p999, max].map(|us| format!("{:>10}", time_us(us)));
            let (columns, allocations) = (columns.concat(), process.allocations);
            let _ = writeln!(out, "  {name:<18}{columns}{allocations:>14}");
        }
    }
}

fn is_our_crash(death: &Death) -> bool {
    death.is_ours && death.cause == Cause::Crash
}

/// Who, by which signal, and where in the run.
fn brief(death: &Death) -> String {
    let Death {
        process,
        signal,
        position,
        is_ours,
        ..
    } = death;
    let what = signal.as_deref().unwrap_or("panic");
    let whose = if *is_ours { "" } else { "a foreign " };
    let at = position.map_or(String::new(), |(e, s)| format!(", episode {e} step {s}"));
    format!("{whose}{process} ({what}{at})")
}
