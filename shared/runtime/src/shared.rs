//! What a node and its ports have in common: iceoryx2's node, the run, and the clock of the current step.

use crate::arguments::RunArguments;
use crate::clock::{self, now_ns};
use crate::error::NodeError;
use crate::transport::Ipc;
use crate::turn::Turn;
use crate::{instance, private, signal};
use core::cell::{Cell, RefCell};
use iceoryx2::prelude::{NodeBuilder, NodeName, SignalHandlingMode};
use std::rc::{Rc, Weak};

/// A port, as its node sees it.
pub(crate) trait Connect {
    /// Connects it to those that others made since.
    fn connect(&self);
    /// Sends what it held back and may now say.
    fn release(&self);
}

/// What a port counted, for the process's report.
#[derive(Debug)]
pub(crate) struct Counter {
    pub(crate) topic: &'static str,
    pub(crate) received: Cell<u64>,
    pub(crate) lost: Cell<u64>,
}

impl Counter {
    /// Counts anew.
    pub(crate) fn forget(&self) {
        self.received.set(0);
        self.lost.set(0);
    }
}

/// What a node and its ports have in common.
pub(crate) struct SharedNode {
    pub(crate) node: iceoryx2::node::Node<Ipc>,
    pub(crate) run_id: u64,
    /// When the launcher started the run; 0 before.
    pub(crate) start_ns: Cell<u64>,
    /// When the last wait ended.
    wake_ns: Cell<u64>,
    /// What this step computed before its last wait.
    banked_ns: Cell<u64>,
    pub(crate) ports: RefCell<Vec<Weak<dyn Connect>>>,
    pub(crate) counters: RefCell<Vec<Rc<Counter>>>,
    /// From when to when the process is active.
    pub(crate) turn: Turn,
}

impl SharedNode {
    pub(crate) fn open(arguments: &RunArguments) -> Result<Rc<Self>, NodeError> {
        signal::install()?;
        let failed = |reason: String| NodeError::Join {
            instance: arguments.instance.clone(),
            process: arguments.process.clone(),
            reason,
        };
        let config = instance::config(&arguments.root, &arguments.instance)?;
        // iceoryx2 would make it with rights for the user's group.
        private::create(&instance::directory(&arguments.root, &arguments.instance))?;
        let prefix = instance::prefix(&arguments.root, &arguments.instance);
        clock::follow(&arguments.directory(), &prefix)
            .map_err(|error| failed(format!("the run's clock: {error}")))?;
        let name =
            NodeName::new(&arguments.process).map_err(|error| failed(format!("{error:?}")))?;
        let node = NodeBuilder::new()
            .name(&name)
            .config(&config)
            // Signals are ours; see `signal`.
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Ipc>()
            .map_err(|error| failed(format!("{error:?}")))?;
        instance::close_to_others(&arguments.root, &arguments.instance)?;
        Ok(Rc::new(Self {
            node,
            run_id: arguments.run_id,
            start_ns: Cell::new(0),
            wake_ns: Cell::new(now_ns()),
            banked_ns: Cell::new(0),
            ports: RefCell::new(Vec::new()),
            counters: RefCell::new(Vec::new()),
            turn: Turn::new(arguments.standby),
        }))
    }

    /// What this step computed until `now`, without waiting.
    pub(crate) fn computed_ns(&self, now: u64) -> u64 {
        self.banked_ns.get() + now.saturating_sub(self.wake_ns.get())
    }

    pub(crate) fn fall_asleep(&self) {
        self.banked_ns.set(self.computed_ns(now_ns()));
    }

    pub(crate) fn wake_up(&self) {
        self.wake_ns.set(now_ns());
    }

    pub(crate) fn begin_step(&self, now: u64) {
        self.banked_ns.set(0);
        self.wake_ns.set(now);
    }

    /// Sends what was held back and is now this process's to say.
    pub(crate) fn release(&self) {
        for port in self.ports.borrow().iter() {
            if let Some(port) = port.upgrade() {
                port.release();
            }
        }
    }

    /// Connects the ports to those that others made since.
    pub(crate) fn connect(&self) {
        for port in self.ports.borrow().iter() {
            if let Some(port) = port.upgrade() {
                port.connect();
            }
        }
    }
}
