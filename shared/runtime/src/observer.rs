//! Somebody who only watches a running set: no process of it, started and ended by somebody else, and waited for by
//! nobody.

use crate::arguments::{ClockMode, RunArguments};
use crate::clock::now_ns;
use crate::error::{InstanceError, NodeError, PortError};
use crate::input::{Input, InputOptions};
use crate::instance;
use crate::launcher::process_descriptor;
use crate::output::{Output, Stamp};
use crate::poll::Poll;
use crate::shared::SharedNode;
use crate::signal;
use messages::{Control, ControlCommand, Message, topic};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// Why [`Observer::sleep`] ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObserverWake {
    /// The time has come.
    Deadline,
    /// SIGTERM or SIGINT.
    Stop,
    /// The set's launcher has ended.
    RunOver,
}

/// A node beside a running set. Its inputs do not wake it, and nobody waits for it.
///
/// Dropped after the set's launcher has ended, it removes what the launcher could not while somebody watched.
pub struct Observer {
    // Before the node they belong to.
    control: Option<Output<Control>>,
    shared: Option<Rc<SharedNode>>,
    launcher: OwnedFd,
    launcher_pid: u32,
    poll: Poll,
    root: PathBuf,
    instance: String,
    name: String,
}

impl Observer {
    /// Joins a running instance as `name`.
    ///
    /// # Errors
    /// [`NodeError::Instance`] if the name cannot be one, [`NodeError::LauncherGone`] if nobody runs it.
    pub fn attach(root: &Path, instance: &str, name: &str) -> Result<Self, NodeError> {
        instance::check_name(instance)?;
        let launcher_pid = instance::launcher(root, instance).unwrap_or(0);
        let gone = || NodeError::LauncherGone {
            instance: instance.to_owned(),
            pid: launcher_pid,
        };
        if launcher_pid == 0 {
            return Err(gone());
        }
        let launcher = process_descriptor(launcher_pid).map_err(|_| gone())?;
        // Who held the lock before the descriptor was opened and holds it now is the process that it stands for.
        if instance::launcher(root, instance) != Some(launcher_pid) {
            return Err(gone());
        }
        Ok(Self {
            control: None,
            shared: Some(Self::open(root, instance, name, 0)?),
            launcher,
            launcher_pid,
            poll: Poll::new(),
            root: root.to_owned(),
            instance: instance.to_owned(),
            name: name.to_owned(),
        })
    }

    /// As [`Observer::attach`], for a process that the set's launcher started: it ends with its launcher, and in order
    /// when it is told to.
    ///
    /// # Errors
    /// As [`Observer::attach`]; [`NodeError::System`].
    pub fn join(arguments: &RunArguments) -> Result<Self, NodeError> {
        signal::install()?;
        let launcher = signal::follow_launcher(arguments)?;
        let observer = Self::attach(&arguments.root, &arguments.instance, &arguments.process);
        // The observer has a descriptor of its own.
        // SAFETY: a descriptor that was opened for us, and that nobody else knows.
        drop(unsafe { OwnedFd::from_raw_fd(launcher) });
        observer
    }

    fn open(
        root: &Path,
        instance: &str,
        name: &str,
        run_id: u64,
    ) -> Result<Rc<SharedNode>, NodeError> {
        SharedNode::open(&RunArguments {
            process: name.to_owned(),
            ..RunArguments::new(root, instance, run_id, ClockMode::Lockstep)?
        })
    }

    /// Process id of the set's launcher.
    pub fn launcher_pid(&self) -> u32 {
        self.launcher_pid
    }

    /// The instance's name.
    pub fn instance(&self) -> &str {
        &self.instance
    }

    /// Directory of the instance, where its processes' arguments lie.
    pub fn directory(&self) -> PathBuf {
        instance::directory(&self.root, &self.instance)
    }

    /// A receiving side of a topic, as a recorder's: every message, a large buffer, not waking.
    ///
    /// # Errors
    /// As [`Node::input_with`](crate::Node::input_with).
    pub fn input<M: Message>(&self, topic: &'static str) -> Result<Input<M>, PortError> {
        match &self.shared {
            Some(shared) => {
                let input = Input::new(shared, topic, InputOptions::recorder());
                // Ports of earlier inputs that are gone need no connecting any more.
                let mut ports = shared.ports.borrow_mut();
                ports.retain(|port| port.strong_count() > 0);
                input
            }
            None => Err(PortError::Create {
                topic: topic.to_owned(),
                reason: "the observer has left".to_owned(),
            }),
        }
    }

    /// Asks every process of the run for a report, which wakes each of them once.
    ///
    /// # Errors
    /// [`NodeError`].
    pub fn request_reports(&mut self, run_id: u64) -> Result<(), NodeError> {
        if self.control.is_none() {
            let shared = Self::open(&self.root, &self.instance, &self.name, run_id)?;
            self.control = Some(Output::new(&shared, topic::CONTROL)?);
        }
        if let Some(control) = &self.control {
            control.send_with(Stamp::default(), |control| {
                control.command = ControlCommand::Report.wire();
                control.process = Control::EVERYBODY;
            })?;
        }
        Ok(())
    }

    /// Sleeps until `deadline_ns` ([`now_ns`]), a signal, or the launcher's end.
    ///
    /// # Errors
    /// [`NodeError::System`].
    pub fn sleep(&mut self, deadline_ns: u64) -> Result<ObserverWake, NodeError> {
        loop {
            if signal::stop_requested() {
                return Ok(ObserverWake::Stop);
            }
            let now = now_ns();
            if now >= deadline_ns {
                return Ok(ObserverWake::Deadline);
            }
            self.poll.clear();
            self.poll.add(signal::stop_descriptor());
            self.poll.add(self.launcher.as_raw_fd());
            self.poll.wait(deadline_ns - now)?;
            if self.poll.is_ready(1) {
                return Ok(ObserverWake::RunOver);
            }
        }
    }
}

impl Drop for Observer {
    fn drop(&mut self) {
        self.control = None;
        self.shared = None;
        // A launcher leaves everything in place while somebody else is in its instance.
        if !instance::is_locked(&self.root, &self.instance) {
            let _: Result<_, InstanceError> = instance::cleanup_dead(&self.root, &self.instance);
        }
    }
}
