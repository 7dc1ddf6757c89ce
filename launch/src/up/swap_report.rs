//! What a swap did, for who asked for it and for the summary.

use runtime::Position;
use serde::Serialize;

/// What a swap did.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SwapReport {
    /// The process.
    pub process: String,
    /// Its kind before.
    pub from: String,
    /// And after.
    pub to: String,
    /// Episode and step from which on the new process is active.
    #[serde(rename = "border")]
    pub handover: Option<Position>,
    /// Steps that no process was active at, from the agreement on the handover step to some steps after it.
    pub ticks_without_answer: u64,
    /// Answers of that time that came later than a step after the world had sensed what they go back to.
    pub late_answers: u64,
    /// Messages that any port lost meanwhile.
    pub lost_messages: u64,
    /// Longest time between two of the process's messages, across the handover step, in ms.
    pub longest_gap_ms: f64,
    /// Agreements on a handover step that came too late.
    pub tries: u32,
    /// Learning, if the new human model had to, in ms.
    pub learn_ms: f64,
    /// From the start of the new process to its ports, in ms.
    pub start_ms: f64,
    /// From there until it had caught up, in ms.
    pub catch_up_ms: f64,
    /// From there until both had agreed to the handover step, in ms.
    pub agree_ms: f64,
    /// From there until the new process had spoken, in ms.
    pub cross_ms: f64,
    /// Whether the old process died before the handover step, so that the new took over at once.
    pub old_died: bool,
}
