//! What watching costs those who are watched: the same run with and without a watcher, by turns.
//!
//! After the observation, subscribers are made and dropped by turns for some hundred milliseconds each. How many steps the
//! world did while nobody watched is known from its sequence numbers before and after. Each turn without a watcher is
//! compared with the mean of its two neighbours with one, so that a slow drift of the machine's load cancels. The
//! median of these ratios is stated with a distribution-free interval (order statistics).

use super::table::Table;
use super::watch::{Ports, Watch, own};
use anyhow::Result;
use runtime::{ObserverWake, now_ns};
use serde::{Deserialize, Serialize};

/// A turn lasts at least so long …
const TURN_NS: u64 = 200_000_000;
/// … and at least so many ticks.
const TURN_TICKS: u64 = 20;
/// Turns without a watcher, at least: fewer have no interval worth stating.
const FEWEST: usize = 6;
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
    /// Median of (tick watched / tick alone − 1).
    pub slower: f64,
    /// Its interval.
    pub slower_interval: [f64; 2],
    /// How sure the interval is.
    pub confidence: f64,
    /// Processor time that the watcher used while it watched, as a share of one core.
    pub cpu_share: f64,
}

/// Measures for at least `seconds`; none if the run ends before there is enough to tell, or for a signal.
///
/// # Errors
/// When a port fails.
pub fn measure(watch: &mut Watch, seconds: f64, tick_ns: u64) -> Result<Option<Cost>> {
    let turn_ns = TURN_NS.max(TURN_TICKS * tick_ns);
    let turns = FEWEST.max((seconds * 1e9 / (2 * turn_ns) as f64).round() as usize);
    let (mut watched, mut alone) = (Vec::new(), Vec::new());
    let mut before: Option<(u64, u64)> = None;
    let mut cpu = (0, 0);
    for turn in 0..=turns {
        let began = own();
        let mut ports = Ports::attach(&watch.observer)?;
        let end = now_ns() + turn_ns;
        let mut table = Table::default();
        while now_ns() < end {
            if watch.observer.sleep(now_ns() + ports.pause_ns())? != ObserverWake::Deadline {
                return Ok(None);
            }
            ports.drain(&mut table)?;
        }
        let ended = own();
        cpu.0 += ended.cpu_ns - began.cpu_ns;
        cpu.1 += ended.at_ns - began.at_ns;
        let Some([first, last]) = ports.outcomes else {
            return Ok(None);
        };
        drop(ports);
        alone.extend(before.and_then(|before| mean_tick(before, first)));
        watched.extend(mean_tick(first, last));
        before = Some(last);
        if turn < turns && watch.observer.sleep(now_ns() + turn_ns)? != ObserverWake::Deadline {
            return Ok(None);
        }
    }
    Ok(cost(&watched, &alone, turn_ns, cpu))
}

/// Mean tick, in ns, between two outcomes: sequence number and time each.
fn mean_tick(from: (u64, u64), to: (u64, u64)) -> Option<f64> {
    let steps = to.0.checked_sub(from.0).filter(|steps| *steps > 0)?;
    Some(to.1.saturating_sub(from.1) as f64 / steps as f64)
}

fn cost(watched: &[f64], alone: &[f64], turn_ns: u64, cpu: (u64, u64)) -> Option<Cost> {
    if alone.len() < FEWEST || watched.len() != alone.len() + 1 {
        return None;
    }
    let mut slower: Vec<f64> = alone
        .iter()
        .zip(watched.windows(2))
        .map(|(alone, around)| (around[0] + around[1]) / 2.0 / alone - 1.0)
        .collect();
    slower.sort_by(f64::total_cmp);
    let (from, confidence) = median_interval(slower.len(), CONFIDENCE);
    Some(Cost {
        turns: alone.len(),
        turn_ms: turn_ns as f64 * 1e-6,
        tick_watched_us: median(watched) * 1e-3,
        tick_alone_us: median(alone) * 1e-3,
        slower: median(&slower),
        slower_interval: [slower[from], slower[slower.len() - 1 - from]],
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
/// least `confidence`: how many are cut off on each side, and the confidence it really has. With too few values, nothing is
/// cut off.
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
        // 10 % slower while watched, on a machine that gets 1 % slower with every turn.
        let drift = |turn: usize| 100.0 + turn as f64;
        let watched: Vec<f64> = (0..=8).map(|turn| 1.1 * drift(2 * turn)).collect();
        let alone: Vec<f64> = (0..8).map(|turn| drift(2 * turn + 1)).collect();
        let cost = cost(&watched, &alone, 1, (1, 100)).unwrap();
        assert!((cost.slower - 0.1).abs() < 1e-9, "{cost:?}");
        assert!(super::cost(&watched[..4], &alone[..3], 1, (1, 1)).is_none());
    }
}
