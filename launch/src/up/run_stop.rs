//! The end of a run: everybody is asked to end, then told, then made to.

use super::ended::Cause;
use super::phase::Phase;
use super::run::{LOOK_NS, MS, RECORDER, Run};
use anyhow::Result;
use messages::ProcessState;
use runtime::now_ns;

/// After the word to stop, a process has this long …
const STOP_NS: u64 = 3_000 * MS;
/// … and a recorder, which may still be writing, this long.
const STOP_RECORDER_NS: u64 = 20_000 * MS;
/// After SIGTERM.
const TERM_NS: u64 = 2_000 * MS;

impl Run<'_> {
    /// Asks everybody to end, then tells them, then makes them.
    pub(super) fn stop(&mut self) -> Result<()> {
        self.screen.status("stopping".to_owned());
        self.launcher.stop()?;
        let begun = now_ns();
        let mut told = [false; 2];
        while !self.children.living().is_empty() {
            let ended = self.children.wait(LOOK_NS)?;
            self.suspension.heed(|signal| self.children.suspend(signal));
            self.take_reports()?;
            self.tally.update()?;
            if let Some(at) = ended {
                let ended = self.children.reap(at)?;
                let finished = self.ending.reports[ended.place]
                    .is_some_and(|report| report.state() == Ok(ProcessState::Finished));
                let died = match ended.phase {
                    Phase::Active => !finished,
                    Phase::Starting => !ended.well,
                    Phase::Standby | Phase::Leaving => false,
                };
                if died || matches!(ended.cause, Cause::Crash | Cause::Signal) {
                    self.supervisor.note(&ended, &self.heads);
                }
                continue;
            }
            let patience = if self.children.active(RECORDER).is_some() {
                STOP_RECORDER_NS
            } else {
                STOP_NS
            };
            let waited = now_ns() - begun;
            let signals = [
                (patience, libc::SIGTERM),
                (patience + TERM_NS, libc::SIGKILL),
            ];
            for (told, (after, signal)) in told.iter_mut().zip(signals) {
                if waited > after && !*told {
                    self.children.signal(signal);
                    *told = true;
                }
            }
        }
        Ok(())
    }
}
