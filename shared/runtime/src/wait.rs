//! How a process waits: for messages, for a step's messages, for its turn, for a beat of the clock; and for its
//! launcher always.

use crate::clock::{Ticker, now_ns};
use crate::error::NodeError;
use crate::input::{Advance, Source};
use crate::node::{Node, allocations_now};
use crate::signal;
use crate::sleeper::Woken;
use messages::ProcessState;

/// Why a wait ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wake {
    /// What was waited for is there.
    Message,
    /// What was waited for in order will not come any more: a later message is there instead.
    Passed,
    /// The deadline passed.
    Deadline,
    /// The process shall end: SIGTERM, SIGINT, the launcher's word or the launcher's death.
    Stop,
}

impl Node {
    /// Tells the launcher that all ports stand, and waits for its start: [`Wake::Message`], or [`Wake::Stop`] if the
    /// run ends before it began. No message is lost that is sent after everybody's start.
    ///
    /// # Errors
    /// [`NodeError::Port`], [`NodeError::System`].
    pub fn ready(&mut self) -> Result<Wake, NodeError> {
        self.shared.connect();
        self.send_report(ProcessState::Ready, "")?;
        while !self.started {
            if self.wait(&mut [], None)? == Wake::Stop {
                return Ok(Wake::Stop);
            }
        }
        self.shared.connect();
        self.shared.begin_step(now_ns());
        self.allocations_before = allocations_now();
        Ok(Wake::Message)
    }

    /// Waits until the process is active at this position, for one that is on standby without reading.
    ///
    /// # Errors
    /// As [`Node::wait`].
    pub fn wait_turn(&mut self, episode: u32, step: u32) -> Result<Wake, NodeError> {
        let shared = self.shared.clone();
        self.wait_until(&mut [], None, |_| {
            Ok(shared.turn.is_active((episode, step)))
        })
    }

    /// Waits until a message waits at any of `sources`, or until `deadline_ns` ([`now_ns`]).
    ///
    /// # Errors
    /// [`NodeError::Port`], [`NodeError::System`].
    pub fn wait(
        &mut self,
        sources: &mut [&mut dyn Source],
        deadline_ns: Option<u64>,
    ) -> Result<Wake, NodeError> {
        self.wait_until(sources, deadline_ns, |sources| {
            for source in sources.iter_mut() {
                if source.pending()? {
                    return Ok(true);
                }
            }
            Ok(false)
        })
    }

    /// Waits until every one of `sources` holds its message of this episode and step as the current one: lockstep.
    /// [`Wake::Passed`] if an in-order source has a later message instead, as it happens to one that joins late or
    /// after a death.
    ///
    /// # Errors
    /// As [`Node::wait`].
    pub fn wait_step(
        &mut self,
        sources: &mut [&mut dyn Source],
        episode: u32,
        step: u32,
        deadline_ns: Option<u64>,
    ) -> Result<Wake, NodeError> {
        let mut passed = false;
        let wake = self.wait_until(sources, deadline_ns, |sources| {
            let mut complete = true;
            for source in sources.iter_mut() {
                match source.advance_to(episode, step)? {
                    Advance::There => {}
                    Advance::Waiting => complete = false,
                    Advance::Passed => passed = true,
                }
            }
            Ok(complete || passed)
        })?;
        if passed && wake == Wake::Message {
            self.skipped += 1;
            return Ok(Wake::Passed);
        }
        Ok(wake)
    }

    /// Waits for the ticker's next beat, ignoring messages, and counts the beats missed before it.
    ///
    /// # Errors
    /// [`NodeError::Port`], [`NodeError::System`].
    pub fn wait_tick(&mut self, ticker: &mut Ticker) -> Result<Wake, NodeError> {
        let wake = self.wait_until(&mut [], Some(ticker.deadline_ns()), |_| Ok(false))?;
        if wake == Wake::Deadline {
            self.missed += ticker.advance(now_ns());
        }
        Ok(wake)
    }

    fn wait_until(
        &mut self,
        sources: &mut [&mut dyn Source],
        deadline_ns: Option<u64>,
        mut is_done: impl FnMut(&mut [&mut dyn Source]) -> Result<bool, NodeError>,
    ) -> Result<Wake, NodeError> {
        self.shared.fall_asleep();
        let spin_end = match self.arguments.spin_us {
            0 => 0,
            spin => now_ns() + u64::from(spin) * 1_000,
        };
        let was_started = self.started;
        let wake = loop {
            if self.stop_requested() {
                break Wake::Stop;
            }
            // The launcher first: one that always has work waiting must hear it, too.
            if self.serve_control()? {
                if self.started != was_started {
                    break Wake::Message;
                }
                continue;
            }
            if is_done(sources)? {
                break Wake::Message;
            }
            let now = now_ns();
            if deadline_ns.is_some_and(|deadline| now >= deadline) {
                break Wake::Deadline;
            }
            if now < spin_end {
                core::hint::spin_loop();
                continue;
            }
            // What is emptied is looked at again before the process sleeps: see `Sleeper`.
            let mut emptied = self.sleeper.empty(&mut self.control);
            for source in sources.iter_mut() {
                emptied |= self.sleeper.empty(*source);
            }
            if !emptied {
                self.sleep(sources, deadline_ns, now)?;
            }
        };
        self.shared.wake_up();
        Ok(wake)
    }

    fn sleep(
        &mut self,
        sources: &mut [&mut dyn Source],
        deadline_ns: Option<u64>,
        now: u64,
    ) -> Result<(), NodeError> {
        let sleeper = &mut self.sleeper;
        sleeper.poll.clear();
        sleeper.poll.add(signal::stop_descriptor());
        sleeper.poll.add(self.launcher);
        sleeper.poll.add(self.control.descriptor());
        for source in sources.iter() {
            sleeper.poll.add(source.descriptor());
        }
        let until_deadline = deadline_ns.map_or(u64::MAX, |deadline| deadline.saturating_sub(now));
        let woken = sleeper.sleep(until_deadline)?;
        if woken != Woken::Ready {
            if woken != Woken::NapOver {
                self.shared.connect();
            }
            sleeper.reset(&mut self.control)?;
            for source in sources.iter_mut() {
                sleeper.reset(*source)?;
            }
            return Ok(());
        }
        if sleeper.poll.is_ready(1) {
            signal::launcher_died();
        }
        if sleeper.poll.is_ready(2) {
            self.control.mark_notified();
        }
        for (index, source) in sources.iter_mut().enumerate() {
            if sleeper.poll.is_ready(3 + index) {
                source.mark_notified();
            }
        }
        Ok(())
    }
}
