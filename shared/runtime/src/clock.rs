//! Time: the monotonic clock that all processes share, and the real-time ticker.

/// Nanoseconds of `CLOCK_MONOTONIC`, the same in all processes of a machine.
pub fn now_ns() -> u64 {
    let mut time = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: `time` is a valid timespec; this clock exists on every Linux.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &mut time) };
    time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
}

/// A real-time process's beat: deadlines at absolute times, so that a late step shifts none of the following.
#[derive(Clone, Debug)]
pub struct Ticker {
    period_ns: u64,
    deadline_ns: u64,
    missed: u64,
}

impl Ticker {
    /// Beats every `period_ns` nanoseconds, first one period after `start_ns`.
    pub fn new(start_ns: u64, period_ns: u64) -> Self {
        Self {
            period_ns: period_ns.max(1),
            deadline_ns: start_ns + period_ns.max(1),
            missed: 0,
        }
    }

    /// The next beat, for [`Node::wait`](crate::Node::wait)'s deadline.
    pub fn deadline_ns(&self) -> u64 {
        self.deadline_ns
    }

    /// Whether the next beat has come.
    pub fn is_due(&self, now_ns: u64) -> bool {
        now_ns >= self.deadline_ns
    }

    /// Goes on to the next beat after `now_ns`, and returns how many whole beats went by unserved since the one that
    /// was due; they are counted in [`Ticker::missed`].
    pub fn advance(&mut self, now_ns: u64) -> u64 {
        let late = now_ns.saturating_sub(self.deadline_ns) / self.period_ns;
        self.deadline_ns += (late + 1) * self.period_ns;
        self.missed += late;
        late
    }

    /// Beats that went by unserved.
    pub fn missed(&self) -> u64 {
        self.missed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_step_costs_only_the_beats_it_covers() {
        let mut ticker = Ticker::new(1_000, 100);
        assert!(!ticker.is_due(1_099));
        assert!(ticker.is_due(1_100));
        assert_eq!(ticker.advance(1_101), 0);
        assert_eq!(ticker.deadline_ns(), 1_200);
        // Served at 1 450: the beats of 1 300 and 1 400 went by.
        assert_eq!(ticker.advance(1_450), 2);
        assert_eq!(ticker.deadline_ns(), 1_500);
        assert_eq!(ticker.missed(), 2);
    }

    #[test]
    fn the_clock_goes_forward() {
        let first = now_ns();
        assert!(first > 0);
        assert!(now_ns() >= first);
    }
}
