//! How a process heeds its launcher: start, stop, report, take over, hand over.

use crate::error::NodeError;
use crate::node::Node;
use crate::turn::Position;
use messages::{Control, ControlCommand, ProcessState};

impl Node {
    /// Heeds what the launcher says; false if it said nothing.
    pub(crate) fn serve_control(&mut self) -> Result<bool, NodeError> {
        let mut heard = false;
        while self.control.take()? {
            heard = true;
            let Some(control) = self.control.message() else {
                break;
            };
            let (command, process, run_id) =
                (control.command(), control.process, control.header.run_id);
            let (step, sent_ns) = (control.header.step, control.header.sent_ns);
            if run_id != self.shared.run_id
                || (process != Control::EVERYBODY && process != self.arguments.index)
            {
                continue;
            }
            let handover_step = (control.header.episode, step);
            match command {
                Ok(command @ (ControlCommand::Start | ControlCommand::TakeOver)) => {
                    // Who joins later does not miss what was sent before.
                    if !self.started && process == Control::EVERYBODY {
                        self.shared.start_ns.set(sent_ns);
                    }
                    self.started = true;
                    if command == ControlCommand::TakeOver {
                        self.take_over(handover_step)?;
                    }
                }
                Ok(ControlCommand::Stop) => self.stopped = true,
                Ok(ControlCommand::Report) => self.send_report(ProcessState::Running, "")?,
                Ok(ControlCommand::Connect) => self.shared.connect(),
                Ok(ControlCommand::HandOver) => {
                    let done = self.shared.turn.hand_over(handover_step);
                    self.shared.release();
                    self.answer_handover(done, handover_step)?;
                }
                // A later version's word, or another program's.
                Err(_) => {}
            }
        }
        Ok(heard)
    }

    fn take_over(&mut self, handover_step: Position) -> Result<(), NodeError> {
        let done = self.shared.turn.take_over(handover_step);
        if done {
            self.forget_losses();
            self.shared.connect();
            self.shared.release();
        }
        self.answer_handover(done, handover_step)
    }

    pub(crate) fn forget_losses(&mut self) {
        for counter in self.shared.counters.borrow().iter() {
            counter.forget();
        }
        self.skipped = 0;
    }

    fn answer_handover(&self, done: bool, handover_step: Position) -> Result<(), NodeError> {
        let state = match done {
            true => ProcessState::HandoverAgreed,
            false => ProcessState::TooLate,
        };
        Ok(self.send_report_at(state, "", handover_step)?)
    }
}
