//! A process's place in a run: it makes the ports, waits for messages, and reports to the launcher.

use crate::alloc_count::{allocations, transport_allocations};
use crate::arguments::RunArguments;
use crate::clock::{Ticker, now_ns};
use crate::error::{NodeError, PortError};
use crate::imagine::{RequestClient, RequestServer};
use crate::input::{Advance, Input, InputOptions, Receive, Source};
use crate::output::Output;
use crate::shared::Shared;
use crate::signal;
use crate::sleeper::{Sleeper, Woken};
use crate::timing::StageTimer;
use crate::turn::Position;
use messages::{Control, ControlCommand, Message, ProcessState, Report, topic};
use std::os::fd::RawFd;
use std::rc::Rc;

/// Steps after which the loop counts as steady: connections stand and buffers have their sizes.
const WARM_UP_STEPS: u64 = 10;
/// A process that is on standby has caught up after as many steps in a row as the self-model's belief was trained over.
const CATCH_UP_STEPS: u64 = 8;

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

/// A process's node.
pub struct Node {
    pub(crate) report: Output<Report>,
    control: Input<Control>,
    pub(crate) shared: Rc<Shared>,
    pub(crate) arguments: RunArguments,
    launcher: RawFd,
    pub(crate) sleeper: Sleeper,
    pub(crate) timer: StageTimer,
    pub(crate) steps: u64,
    pub(crate) missed: u64,
    pub(crate) allocations: [u64; 2],
    allocations_before: [u64; 2],
    started: bool,
    stopped: bool,
    /// Steps to read in silence before the process says that it has caught up; 0 once it has.
    catch_up: u64,
    pub(crate) skipped: u64,
    has_spoken: bool,
    pub(crate) digest: [u8; 32],
}

impl Node {
    /// Joins the run. Signal handlers are installed, and the process's life is tied to its launcher's.
    ///
    /// # Errors
    /// [`NodeError::LauncherGone`], [`NodeError::Join`], or what the control and report ports meet.
    pub fn join(arguments: &RunArguments) -> Result<Self, NodeError> {
        let launcher = if arguments.launcher_pid != 0 {
            signal::install()?;
            signal::follow_launcher(arguments)?
        } else {
            -1
        };
        let shared = Shared::open(arguments)?;
        let control = Input::new(&shared, topic::CONTROL, InputOptions::new(Receive::InOrder))?;
        let report = Output::new(&shared, topic::REPORT)?;
        // The launcher's words are no business of the run's losses.
        shared.counters.borrow_mut().clear();
        Ok(Self {
            report,
            control,
            shared,
            arguments: arguments.clone(),
            launcher,
            sleeper: Sleeper::new(),
            timer: StageTimer::new(),
            steps: 0,
            missed: 0,
            allocations: [0; 2],
            allocations_before: [0; 2],
            started: false,
            stopped: false,
            catch_up: if arguments.standby { CATCH_UP_STEPS } else { 0 },
            skipped: 0,
            has_spoken: !arguments.standby,
            digest: [0; 32],
        })
    }

    /// The arguments that the node joined with.
    pub fn arguments(&self) -> &RunArguments {
        &self.arguments
    }

    /// Makes the sending side of a topic.
    ///
    /// # Errors
    /// [`PortError::Layout`] if the topic carries another version of the message; [`PortError::Open`],
    /// [`PortError::Create`].
    pub fn output<M: Message>(&self, topic: &'static str) -> Result<Output<M>, PortError> {
        Output::new(&self.shared, topic)
    }

    /// Makes a receiving side of a topic, with a usual buffer.
    ///
    /// # Errors
    /// As [`Node::output`].
    pub fn input<M: Message>(
        &self,
        topic: &'static str,
        receive: Receive,
    ) -> Result<Input<M>, PortError> {
        Input::new(&self.shared, topic, InputOptions::new(receive))
    }

    /// Makes a receiving side of a topic.
    ///
    /// # Errors
    /// As [`Node::output`].
    pub fn input_with<M: Message>(
        &self,
        topic: &'static str,
        options: InputOptions,
    ) -> Result<Input<M>, PortError> {
        Input::new(&self.shared, topic, options)
    }

    /// The asking side of imagination (`human/imagine`).
    ///
    /// # Errors
    /// As [`Node::output`].
    pub fn request_client(&self) -> Result<RequestClient, PortError> {
        RequestClient::new(self)
    }

    /// The answering side of imagination (`human/imagine`).
    ///
    /// # Errors
    /// As [`Node::output`].
    pub fn request_server(&self) -> Result<RequestServer, PortError> {
        RequestServer::new(self)
    }

    /// Tells the launcher that all ports stand, and waits for its start: [`Wake::Message`], or [`Wake::Stop`] if the run
    /// ends before it began. No message is lost that is sent after everybody's start.
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

    /// Connects this process's ports to those that others made since. [`Node::ready`], sends, receives and long waits do
    /// it anyway.
    pub fn connect(&self) {
        self.shared.connect();
    }

    /// Whether the process shall end.
    pub fn stop_requested(&self) -> bool {
        self.stopped || signal::stop_requested()
    }

    /// Whether it is this process's to send what is about this position: not while it is on standby, and not from the handover step on
    /// at which it handed over. [`Output`]s heed it by themselves; a process asks in order to leave out work.
    pub fn is_active(&self, episode: u32, step: u32) -> bool {
        self.shared.turn.is_active((episode, step))
    }

    /// Whether the process is on standby and does not know yet from when on it is active.
    pub fn is_standby(&self) -> bool {
        self.shared.turn.is_standby()
    }

    /// Notes that this position passes without anything computed for it: a handover step there is refused from now on.
    pub fn pass(&self, episode: u32, step: u32) {
        self.shared.turn.note_passed((episode, step));
    }

    /// The process needs no catching up: it keeps nothing from step to step.
    pub fn needs_no_catching_up(&mut self) {
        self.catch_up = self.catch_up.min(1);
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

    /// Tells the launcher that the process has come to the handover step from which on it is silent.
    ///
    /// # Errors
    /// [`NodeError::Port`].
    pub fn retire(&mut self) -> Result<(), NodeError> {
        Ok(self.send_report(ProcessState::Retired, "")?)
    }

    /// From where on the process is active.
    pub fn active_from(&self) -> Position {
        self.shared.turn.from()
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
    /// [`Wake::Passed`] if an in-order source has a later message instead, as it happens to one that joins late or after
    /// a death.
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

    /// Heeds what the launcher says; false if it said nothing.
    fn serve_control(&mut self) -> Result<bool, NodeError> {
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

    fn forget_losses(&mut self) {
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

    /// Ends a step: its compute time goes into the histogram, and allocations are counted once the loop is steady.
    pub fn end_step(&mut self) {
        let now = now_ns();
        self.timer.record(self.shared.computed_ns(now));
        self.shared.begin_step(now);
        self.steps += 1;
        let allocations = allocations_now();
        if self.steps > WARM_UP_STEPS {
            for kind in 0..2 {
                self.allocations[kind] += allocations[kind] - self.allocations_before[kind];
            }
        }
        self.allocations_before = allocations;
        if !self.has_spoken && self.shared.turn.sent().is_some() {
            // What a process missed before its first words is missing nowhere.
            self.has_spoken = true;
            self.forget_losses();
        }
        if self.catch_up > 0 {
            self.catch_up -= 1;
            if self.catch_up == 0 && self.is_standby() {
                // A report that cannot be sent is missed by the launcher, which then says so.
                let _ = self.send_report(ProcessState::CaughtUp, "");
            }
        }
    }

    /// Steps ended so far.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Counts missed deadlines that the process noticed itself, such as a decision that came late.
    pub fn count_missed(&mut self, missed: u64) {
        self.missed += missed;
    }

    /// Heap allocations of this thread since the loop became steady (ten steps), the transport's included; needs
    /// [`CountingAllocator`](crate::CountingAllocator).
    pub fn steady_allocations(&self) -> u64 {
        self.allocations[0]
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        if self.launcher >= 0 {
            // SAFETY: the descriptor is ours, and closed only here.
            unsafe { libc::close(self.launcher) };
        }
    }
}

/// This thread's allocations: all, and those of them that iceoryx2 made while loaning.
fn allocations_now() -> [u64; 2] {
    [allocations(), transport_allocations()]
}
