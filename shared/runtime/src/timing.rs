//! How long a process computes per step: a histogram that never allocates after it was made, tail and all.

use hdrhistogram::Histogram;

/// Compute times with three significant digits up to a minute. What is longer counts as a minute, and keeps the
/// maximum.
pub struct StageTimer {
    histogram: Option<Histogram<u64>>,
    longest_ns: u64,
}

const CEILING_NS: u64 = 60_000_000_000;

impl StageTimer {
    /// An empty histogram; all its memory is made here.
    pub fn new() -> Self {
        Self {
            // The bounds are constants that the constructor accepts.
            histogram: Histogram::new_with_bounds(1, CEILING_NS, 3).ok(),
            longest_ns: 0,
        }
    }

    /// Adds a time.
    pub fn record(&mut self, ns: u64) {
        self.longest_ns = self.longest_ns.max(ns);
        if let Some(histogram) = &mut self.histogram {
            histogram.saturating_record(ns.max(1));
        }
    }

    /// Times recorded.
    pub fn count(&self) -> u64 {
        self.histogram.as_ref().map_or(0, Histogram::len)
    }

    /// p50, p90, p99, p99.9 and the maximum, in ns; zeros if nothing was recorded.
    pub fn summary_ns(&self) -> [u64; 5] {
        match &self.histogram {
            Some(histogram) if !histogram.is_empty() => {
                let at = |quantile| histogram.value_at_quantile(quantile).min(self.longest_ns);
                [at(0.5), at(0.9), at(0.99), at(0.999), self.longest_ns]
            }
            _ => [0; 5],
        }
    }

    /// Forgets all times, keeping the memory.
    pub fn clear(&mut self) {
        self.longest_ns = 0;
        if let Some(histogram) = &mut self.histogram {
            histogram.reset();
        }
    }
}

impl Default for StageTimer {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tail_is_kept() {
        let mut timer = StageTimer::new();
        assert_eq!(timer.summary_ns(), [0; 5]);
        for ns in 1..=1000 {
            timer.record(ns * 1000);
        }
        timer.record(120_000_000_000);
        let [p50, p90, p99, p999, max] = timer.summary_ns();
        let near = |value: u64, expected: f64| (value as f64 / expected - 1.0).abs() < 2e-3;
        assert!(
            near(p50, 501_000.0) && near(p90, 901_000.0) && near(p99, 991_000.0),
            "{p50} {p90} {p99}"
        );
        assert!(near(p999, 1_000_000.0), "{p999}");
        assert_eq!(max, 120_000_000_000);
        assert_eq!(timer.count(), 1001);
    }
}
