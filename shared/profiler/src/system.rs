//! What the operating system says about processes and the machine: processor time, waiting for a core, memory, load.

use serde::{Deserialize, Serialize};
use std::fs::read_to_string;

/// A process at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Usage {
    /// When, in ns of the monotonic clock.
    pub at_ns: u64,
    /// Processor time since the process began, of all its threads, those that ended included.
    pub cpu_ns: u64,
    /// What its threads waited for a core while they could have run; 0 where the kernel does not say.
    pub queued_ns: u64,
    /// Switches away from its first thread, because it waited and because its time was up.
    pub switches: [u64; 2],
    /// Threads.
    pub threads: u64,
}

/// Processor time of a process since it began, from its own clock.
pub fn cpu_ns(pid: u32) -> Option<u64> {
    let mut clock: libc::clockid_t = 0;
    let mut time = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: live variables of the right types.
    let read = unsafe {
        libc::clock_getcpuclockid(pid as libc::pid_t, &mut clock) == 0
            && libc::clock_gettime(clock, &mut time) == 0
    };
    read.then_some(time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64)
}

/// A process now; none if there is no such process.
pub fn usage(pid: u32) -> Option<Usage> {
    let cpu_ns = cpu_ns(pid)?;
    let at_ns = runtime::now_ns();
    let (mut queued_ns, mut threads) = (0, 0);
    for task in std::fs::read_dir(format!("/proc/{pid}/task"))
        .ok()?
        .flatten()
    {
        threads += 1;
        let times = read_to_string(task.path().join("schedstat")).unwrap_or_default();
        let waited = times.split_ascii_whitespace().nth(1);
        queued_ns += waited
            .and_then(|waited| waited.parse().ok())
            .unwrap_or(0_u64);
    }
    let status = read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let switches = ["voluntary_ctxt_switches:", "nonvoluntary_ctxt_switches:"]
        .map(|key| field(&status, key).unwrap_or(0));
    Some(Usage {
        at_ns,
        cpu_ns,
        queued_ns,
        switches,
        threads,
    })
}

/// The number after a key at a line's start.
fn field(text: &str, key: &str) -> Option<u64> {
    let rest = text.lines().find_map(|line| line.strip_prefix(key))?;
    rest.split_ascii_whitespace().next()?.parse().ok()
}

/// Memory of a process, in KiB: resident, and its proportional share (what several processes share is divided among
/// them). The share is zero where the kernel does not say.
pub fn memory_kib(pid: u32) -> Option<(u64, u64)> {
    let status = read_to_string(format!("/proc/{pid}/status")).ok()?;
    let resident = field(&status, "VmRSS:")?;
    let rollup = read_to_string(format!("/proc/{pid}/smaps_rollup")).unwrap_or_default();
    Some((resident, field(&rollup, "Pss:").unwrap_or(0)))
}

/// The machine at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Machine {
    /// Load averages of the last 1, 5 and 15 minutes.
    pub load: [f64; 3],
    /// Busy time of all cores since the machine started, in ns; from the kernel's ticks.
    pub busy_ns: u64,
}

/// The machine now.
pub fn machine() -> Machine {
    let text = read_to_string("/proc/loadavg").unwrap_or_default();
    let mut numbers = text
        .split_ascii_whitespace()
        .map(|word| word.parse().unwrap_or(0.0));
    let load = std::array::from_fn(|_| numbers.next().unwrap_or(0.0));
    let stat = read_to_string("/proc/stat").unwrap_or_default();
    let ticks: Vec<u64> = stat
        .lines()
        .next()
        .unwrap_or_default()
        .split_ascii_whitespace()
        .skip(1)
        .map(|word| word.parse().unwrap_or(0))
        .collect();
    // user nice system (idle iowait) irq softirq steal
    let busy: u64 = [0, 1, 2, 5, 6, 7]
        .iter()
        .filter_map(|place| ticks.get(*place))
        .sum();
    // SAFETY: no arguments to get wrong.
    let per_second = unsafe { libc::sysconf(libc::_SC_CLK_TCK) }.max(1) as u64;
    Machine {
        load,
        busy_ns: busy * (1_000_000_000 / per_second),
    }
}

/// Cores that this process may use.
pub fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_process_has_used_a_processor_and_memory() {
        let pid = std::process::id();
        let usage = usage(pid).unwrap();
        assert!(usage.cpu_ns > 0 && usage.threads > 0);
        let (resident, share) = memory_kib(pid).unwrap();
        assert!(resident > 0 && share <= resident);
        // Nobody has this number: they end before 2^22.
        assert!(super::usage(1 << 30).is_none());
    }
}
