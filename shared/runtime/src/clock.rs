//! Time: the clock that all processes of a run share, and the real-time ticker.
//!
//! The clock is `CLOCK_MONOTONIC` without the time for which the whole set was suspended. Its launcher notes that time
//! on a page of memory that every process maps, while all of them are stopped: nobody sees the clock jump, no deadline
//! passes meanwhile, and no latency contains the pause.

use core::sync::atomic::{AtomicPtr, AtomicU64, Ordering};
use std::fs::OpenOptions;
use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// End of the name of the page's file in an instance's directory, after the prefix of all names that are the
/// instance's.
const PAGE: &str = "clock";

/// Nanoseconds for which the set was suspended; null as long as this process has joined none. Once mapped, a page
/// stays: another thread may be reading it.
static SUSPENDED_NS: AtomicPtr<AtomicU64> = AtomicPtr::new(core::ptr::null_mut());

/// The page with the time for which the set was suspended, if this process has joined one.
fn suspended() -> Option<&'static AtomicU64> {
    // SAFETY: null, or a page that stays mapped and is only accessed as this atomic number.
    unsafe { SUSPENDED_NS.load(Ordering::Acquire).as_ref() }
}

/// Follows the clock of the instance with this directory and this prefix, from now on; one without a launcher has no
/// directory, and nobody who would suspend it.
///
/// # Errors
/// When the page's file cannot be made, opened or mapped.
pub(crate) fn follow(directory: &Path, prefix: &str) -> io::Result<()> {
    let opened = OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .mode(0o600)
        .custom_flags(libc::O_NOFOLLOW)
        .open(directory.join(format!("{prefix}{PAGE}")));
    let file = match opened {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        opened => opened?,
    };
    file.set_len(size_of::<AtomicU64>() as u64)?;
    // SAFETY: maps the first bytes of an open file, as many as it has, at an address of the system's choice. A mapping
    // begins at a page's border, which is aligned for the number.
    let page = unsafe {
        libc::mmap(
            core::ptr::null_mut(),
            size_of::<AtomicU64>(),
            libc::PROT_READ | libc::PROT_WRITE,
            libc::MAP_SHARED,
            file.as_raw_fd(),
            0,
        )
    };
    if page == libc::MAP_FAILED {
        return Err(io::Error::last_os_error());
    }
    SUSPENDED_NS.store(page.cast(), Ordering::Release);
    Ok(())
}

/// Does something, usually being stopped, during which the run's clock stands still; for a launcher while its processes
/// are stopped.
pub fn stand_still(meanwhile: impl FnOnce()) {
    let before = monotonic_ns();
    meanwhile();
    if let Some(suspended) = suspended() {
        suspended.fetch_add(monotonic_ns() - before, Ordering::AcqRel);
    }
}

/// Nanoseconds of the run's clock, the same in all processes of a run.
pub fn now_ns() -> u64 {
    let stood_still = suspended().map_or(0, |ns| ns.load(Ordering::Acquire));
    monotonic_ns().saturating_sub(stood_still)
}

/// Nanoseconds of `CLOCK_MONOTONIC`.
fn monotonic_ns() -> u64 {
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
