//! A process's place in a run: it makes the ports, and counts steps. How it waits stands in `wait.rs`, how it heeds the
//! launcher in `control.rs`, what it reports in `report.rs`.

use crate::alloc_count::{allocations, transport_allocations};
use crate::arguments::RunArguments;
use crate::clock::now_ns;
use crate::error::{NodeError, PortError};
use crate::input::{Input, InputOptions, Receive};
use crate::output::Output;
use crate::shared::SharedNode;
use crate::signal;
use crate::sleeper::Sleeper;
use crate::timing::StageTimer;
use crate::turn::Position;
use messages::{Control, Message, ProcessState, Report, topic};
use std::os::fd::RawFd;
use std::rc::Rc;

/// Steps after which the loop counts as steady: connections stand and buffers have their sizes.
const WARM_UP_STEPS: u64 = 10;
/// A process that is on standby has caught up after as many steps in a row as the self-model's belief was trained over.
const CATCH_UP_STEPS: u64 = 8;

/// A process's node.
pub struct Node {
    pub(crate) report: Output<Report>,
    pub(crate) control: Input<Control>,
    pub(crate) shared: Rc<SharedNode>,
    pub(crate) arguments: RunArguments,
    pub(crate) launcher: RawFd,
    pub(crate) sleeper: Sleeper,
    pub(crate) timer: StageTimer,
    pub(crate) steps: u64,
    pub(crate) missed: u64,
    pub(crate) allocations: [u64; 2],
    pub(crate) allocations_before: [u64; 2],
    pub(crate) started: bool,
    pub(crate) stopped: bool,
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
        let shared = SharedNode::open(arguments)?;
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

    /// Connects this process's ports to those that others made since. [`Node::ready`], sends, receives and long waits
    /// do it anyway.
    pub fn connect(&self) {
        self.shared.connect();
    }

    /// Whether the process shall end.
    pub fn stop_requested(&self) -> bool {
        self.stopped || signal::stop_requested()
    }

    /// Whether it is this process's to send what is about this position: not while it is on standby, and not from the
    /// handover step on at which it handed over. [`Output`]s heed it by themselves; a process asks in order to leave
    /// out work.
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
pub(crate) fn allocations_now() -> [u64; 2] {
    [allocations(), transport_allocations()]
}
