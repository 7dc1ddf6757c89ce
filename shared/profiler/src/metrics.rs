//! Figures over all steps: what is measured, its percentiles, and its blocks for later comparisons.

use crate::graph::{EDGES, GraphTopic, STEP_ENDS};
use crate::table::StepTable;
use crate::work::{StepReader, StretchKind};
use messages::PROCESSES;
use runtime::ClockMode;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A figure's samples are cut, in the order of time, into so many blocks of equal length.
pub const BLOCKS: usize = 20;
/// A block's percentile is kept if so many of its samples lie beyond it: fewer would make it a maximum.
const BEYOND: f64 = 2.0;

/// Percentiles of one figure, in ns, with nothing left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Metric {
    /// What it is, for people.
    pub what: String,
    /// Samples.
    pub count: u64,
    /// Mean.
    pub mean: f64,
    /// Median.
    pub p50: u64,
    /// 90th percentile.
    pub p90: u64,
    /// 99th percentile.
    pub p99: u64,
    /// 99.9th percentile.
    pub p999: u64,
    /// Longest.
    pub max: u64,
    /// Samples that are a lower limit of zero, because the process must have begun before its newest input came.
    pub clamped: u64,
    /// Median of each block.
    pub block_p50: Vec<u64>,
    /// 99th percentile of each block; empty where blocks are too short for one.
    pub block_p99: Vec<u64>,
}

/// The nearest-rank quantile of sorted samples.
pub fn quantile(sorted: &[u64], quantile: f64) -> u64 {
    let rank = (quantile * sorted.len() as f64).ceil().max(1.0) as usize;
    sorted.get(rank - 1).copied().unwrap_or(0)
}

impl Metric {
    /// From samples in the order of time.
    pub fn new(what: &str, samples: &[u64], clamped: u64) -> Self {
        let mut sorted = samples.to_vec();
        sorted.sort_unstable();
        let at = |q| quantile(&sorted, q);
        let (mut block_p50, mut block_p99) = (Vec::new(), Vec::new());
        let length = samples.len() / BLOCKS;
        for block in 0..BLOCKS {
            let mut block = samples[block * length..(block + 1) * length].to_vec();
            block.sort_unstable();
            if block.len() as f64 * 0.5 >= BEYOND {
                block_p50.push(quantile(&block, 0.5));
            }
            if block.len() as f64 * 0.01 >= BEYOND {
                block_p99.push(quantile(&block, 0.99));
            }
        }
        Self {
            what: what.to_owned(),
            count: samples.len() as u64,
            mean: samples.iter().map(|ns| *ns as f64).sum::<f64>() / samples.len().max(1) as f64,
            p50: at(0.5),
            p90: at(0.9),
            p99: at(0.99),
            p999: at(0.999),
            max: at(1.0),
            clamped,
            block_p50,
            block_p99,
        }
    }
}

/// The samples of every figure.
#[derive(Default)]
pub struct Samples {
    figures: BTreeMap<String, Figure>,
}

#[derive(Default)]
struct Figure {
    what: String,
    ns: Vec<u64>,
    clamped: u64,
}

/// A figure's name: what is measured, of what.
pub fn compute_of(process: usize) -> String {
    format!("compute {}", PROCESSES[process])
}

/// See [`compute_of`].
pub fn wait_of(edge: usize) -> String {
    format!("wait {}", EDGES[edge].name())
}

/// See [`compute_of`].
pub fn hop_of(edge: usize) -> String {
    format!("hop {}", EDGES[edge].name())
}

/// From one frame to the next.
pub const TICK: &str = "tick";
/// From sensing to the display of the same step.
pub const TO_DISPLAY: &str = "sensing to display";
/// From sensing to the decision about it.
pub const TO_DECISION: &str = "sensing to decision";
/// From sensing to the display that shows the decision about it.
pub const TO_SHOWN: &str = "sensing to shown decision";
/// What the human model computes for all answers of a plan.
pub const ANSWERS: &str = "compute human answers";
/// From a question's sending to the beginning of its answer.
pub const QUESTION: &str = "wait human/imagine → human";
/// What the planner waits for answers in a plan.
pub const AWAITED: &str = "planner awaits answers";

impl Samples {
    fn add(&mut self, name: &str, what: impl FnOnce() -> String, ns: u64, clamped: bool) {
        if !self.figures.contains_key(name) {
            let what = what();
            let figure = Figure {
                what,
                ..Figure::default()
            };
            self.figures.insert(name.to_owned(), figure);
        }
        if let Some(figure) = self.figures.get_mut(name) {
            figure.ns.push(ns);
            figure.clamped += u64::from(clamped);
        }
    }

    /// Takes every figure of every step.
    pub fn new(reader: &StepReader) -> Self {
        let mut samples = Self::default();
        let names: Vec<(String, String)> = (0..EDGES.len())
            .map(|edge| (wait_of(edge), hop_of(edge)))
            .collect();
        for (episode, step, seen) in reader.table.iter() {
            if let (Some(this), Some(next)) =
                (seen.sensed(), reader.table.sensed(episode, step + 1))
            {
                samples.add(
                    TICK,
                    || "from a frame's sending to the next frame's".to_owned(),
                    next.sent.saturating_sub(this.sent),
                    false,
                );
            }
            samples.add_latencies(seen);
            for output in STEP_ENDS {
                let Some(work) = reader.work(output, episode, step) else {
                    continue;
                };
                let process = output.sender();
                samples.add(
                    &compute_of(process),
                    || format!("computed by {} for {}", PROCESSES[process], output.name()),
                    work.compute,
                    false,
                );
                let newest = work.newest().copied();
                for used in &work.inputs {
                    let (wait, hop) = &names[used.edge];
                    let ns = work.began.saturating_sub(used.sent);
                    let edge = &EDGES[used.edge];
                    let is_newest = newest == Some(*used);
                    if edge.is_limit() && !is_newest {
                        continue;
                    }
                    samples.add(
                        wait,
                        || {
                            format!(
                                "from {}'s sending until {} began to compute {}",
                                edge.from.name(),
                                PROCESSES[process],
                                output.name()
                            )
                        },
                        ns,
                        work.clamped && is_newest,
                    );
                    if is_newest {
                        samples.add(
                            hop,
                            || "the same, of those that came last of a step's inputs".to_owned(),
                            ns,
                            work.clamped,
                        );
                    }
                }
                if seen.planned && output == GraphTopic::Decision {
                    samples.add(
                        AWAITED,
                        || "waited by planner for answers, in a plan".to_owned(),
                        work.awaited,
                        false,
                    );
                }
            }
            samples.add_imagination(reader, episode, step);
        }
        samples
    }

    fn add_latencies(&mut self, seen: &crate::table::StepMarks) {
        let decision = seen.mark(GraphTopic::Decision);
        let display = seen.mark(GraphTopic::Display);
        if let Some(display) = display {
            self.add(
                TO_DISPLAY,
                || "from a frame's sensing to the display of its step".to_owned(),
                display.sent.saturating_sub(display.cause),
                false,
            );
        }
        if let Some(decision) = decision {
            self.add(
                TO_DECISION,
                || "from a frame's sensing to the decision about it".to_owned(),
                decision.sent.saturating_sub(decision.cause),
                false,
            );
        }
        if let (Some(decision), Some(display)) = (decision, display)
            && display.sent > decision.sent
        {
            self.add(
                TO_SHOWN,
                || "from a frame's sensing to the display of the decision about it".to_owned(),
                display.sent.saturating_sub(decision.cause),
                false,
            );
        }
    }

    fn add_imagination(&mut self, reader: &StepReader, episode: u32, step: u32) {
        let Some(plan) = reader.imagination(episode, step) else {
            return;
        };
        let answers = reader.answers(episode, step);
        if !answers.is_empty() {
            self.add(
                ANSWERS,
                || "computed by human for all answers of a plan".to_owned(),
                answers.iter().map(|(from, to)| to - from).sum(),
                false,
            );
        }
        // Where one was lost, which answer belongs to which question cannot be told.
        if plan.questions.len() == plan.answers.len() {
            let mut open: Vec<&(u32, crate::table::SendMark)> = plan.questions.iter().collect();
            for ((group, answer), (from, _)) in plan.answers.iter().zip(&answers) {
                let asked = open
                    .iter()
                    .position(|(asked, mark)| asked == group && mark.sent < answer.sent);
                if let Some(place) = asked {
                    let (_, question) = open.remove(place);
                    self.add(
                        QUESTION,
                        || "from a question's sending until human began to answer it".to_owned(),
                        from.saturating_sub(question.sent),
                        *from < question.sent,
                    );
                }
            }
        }
    }

    /// The samples of a figure, in the order of time.
    pub fn of(&self, name: &str) -> &[u64] {
        self.figures.get(name).map_or(&[], |figure| &figure.ns)
    }

    /// Names and samples of all figures.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &[u64])> {
        self.figures
            .iter()
            .map(|(name, figure)| (name.as_str(), figure.ns.as_slice()))
    }

    /// Percentiles of all figures.
    pub fn metrics(&self) -> BTreeMap<String, Metric> {
        let metric = |figure: &Figure| Metric::new(&figure.what, &figure.ns, figure.clamped);
        self.figures
            .iter()
            .map(|(name, figure)| (name.clone(), metric(figure)))
            .collect()
    }
}

/// A step's latency, whose slowest and typical case are shown: in lockstep the tick; in real time, where ticks come
/// from the clock, from sensing to decision.
pub fn latency(reader: &StepReader, episode: u32, step: u32) -> Option<(u64, u64)> {
    let table: &StepTable = reader.table;
    match reader.clock {
        ClockMode::Lockstep => {
            let from = table.sensed(episode, step)?.sent;
            let to = table.sensed(episode, step + 1)?.sent;
            (to > from).then_some((from, to))
        }
        ClockMode::RealTime => {
            let decision = table.mark(GraphTopic::Decision, episode, step + 1)?;
            (decision.sent > decision.cause).then_some((decision.cause, decision.sent))
        }
    }
}

/// The message at the end of [`latency`].
pub fn latency_end(reader: &StepReader, episode: u32, step: u32) -> Option<GraphTopic> {
    match reader.clock {
        ClockMode::Lockstep => reader.table.step(episode, step)?.sensed_on(),
        ClockMode::RealTime => Some(GraphTopic::Decision),
    }
}

/// A part of the critical path, over all steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PathPart {
    /// The process.
    pub process: String,
    /// What it does or waits for.
    pub what: String,
    /// Steps on whose path this lies.
    pub steps: u64,
    /// Mean over all steps, in ns.
    pub mean_ns: f64,
    /// Share of all steps' latency.
    pub share: f64,
}

/// What a stretch is called.
pub fn label(kind: StretchKind) -> String {
    match kind {
        StretchKind::Compute(topic) => format!("computes {}", topic.name()),
        StretchKind::Wait(topic) => format!("begins late: {} waits", topic.name()),
        StretchKind::AwaitAnswers => "awaits answers".to_owned(),
        StretchKind::Answer => "answers".to_owned(),
        StretchKind::Unknown => "unknown: a message was not seen".to_owned(),
    }
}

/// Where the latency of all steps goes, along each step's critical path; the parts add up to the whole.
pub fn path_parts(reader: &StepReader) -> Vec<PathPart> {
    let mut sums: BTreeMap<(usize, StretchKind), (u64, u64)> = BTreeMap::new();
    let (mut steps, mut total) = (0u64, 0u64);
    for (episode, step, _) in reader.table.iter() {
        let Some((from, to)) = latency(reader, episode, step) else {
            continue;
        };
        steps += 1;
        total += to - from;
        let Some(end) = latency_end(reader, episode, step + 1) else {
            continue;
        };
        let path = reader.path(end, episode, step + 1, from);
        let mut seen = Vec::new();
        for stretch in path {
            let key = (stretch.process, stretch.kind);
            let (count, sum) = sums.entry(key).or_default();
            *sum += stretch.to - stretch.from;
            if !seen.contains(&key) {
                seen.push(key);
                *count += 1;
            }
        }
    }
    let mut parts: Vec<_> = sums
        .into_iter()
        .map(|((process, kind), (count, sum))| PathPart {
            process: PROCESSES[process].to_owned(),
            what: label(kind),
            steps: count,
            mean_ns: sum as f64 / steps.max(1) as f64,
            share: sum as f64 / total.max(1) as f64,
        })
        .collect();
    parts.sort_by(|a, b| b.mean_ns.total_cmp(&a.mean_ns));
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_leave_nothing_out() {
        let mut samples: Vec<u64> = (1..=999).collect();
        samples.push(1_000_000);
        let metric = Metric::new("", &samples, 0);
        assert_eq!((metric.p50, metric.p90, metric.p99), (500, 900, 990));
        assert_eq!(
            (metric.p999, metric.max, metric.count),
            (999, 1_000_000, 1000)
        );
        assert_eq!(metric.block_p50.len(), BLOCKS);
        assert_eq!(metric.block_p50[0], 25);
        assert!(metric.block_p99.is_empty(), "50 samples have no p99");
        assert_eq!(Metric::new("", &[], 0).max, 0);
    }
}
