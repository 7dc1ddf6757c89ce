//! Tells a lockstep world how far the recorder has come, so that it runs no further ahead than the recorder's ports
//! hold.

use crate::topics::{Recorded, TOPICS};
use messages::{Progress, topic};
use runtime::{ClockMode, Node, Output, PortError, Position, Stamp};

/// What was taken in, and what the world knows of it.
pub(crate) struct Teller {
    /// None in real time, where nobody waits.
    output: Option<Output<Progress>>,
    process: u32,
    newest: Position,
    told: Position,
}

impl Teller {
    /// Makes the port, where there is somebody to tell.
    pub(crate) fn new(node: &Node) -> Result<Self, PortError> {
        let arguments = node.arguments();
        Ok(Self {
            output: match arguments.clock {
                ClockMode::Lockstep => Some(node.output(topic::PROGRESS)?),
                ClockMode::RealTime => None,
            },
            process: arguments.index,
            newest: (0, 0),
            told: (0, 0),
        })
    }

    /// Notes a message that was taken.
    pub(crate) fn note(&mut self, message: &Recorded) {
        if TOPICS[message.topic()].is_repeatable() {
            let header = message.header();
            self.newest = self.newest.max((header.episode, header.step));
        }
    }

    /// Tells the world, if there is news.
    pub(crate) fn tell(&mut self) -> Result<(), PortError> {
        let Some(output) = self.output.as_ref().filter(|_| self.newest > self.told) else {
            return Ok(());
        };
        self.told = self.newest;
        let stamp = Stamp {
            episode: self.newest.0,
            step: self.newest.1,
            cause_ns: 0,
        };
        output.send_with(stamp, |progress| {
            progress.process = self.process;
            progress.recorder = Progress::NO_RECORDER;
        })
    }
}
