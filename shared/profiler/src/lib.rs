//! Watches a process set and says how long its processes compute, how long messages wait, and what it costs.
//!
//! The profiler is one more subscriber of every topic ([`Watch`]). All times come from the messages' headers (`work.rs`
//! says what is known exactly and what is inferred), all use of cores and memory from the kernel (`system.rs`).

mod about;
mod activity;
pub mod compare;
mod cost;
mod graph;
mod hlog;
mod metrics;
mod picture;
mod result;
mod started;
mod system;
mod table;
pub mod text;
mod trace;
pub mod units;
mod watch;
mod work;

pub use about::{AskStatus, SetDescription};
pub use cost::Cost;
pub use hlog::log as hlog;
pub use metrics::{Metric, Samples};
pub use picture::svg as picture;
pub use result::{Profile, Trace};
pub use started::StartedSet;
pub use watch::{Observed, Until, Watch, WatchEnd, nothing_seen};

use anyhow::Result;

/// Measures for `seconds` how much watching slows a tick, after a set was watched; none where that cannot be told.
///
/// # Errors
/// When a port fails.
pub fn cost_of_watching(
    watch: &mut Watch,
    observed: &Observed,
    seconds: f64,
) -> Result<Option<Cost>> {
    let mut steps = observed.table.iter();
    let plans = steps.any(|(.., step)| step.imagination.is_some());
    let tick = Metric::new("", Samples::new(&observed.reader()).of(metrics::TICK), 0);
    let pids: Vec<u32> = observed
        .processes
        .iter()
        .map(|process| process.pid)
        .filter(|pid| *pid != 0)
        .collect();
    cost::measure(watch, &pids, seconds, tick.p50, plans)
}

/// The steps around these (episode, step) as a trace that Perfetto opens; `about` says what was watched.
pub fn trace(
    observed: &Observed,
    around: &[(u32, u32)],
    about: serde_json::Value,
) -> serde_json::Value {
    let pids: Vec<u32> = observed
        .processes
        .iter()
        .map(|process| process.pid)
        .collect();
    trace::trace(&observed.reader(), around, &pids, about)
}
