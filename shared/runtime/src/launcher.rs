//! The launcher's side of a run: it keeps every service open, starts everybody at once and hears their reports.

use crate::arguments::{ClockMode, RunArguments};
use crate::clock::now_ns;
use crate::error::{NodeError, PortError};
use crate::input::{Input, InputOptions, Receive, Source};
use crate::instance::{self, CleanupReport, InstanceLock};
use crate::output::{Output, Stamp};
use crate::service::{open_topic, open_wake_event};
use crate::shared::SharedNode;
use crate::signal;
use crate::sleeper::{Sleeper, Woken};
use crate::turn::Position;
use messages::{Control, ControlCommand, Message, ProcessState, Progress, Report, topic};
use std::any::Any;
use std::os::fd::RawFd;
use std::rc::Rc;

/// Why [`Launcher::wait`] ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LauncherWake {
    /// A report waits; see [`Launcher::next_report`].
    Report,
    /// The child with this place in `children` has ended.
    Child(usize),
    /// The deadline passed.
    Deadline,
    /// SIGTERM or SIGINT.
    Stop,
}

/// The launcher's node. It outlives the processes, so that restarted ones find every service as it was.
pub struct Launcher {
    reports: Input<Report>,
    control: Output<Control>,
    progress: Output<Progress>,
    _services: Vec<Box<dyn Any>>,
    shared: Rc<SharedNode>,
    arguments: RunArguments,
    sleeper: Sleeper,
    // Last: it removes the instance's directory.
    _lock: InstanceLock,
}

impl Launcher {
    /// Opens an instance that was taken with [`InstanceLock::acquire`]. Spawn children from a thread that lives as long
    /// as they shall.
    ///
    /// # Errors
    /// [`NodeError`].
    pub fn open(lock: InstanceLock, run_id: u64, clock: ClockMode) -> Result<Self, NodeError> {
        let arguments = RunArguments::new(lock.root(), lock.instance(), run_id, clock)?;
        let shared = SharedNode::open(&arguments)?;
        let reports = Input::new(&shared, topic::REPORT, InputOptions::new(Receive::InOrder))?;
        let control = Output::new(&shared, topic::CONTROL)?;
        let progress = Output::new(&shared, topic::PROGRESS)?;
        let services = keep_open(&shared)?;
        Ok(Self {
            reports,
            control,
            progress,
            _services: services,
            shared,
            arguments,
            sleeper: Sleeper::new(),
            _lock: lock,
        })
    }

    /// The launcher's own arguments; [`RunArguments::for_process`] makes the children's.
    pub fn arguments(&self) -> &RunArguments {
        &self.arguments
    }

    /// A receiving side of a topic, for the launcher's own status line and summary.
    ///
    /// # Errors
    /// As [`Node::input_with`](crate::Node::input_with).
    pub fn input_with<M: Message>(
        &self,
        topic: &'static str,
        options: InputOptions,
    ) -> Result<Input<M>, PortError> {
        Input::new(&self.shared, topic, options)
    }

    /// Waits for a report, the end of a child, or the deadline. `children` are process descriptors (see
    /// [`process_descriptor`]).
    ///
    /// # Errors
    /// [`NodeError`].
    pub fn wait(
        &mut self,
        children: &[RawFd],
        deadline_ns: Option<u64>,
    ) -> Result<LauncherWake, NodeError> {
        loop {
            if signal::stop_requested() {
                return Ok(LauncherWake::Stop);
            }
            if self.reports.pending()? {
                return Ok(LauncherWake::Report);
            }
            let now = now_ns();
            if deadline_ns.is_some_and(|deadline| now >= deadline) {
                return Ok(LauncherWake::Deadline);
            }
            // What is emptied is looked at again before the launcher sleeps: see `Sleeper`.
            if self.sleeper.empty(&mut self.reports) {
                continue;
            }
            let poll = &mut self.sleeper.poll;
            poll.clear();
            poll.add(signal::stop_descriptor());
            poll.add(self.reports.descriptor());
            for child in children {
                poll.add(*child);
            }
            let until_deadline =
                deadline_ns.map_or(u64::MAX, |deadline| deadline.saturating_sub(now));
            if self.sleeper.sleep(until_deadline)? != Woken::Ready {
                self.sleeper.reset(&mut self.reports)?;
            } else if self.sleeper.poll.is_ready(1) {
                self.reports.mark_notified();
            }
            self.shared.connect();
            // A child's last report comes before its end.
            if self.reports.pending()? {
                return Ok(LauncherWake::Report);
            }
            let poll = &self.sleeper.poll;
            if let Some(child) = (0..children.len()).find(|child| poll.is_ready(2 + child)) {
                return Ok(LauncherWake::Child(child));
            }
        }
    }

    /// Reports that waited for the launcher to look up, though it had been notified: 0 unless the transport lost a
    /// wake-up.
    pub fn lost_wakeups(&self) -> u64 {
        self.sleeper.lost_wakeups()
    }

    /// The next report that waits.
    ///
    /// # Errors
    /// [`PortError::Receive`].
    pub fn next_report(&mut self) -> Result<Option<Report>, PortError> {
        Ok(self.reports.next()?.copied())
    }

    /// Waits until every one of `processes` said that it is ready. `children` are their process descriptors.
    ///
    /// # Errors
    /// [`NodeError::NotReady`] at the deadline, when a child ends, or on a signal; [`NodeError::ProcessFailed`] when
    /// one says so.
    pub fn wait_ready(
        &mut self,
        processes: &[&str],
        children: &[RawFd],
        deadline_ns: u64,
    ) -> Result<(), NodeError> {
        let mut missing: Vec<&str> = processes.to_vec();
        let not_ready = |missing: &[&str]| NodeError::NotReady {
            missing: missing.join(", "),
        };
        while !missing.is_empty() {
            match self.wait(children, Some(deadline_ns))? {
                LauncherWake::Report => {
                    while let Some(report) = self.next_report()? {
                        let process = text_of(&report.process);
                        if report.header.run_id != self.arguments.run_id {
                            continue;
                        }
                        if report.state() == Ok(ProcessState::Failed) {
                            return Err(NodeError::ProcessFailed {
                                process,
                                text: text_of(&report.text),
                            });
                        }
                        missing.retain(|name| *name != process);
                    }
                }
                LauncherWake::Child(child) => {
                    return Err(not_ready(
                        &processes
                            .get(child)
                            .map_or(missing.clone(), |name| vec![*name]),
                    ));
                }
                LauncherWake::Deadline | LauncherWake::Stop => return Err(not_ready(&missing)),
            }
        }
        Ok(())
    }

    /// Starts everybody.
    ///
    /// # Errors
    /// [`PortError`].
    pub fn start(&mut self) -> Result<(), PortError> {
        self.shared.start_ns.set(now_ns());
        self.command(ControlCommand::Start, Control::EVERYBODY, (0, 0))
    }

    /// Starts one process, such as one that is on standby, by its place in launch order.
    ///
    /// # Errors
    /// [`PortError`].
    pub fn start_process(&mut self, index: u32) -> Result<(), PortError> {
        self.command(ControlCommand::Start, index, (0, 0))
    }

    /// Has a process be active from `handover_step` on, and starts it if it is not running yet. It answers with
    /// [`ProcessState::HandoverAgreed`] or [`ProcessState::TooLate`].
    ///
    /// # Errors
    /// [`PortError`].
    pub fn take_over(&mut self, index: u32, handover_step: Position) -> Result<(), PortError> {
        self.command(ControlCommand::TakeOver, index, handover_step)
    }

    /// Has a process be silent from `handover_step` on, or, at [`NEVER`](crate::NEVER), take back that it shall. It
    /// answers as for [`Launcher::take_over`].
    ///
    /// # Errors
    /// [`PortError`].
    pub fn hand_over(&mut self, index: u32, handover_step: Position) -> Result<(), PortError> {
        self.command(ControlCommand::HandOver, index, handover_step)
    }

    /// Asks everybody to end.
    ///
    /// # Errors
    /// [`PortError`].
    pub fn stop(&mut self) -> Result<(), PortError> {
        self.command(ControlCommand::Stop, Control::EVERYBODY, (0, 0))
    }

    /// Asks one process to end.
    ///
    /// # Errors
    /// [`PortError`].
    pub fn stop_process(&mut self, index: u32) -> Result<(), PortError> {
        self.command(ControlCommand::Stop, index, (0, 0))
    }

    /// Asks everybody for a report: who does not answer hangs.
    ///
    /// # Errors
    /// [`PortError`].
    pub fn request_reports(&mut self) -> Result<(), PortError> {
        self.command(ControlCommand::Report, Control::EVERYBODY, (0, 0))
    }

    /// Has everybody connect to who joined, at once instead of when they next send or look up.
    ///
    /// # Errors
    /// [`PortError`].
    pub fn connect_all(&mut self) -> Result<(), PortError> {
        self.shared.connect();
        self.command(ControlCommand::Connect, Control::EVERYBODY, (0, 0))
    }

    /// Tells a lockstep world how far the launcher has taken in what was sent, and which recorder it is to wait for, by
    /// its place in launch order. A world that was told once waits for both: say it some times a second.
    ///
    /// # Errors
    /// [`PortError`].
    pub fn tell_progress(
        &mut self,
        (episode, step): Position,
        recorder: Option<u32>,
    ) -> Result<(), PortError> {
        let stamp = Stamp {
            episode,
            step,
            cause_ns: 0,
        };
        self.progress.send_with(stamp, |progress| {
            progress.process = Progress::LAUNCHER;
            progress.recorder = recorder.unwrap_or(Progress::NO_RECORDER);
        })
    }

    fn command(
        &self,
        command: ControlCommand,
        process: u32,
        position: Position,
    ) -> Result<(), PortError> {
        let stamp = Stamp {
            episode: position.0,
            step: position.1,
            cause_ns: 0,
        };
        self.control.send_with(stamp, |control| {
            control.command = command.wire();
            control.process = process;
        })
    }

    /// Removes what dead processes of this instance left; for after a child's death.
    ///
    /// # Errors
    /// [`NodeError::Instance`].
    pub fn clean(&self) -> Result<CleanupReport, NodeError> {
        Ok(instance::clean_nodes(
            &self.arguments.root,
            &self.arguments.instance,
        )?)
    }
}

/// A descriptor that becomes readable when the process ends; close it with its owner.
///
/// # Errors
/// [`NodeError::System`] if there is no such process.
pub fn process_descriptor(pid: u32) -> Result<std::os::fd::OwnedFd, NodeError> {
    use std::os::fd::FromRawFd;
    // SAFETY: a plain system call; the descriptor it returns is ours.
    unsafe {
        let descriptor = libc::syscall(libc::SYS_pidfd_open, pid as libc::pid_t, 0) as RawFd;
        if descriptor < 0 {
            return Err(NodeError::System {
                call: "pidfd_open",
                source: std::io::Error::last_os_error(),
            });
        }
        Ok(std::os::fd::OwnedFd::from_raw_fd(descriptor))
    }
}

/// Zero-padded text of a message's field.
pub fn text_of(bytes: &[u8]) -> String {
    let end = bytes
        .iter()
        .position(|byte| *byte == 0)
        .unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).into_owned()
}

fn keep_open(shared: &Rc<SharedNode>) -> Result<Vec<Box<dyn Any>>, PortError> {
    fn open<M: Message>(
        shared: &Rc<SharedNode>,
        topic: &str,
        kept: &mut Vec<Box<dyn Any>>,
    ) -> Result<(), PortError> {
        kept.push(Box::new(open_topic::<M>(&shared.node, topic)?));
        kept.push(Box::new(open_wake_event(&shared.node, topic)?));
        Ok(())
    }
    let mut kept = Vec::new();
    open::<messages::LidarFrame>(shared, topic::LIDAR, &mut kept)?;
    open::<messages::Observation>(shared, topic::OBSERVATION, &mut kept)?;
    open::<messages::Picture>(shared, topic::PICTURE, &mut kept)?;
    open::<messages::Scene>(shared, topic::SCENE, &mut kept)?;
    open::<messages::Outcome>(shared, topic::OUTCOME, &mut kept)?;
    open::<messages::RobotBelief>(shared, topic::ROBOT_BELIEF, &mut kept)?;
    open::<messages::HumanBelief>(shared, topic::HUMAN_BELIEF, &mut kept)?;
    open::<messages::CommAction>(shared, topic::COMM_ACTION, &mut kept)?;
    open::<messages::Display>(shared, topic::DISPLAY, &mut kept)?;
    open::<messages::DriverAction>(shared, topic::DRIVER_ACTION, &mut kept)?;
    open::<messages::ImagineRequest>(shared, topic::IMAGINE, &mut kept)?;
    open::<messages::ImagineAnswer>(shared, topic::IMAGINE_ANSWER, &mut kept)?;
    open::<Progress>(shared, topic::PROGRESS, &mut kept)?;
    Ok(kept)
}
