//! What watching costs those who are watched: the same run with and without a watcher, by turns.
//!
//! After the observation, subscribers are made and dropped by turns for some hundred milliseconds each. How many steps
//! the world did while nobody watched is known from its sequence numbers before and after. Each turn without a watcher
//! is compared with the mean of its two neighbours with one, so that a slow drift of the machine's load cancels. The
//! median of these ratios is stated with a distribution-free interval (order statistics).
//!
//! The same is done with the processor time that the set uses for a tick: it holds what senders do more for one more
//! subscriber, and, unlike the tick, hardly changes where other work keeps the machine busy.

use crate::system::cpu_ns;
use crate::table::StepTable;
use crate::watch::{FrameMarker, Watch, WatchPorts, own};
use anyhow::Result;
use messages::Header;
use runtime::{ObserverWake, now_ns};
use serde::{Deserialize, Serialize};

/// A turn lasts at least so long …
const TURN_NS: u64 = 200_000_000;
/// … and at least so many ticks.
const TURN_TICKS: u64 = 20;
/// Turns without a watcher, at least: fewer have no interval worth stating.
const FEWEST: usize = 6;
/// After subscribers came or went.
const SETTLE_NS: u64 = 30_000_000;
/// Between two looks for a frame.
const MARKER_NS: u64 = 500_000;
/// How sure the interval shall be.
const CONFIDENCE: f64 = 0.95;

/// What watching costs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    /// Turns without a watcher.
    pub turns: usize,
    /// Length of a turn.
    pub turn_ms: f64,
    /// Median over turns of the mean tick while watched.
    pub tick_watched_us: f64,
    /// The same while nobody watched.
    pub tick_alone_us: f64,
    /// How much longer a tick is: tick watched / tick alone − 1.
    pub slower: Ratio,
    /// Median over turns of the processor time that the set uses for a tick, watched …
    pub cpu_watched_us: f64,
    /// … and alone.
    pub cpu_alone_us: f64,
    /// How much more that is.
    pub more_cpu: Ratio,
    /// How sure the intervals are.
    pub confidence: f64,
    /// Processor time that the watcher used while it watched, as a share of one core.
    pub cpu_share: f64,
}

/// A median over turns, less one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ratio {
    /// The median.
    pub median: f64,
    /// Its interval.
    pub interval: [f64; 2],
}

/// What was measured in one turn.
#[derive(Clone, Copy, Debug)]
struct WatchTurn {
    /// Mean tick, in ns.
    tick: f64,
    /// Processor time of the set for a tick, in ns.
    cpu: f64,
}

/// Processor time of the set so far, and the time, in ns.
fn set_cpu(pids: &[u32]) -> (u64, u64) {
    let cpu = pids.iter().filter_map(|pid| cpu_ns(*pid)).sum();
    (cpu, now_ns())
}

/// Measures for at least `seconds`; none if the run ends before there is enough to tell, or for a signal. `plans`:
/// whether the planner imagines.
///
/// # Errors
/// When a port fails.
pub fn measure(
    watch: &mut Watch,
    pids: &[u32],
    seconds: f64,
    tick_ns: u64,
    plans: bool,
) -> Result<Option<Cost>> {
    let turn_ns = TURN_NS.max(TURN_TICKS * tick_ns);
    let turns = FEWEST.max((seconds * 1e9 / (2 * turn_ns) as f64).round() as usize);
    let (mut watched, mut alone) = (Vec::new(), Vec::new());
    let mut own_cpu = (0, 0);
    // Making and dropping subscribers takes milliseconds, which belong to neither turn: a marker, a subscriber of
    // frames, is there while the others come and go.
    let mut left: Option<TickMoment> = None;
    for turn in 0..=turns {
        let mut marker = FrameMarker::attach(&watch.observer)?;
        let Some(first) = moment(watch, pids, || Ok(marker.newest()?))? else {
            return Ok(None);
        };
        alone.extend(left.and_then(|left| first.since(&left)));
        let mut ports = WatchPorts::attach(&watch.observer, plans)?;
        drop(marker);
        let settled = match look_on(watch, &mut ports, SETTLE_NS)? {
            true => moment(watch, pids, || Ok(ports.newest_frame()?))?,
            false => None,
        };
        let Some(settled) = settled else {
            return Ok(None);
        };
        let began = own();
        if !look_on(watch, &mut ports, turn_ns)? {
            return Ok(None);
        }
        let ended = own();
        own_cpu.0 += ended.cpu_ns - began.cpu_ns;
        own_cpu.1 += ended.at_ns - began.at_ns;
        let Some(last) = moment(watch, pids, || Ok(ports.newest_frame()?))? else {
            return Ok(None);
        };
        watched.extend(last.since(&settled));
        let mut marker = FrameMarker::attach(&watch.observer)?;
        drop(ports);
        if watch.observer.sleep(now_ns() + SETTLE_NS)? != ObserverWake::Deadline {
            return Ok(None);
        }
        left = moment(watch, pids, || Ok(marker.newest()?))?;
        drop(marker);
        if turn < turns && watch.observer.sleep(now_ns() + turn_ns)? != ObserverWake::Deadline {
            return Ok(None);
        }
    }
    Ok(cost(&watched, &alone, turn_ns, own_cpu))
}

/// A moment of the run.
#[derive(Clone, Copy, Debug)]
struct TickMoment {
    /// Sequence number of the newest frame, and when it was sent.
    frame: (u64, u64),
    /// Processor time of the set so far, and when it was read.
    cpu: (u64, u64),
}

impl TickMoment {
    fn since(&self, before: &Self) -> Option<WatchTurn> {
        let steps = self.frame.0.checked_sub(before.frame.0)?;
        let tick = self.frame.1.saturating_sub(before.frame.1) as f64 / steps.max(1) as f64;
        let cpu = busy(before.cpu, self.cpu) * tick;
        (steps > 0).then_some(WatchTurn { tick, cpu })
    }
}

/// Waits for a frame that is sent from now on; none if the run ends, or for a signal. `newest`: the newest frame's
/// header.
fn moment(
    watch: &mut Watch,
    pids: &[u32],
    mut newest: impl FnMut() -> Result<Option<Header>>,
) -> Result<Option<TickMoment>> {
    let since = now_ns();
    loop {
        if let Some(header) = newest()?.filter(|header| header.sent_ns >= since) {
            return Ok(Some(TickMoment {
                frame: (header.sequence, header.sent_ns),
                cpu: set_cpu(pids),
            }));
        }
        if watch.observer.sleep(now_ns() + MARKER_NS)? != ObserverWake::Deadline {
            return Ok(None);
        }
    }
}

/// Watches for so long; false if the run ends, or for a signal.
fn look_on(watch: &mut Watch, ports: &mut WatchPorts, ns: u64) -> Result<bool> {
    let mut table = StepTable::default();
    let end = now_ns() + ns;
    while now_ns() < end {
        if watch.observer.sleep(now_ns() + ports.pause_ns())? != ObserverWake::Deadline {
            return Ok(false);
        }
        ports.drain(&mut table)?;
    }
    Ok(true)
}

/// Cores' worth of processor time between two moments.
fn busy(from: (u64, u64), to: (u64, u64)) -> f64 {
    to.0.saturating_sub(from.0) as f64 / to.1.saturating_sub(from.1).max(1) as f64
}

fn cost(watched: &[WatchTurn], alone: &[WatchTurn], turn_ns: u64, cpu: (u64, u64)) -> Option<Cost> {
    if alone.len() < FEWEST || watched.len() != alone.len() + 1 {
        return None;
    }
    let (cut, confidence) = median_interval(alone.len(), CONFIDENCE);
    let ratio = |of: fn(&WatchTurn) -> f64| {
        let mut ratios: Vec<f64> = alone
            .iter()
            .zip(watched.windows(2))
            .map(|(alone, around)| (of(&around[0]) + of(&around[1])) / 2.0 / of(alone) - 1.0)
            .collect();
        ratios.sort_by(f64::total_cmp);
        Ratio {
            median: median(&ratios),
            interval: [ratios[cut], ratios[ratios.len() - 1 - cut]],
        }
    };
    let middle_us = |turns: &[WatchTurn], of: fn(&WatchTurn) -> f64| {
        median(&turns.iter().map(of).collect::<Vec<_>>()) * 1e-3
    };
    Some(Cost {
        turns: alone.len(),
        turn_ms: turn_ns as f64 * 1e-6,
        tick_watched_us: middle_us(watched, |turn| turn.tick),
        tick_alone_us: middle_us(alone, |turn| turn.tick),
        slower: ratio(|turn| turn.tick),
        cpu_watched_us: middle_us(watched, |turn| turn.cpu),
        cpu_alone_us: middle_us(alone, |turn| turn.cpu),
        more_cpu: ratio(|turn| turn.cpu),
        confidence,
        cpu_share: cpu.0 as f64 / cpu.1.max(1) as f64,
    })
}

/// The median.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match sorted.len() {
        0 => f64::NAN,
        len if len % 2 == 1 => sorted[len / 2],
        len => (sorted[len / 2 - 1] + sorted[len / 2]) / 2.0,
    }
}

/// The narrowest interval between order statistics, equally many cut off on both sides, that covers the median with at
/// least `confidence`: how many are cut off on each side, and the confidence it really has. With too few values,
/// nothing is cut off.
fn median_interval(count: usize, confidence: f64) -> (usize, f64) {
    // P(Bin(count, ½) ≤ cut − 1) on both sides is what the interval misses.
    let mut term = 0.5_f64.powi(count as i32);
    let mut missed = 0.0;
    let mut best = (0, 1.0 - 2.0 * term);
    for cut in 0..count / 2 {
        missed += term;
        if 1.0 - 2.0 * missed < confidence {
            break;
        }
        best = (cut, 1.0 - 2.0 * missed);
        term *= (count - cut) as f64 / (cut + 1) as f64;
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_covers_the_median() {
        // Textbook: of 12 values, the third and the tenth cover the median with 96.1 %.
        let (cut, confidence) = median_interval(12, 0.95);
        assert_eq!(cut, 2);
        assert!((confidence - 0.9614).abs() < 1e-4, "{confidence}");
        assert_eq!(median_interval(4, 0.95).0, 0);
    }

    #[test]
    fn a_drift_cancels() {
        // 10 % slower and 5 % more processor time while watched, on a machine that gets 1 % slower with every turn.
        let turn = |turn: usize, tick: f64, cpu: f64| WatchTurn {
            tick: tick * (100.0 + turn as f64),
            cpu: cpu * (100.0 + turn as f64),
        };
        let watched: Vec<WatchTurn> = (0..=8).map(|place| turn(2 * place, 1.1, 1.05)).collect();
        let alone: Vec<WatchTurn> = (0..8).map(|place| turn(2 * place + 1, 1.0, 1.0)).collect();
        let cost = cost(&watched, &alone, 1, (1, 100)).unwrap();
        assert!((cost.slower.median - 0.1).abs() < 1e-9, "{cost:?}");
        assert!((cost.more_cpu.median - 0.05).abs() < 1e-9, "{cost:?}");
        assert!(super::cost(&watched[..4], &alone[..3], 1, (1, 1)).is_none());
    }
}
