//! The end of a run as a table for people.

use super::ended::Cause;
use super::summary::{Percentiles, ProcessSummary, RunSummary, is_our_crash};
use super::supervise::Death;
use super::tally::{EpisodeTally, Why};
use crate::process::NAMES;
use profiler::units::{count, time_us};
use runtime::ClockMode;
use std::fmt::Write;

/// Episodes that the text lists.
const MOST_EPISODES: usize = 40;

impl RunSummary {
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

    fn write_episode(&self, episode: &EpisodeTally, out: &mut String) {
        let EpisodeTally {
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
            let why = match said.why {
                Why { futures: 0, .. } => String::new(),
                Why {
                    gain_now,
                    gain_later,
                    cost,
                    ..
                } if gain_now > 0.0 => {
                    format!("  gains {gain_now:.1} now, {gain_later:.1} later; costs {cost:.1}")
                }
                Why { cost, .. } => format!("  costs {cost:.1}"),
            };
            let _ = writeln!(out, "         {:>6.2} s  “{}”{why}", said.time_s, said.text);
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
        if let Some(plans) = self.plans.filter(|plans| plans.weighed > 0) {
            let _ = writeln!(out, "plans: {}", plans.text());
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
