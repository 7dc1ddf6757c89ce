//! What a process tells its launcher about itself.

use crate::error::PortError;
use crate::node::Node;
use crate::output::Stamp;
use crate::timing::StageTimer;
use crate::turn::Position;
use messages::ProcessState;

impl Node {
    /// The histogram of compute times.
    pub fn timer(&self) -> &StageTimer {
        &self.timer
    }

    /// Replaces the times that are reported, for a process that measures something else than its compute time.
    pub fn report_times(&mut self, timer: StageTimer) {
        self.steps = timer.count();
        self.timer = timer;
    }

    /// Messages lost at this process's inputs, by topic.
    pub fn lost(&self) -> Vec<(&'static str, u64)> {
        let counters = self.shared.counters.borrow();
        counters
            .iter()
            .map(|counter| (counter.topic, counter.lost.get()))
            .collect()
    }

    /// Messages that waited for the process to look up though it had been notified: 0 unless the transport lost a
    /// wake-up.
    pub fn lost_wakeups(&self) -> u64 {
        self.sleeper.lost_wakeups()
    }

    /// Puts a digest ([`Digest`](crate::Digest)) into the reports to come: for the recorder.
    pub fn set_digest(&mut self, digest: [u8; 32]) {
        self.digest = digest;
    }

    /// Sends the last report, of a run that ended well.
    ///
    /// # Errors
    /// [`PortError`].
    pub fn finish(&mut self) -> Result<(), PortError> {
        self.send_report(ProcessState::Finished, "")
    }

    /// Tells the launcher why the process cannot go on, in at most 256 bytes.
    ///
    /// # Errors
    /// [`PortError`].
    pub fn fail(&mut self, text: &str) -> Result<(), PortError> {
        self.send_report(ProcessState::Failed, text)
    }

    /// Sends a report with a line for people.
    ///
    /// # Errors
    /// [`PortError`].
    pub fn say(&mut self, text: &str) -> Result<(), PortError> {
        self.send_report(ProcessState::Running, text)
    }

    pub(crate) fn send_report(&self, state: ProcessState, text: &str) -> Result<(), PortError> {
        self.send_report_at(state, text, self.shared.turn.sent().unwrap_or_default())
    }

    /// A report about a position: the newest that was spoken of, or, in answer to one, a handover step.
    pub(crate) fn send_report_at(
        &self,
        state: ProcessState,
        text: &str,
        (episode, step): Position,
    ) -> Result<(), PortError> {
        let counters = self.shared.counters.borrow();
        let stamp = Stamp {
            episode,
            step,
            cause_ns: 0,
        };
        self.report.send_with(stamp, |report| {
            copy_text(&mut report.process, &self.arguments.process);
            copy_text(&mut report.text, text);
            report.compute_ns = self.timer.summary_ns();
            report.steps = self.steps;
            report.missed_deadlines = self.missed;
            report.lost_wakeups = self.sleeper.lost_wakeups();
            [report.allocations, report.transport_allocations] = self.allocations;
            report.digest = self.digest;
            report.pid = std::process::id();
            report.state = state.wire();
            report.index = self.arguments.index;
            for (port, counter) in report.ports.iter_mut().zip(counters.iter()) {
                copy_text(&mut port.topic, counter.topic);
                port.received = counter.received.get();
                port.lost = counter.lost.get();
            }
            report.port_count = counters.len().min(report.ports.len()) as u32;
        })
    }
}

/// Copies as much of `text` as fits, to a character's border, and fills up with zeros.
fn copy_text(bytes: &mut [u8], text: &str) {
    let mut end = text.len().min(bytes.len());
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    bytes.fill(0);
    bytes[..end].copy_from_slice(&text.as_bytes()[..end]);
}
