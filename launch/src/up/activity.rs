//! What the operating system says of a process that does not answer: does it compute, or stand still?

use std::fs;

/// What the threads of a process, and of those that it started, have done and are doing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GroupActivity {
    /// Whether it was stopped, as by SIGSTOP or a debugger.
    pub is_stopped: bool,
    /// Whether a thread runs, waits for a processor, or for the disk.
    pub is_running: bool,
    /// Processor time so far, in the system's clock ticks.
    pub ticks: u64,
}

impl GroupActivity {
    /// Of all processes in the group that `leader` leads; nothing of one that has ended.
    pub fn of_group(leader: u32) -> Self {
        let mut all = Self::default();
        for process in numbers_in("/proc") {
            let Some(stat) = Stat::read(&format!("/proc/{process}/stat")) else {
                continue;
            };
            if stat.group != leader {
                continue;
            }
            if process == leader {
                all.is_stopped = matches!(stat.state, 'T' | 't');
            }
            all.ticks += stat.ticks;
            all.is_running |= numbers_in(&format!("/proc/{process}/task"))
                .filter_map(|thread| Stat::read(&format!("/proc/{process}/task/{thread}/stat")))
                .any(|thread| matches!(thread.state, 'R' | 'D'));
        }
        all
    }

    /// Of one process, without those that it started; none if there is none of that number.
    pub fn of_process(process: u32) -> Option<Self> {
        let stat = Stat::read(&format!("/proc/{process}/stat"))?;
        Some(Self {
            is_stopped: matches!(stat.state, 'T' | 't'),
            is_running: matches!(stat.state, 'R' | 'D'),
            ticks: stat.ticks,
        })
    }

    /// Whether it computes, by what was seen of it `before`: a process that is stopped, or sleeps without having used the
    /// processor, does not.
    pub fn computes_since(&self, before: &Self) -> bool {
        !self.is_stopped && (self.is_running || self.ticks != before.ticks)
    }
}

/// What is used of a `stat` file of `/proc`.
struct Stat {
    state: char,
    group: u32,
    ticks: u64,
}

impl Stat {
    fn read(path: &str) -> Option<Self> {
        let text = fs::read_to_string(path).ok()?;
        // The name, in parentheses, may hold anything.
        let mut fields = text.rsplit_once(')')?.1.split_whitespace();
        let state = fields.next()?.chars().next()?;
        let group = fields.nth(1)?.parse().ok()?;
        let user: u64 = fields.nth(8)?.parse().ok()?;
        let system: u64 = fields.next()?.parse().ok()?;
        Some(Self {
            state,
            group,
            ticks: user + system,
        })
    }
}

fn numbers_in(directory: &str) -> impl Iterator<Item = u32> {
    let entries = fs::read_dir(directory).into_iter().flatten().flatten();
    entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::process::CommandExt;
    use std::process::{Child, Command};

    /// A shell in a process group of its own, ended with the test.
    struct Shell(Child);

    impl Shell {
        fn start(script: &str) -> Self {
            let mut command = Command::new("/bin/sh");
            Self(
                command
                    .args(["-c", script])
                    .process_group(0)
                    .spawn()
                    .unwrap(),
            )
        }

        fn signal(&self, signal: libc::c_int) {
            // SAFETY: signals the group of a child that was not reaped yet.
            assert_eq!(
                unsafe { libc::kill(-(self.0.id() as libc::pid_t), signal) },
                0
            );
        }

        fn wait_until(&self, done: impl Fn(GroupActivity) -> bool) -> GroupActivity {
            loop {
                let activity = GroupActivity::of_group(self.0.id());
                if done(activity) {
                    return activity;
                }
                std::thread::yield_now();
            }
        }
    }

    impl Drop for Shell {
        fn drop(&mut self) {
            self.signal(libc::SIGKILL);
            let _ = self.0.wait();
        }
    }

    #[test]
    fn who_computes_is_told_from_who_sleeps_or_was_stopped() {
        let busy = Shell::start("while :; do :; done");
        let before = busy.wait_until(|activity| activity.is_running);
        let later = busy.wait_until(|activity| activity.ticks > before.ticks);
        assert!(later.computes_since(&before));
        busy.signal(libc::SIGSTOP);
        let stopped = busy.wait_until(|activity| activity.is_stopped && !activity.is_running);
        assert!(!stopped.computes_since(&before), "whatever it did before");
        let stopped = GroupActivity::of_process(busy.0.id()).unwrap();
        assert!(stopped.is_stopped && !stopped.is_running);

        let idle = Shell::start("exec sleep 1000");
        let asleep = idle.wait_until(|activity| !activity.is_running);
        assert!(!asleep.computes_since(&asleep));
    }

    #[test]
    fn what_it_started_computes_for_it() {
        let parent = Shell::start("(while :; do :; done) & wait");
        let before = parent.wait_until(|activity| activity.is_running);
        let later = parent.wait_until(|activity| activity.ticks > before.ticks);
        assert!(later.computes_since(&before));
    }
}
