//! The receiving side of a topic: the newest message or every message, with losses counted.

use crate::arguments::ClockMode;
use crate::error::PortError;
use crate::service::{DEFAULT_BUFFER, TopicSizes, open_topic, open_wake_event};
use crate::shared::{Connect, Counter, SharedNode};
use crate::transport::Ipc;
use crate::transport::{RawSubscriber, Received};
use core::cell::Cell;
use core::marker::PhantomData;
use iceoryx2::port::listener::Listener;
use iceoryx2::prelude::FileDescriptorBased;
use messages::{Header, Message};
use std::os::fd::RawFd;
use std::rc::Rc;

/// What an input delivers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Receive {
    /// The newest message; older ones that wait are passed over (they count as received).
    Newest,
    /// Every message, in order. What lockstep needs.
    InOrder,
}

impl Receive {
    /// What a process needs of a topic that it follows: in lockstep every step's message, in real time the newest.
    pub fn in_clock(clock: ClockMode) -> Self {
        match clock {
            ClockMode::Lockstep => Self::InOrder,
            ClockMode::RealTime => Self::Newest,
        }
    }
}

/// How an input receives.
#[derive(Clone, Copy, Debug)]
pub struct InputOptions {
    /// What it delivers.
    pub receive: Receive,
    /// Messages it holds before the oldest is lost, at most [`RECORDER_BUFFER`](crate::RECORDER_BUFFER).
    pub buffer: usize,
    /// Whether a message wakes the process. Off for a recorder that looks every few milliseconds: then nobody pays for
    /// waking it.
    pub wakes: bool,
}

impl InputOptions {
    /// A usual input: [`DEFAULT_BUFFER`] messages, waking.
    pub fn new(receive: Receive) -> Self {
        Self {
            receive,
            buffer: DEFAULT_BUFFER,
            wakes: true,
        }
    }

    /// A recorder's input: every message, a large buffer, not waking.
    pub fn recorder() -> Self {
        Self {
            receive: Receive::InOrder,
            buffer: crate::service::RECORDER_BUFFER,
            wakes: false,
        }
    }
}

/// Who sent on this topic, and the sequence number expected next.
#[derive(Clone, Copy)]
struct Sender {
    id: u128,
    next: u64,
}

/// Where [`Source::advance_to`] arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Advance {
    /// The message has not come yet.
    Waiting,
    /// It is the current one; or, at an input that delivers the newest, a later one is.
    There,
    /// An in-order input has a later one instead: the awaited one was lost, or never sent.
    Passed,
}

/// Something that a process can wait for; every [`Input`] is one.
pub trait Source {
    /// The topic.
    fn topic(&self) -> &'static str;
    /// Whether a message waits that was not taken yet.
    ///
    /// # Errors
    /// [`PortError::Receive`].
    fn pending(&mut self) -> Result<bool, PortError>;
    /// Takes messages until one of `episode` and `step`, or a later one, is the current one.
    ///
    /// # Errors
    /// [`PortError::Receive`].
    fn advance_to(&mut self, episode: u32, step: u32) -> Result<Advance, PortError>;
    /// What to poll; −1 for an input that does not wake.
    fn descriptor(&self) -> RawFd;
    /// Has the next [`Source::drain`] empty the listener: its descriptor is readable, or may be in need of it.
    fn mark_notified(&mut self);
    /// Empties the listener, so that its descriptor is readable only for what comes later, and returns how many
    /// notifications it held. None, and nothing happens, where no message was taken since that was last done, and
    /// nothing marked it.
    fn drain(&mut self) -> Option<u64>;
}

impl Connect for RawSubscriber {
    fn release(&self) {}

    fn connect(&self) {
        self.update_connections();
    }
}

/// The receiving side of a topic. Holds its current message until the next is taken.
pub struct Input<M: Message> {
    topic: &'static str,
    receive: Receive,
    once: bool,
    current: Option<Received>,
    subscriber: Rc<RawSubscriber>,
    listener: Option<Listener<Ipc>>,
    counter: Rc<Counter>,
    /// Whether the listener is to be emptied before the process next sleeps.
    is_notified: bool,
    senders: Vec<Sender>,
    shared: Rc<SharedNode>,
    created_ns: u64,
    message: PhantomData<M>,
}

impl<M: Message> Input<M> {
    pub(crate) fn new(
        shared: &Rc<SharedNode>,
        topic: &'static str,
        options: InputOptions,
    ) -> Result<Self, PortError> {
        let create = |reason: String| PortError::Create {
            topic: topic.to_owned(),
            reason,
        };
        let sizes = TopicSizes::of::<M>(topic);
        let listener = if options.wakes {
            let listener = open_wake_event(&shared.node, topic)?
                .listener_builder()
                .create()
                .map_err(|error| create(format!("{error:?}")))?;
            Some(listener)
        } else {
            None
        };
        let service = open_topic::<M>(&shared.node, topic)?;
        let buffer = options.buffer.clamp(sizes.history.max(1), sizes.buffer);
        let subscriber = Rc::new(RawSubscriber::create(&service, buffer).map_err(create)?);
        let weak: std::rc::Weak<dyn Connect> =
            Rc::downgrade(&(subscriber.clone() as Rc<dyn Connect>));
        shared.ports.borrow_mut().push(weak);
        let counter = Rc::new(Counter {
            topic,
            received: Cell::new(0),
            lost: Cell::new(0),
        });
        shared.counters.borrow_mut().push(counter.clone());
        Ok(Self {
            topic,
            receive: options.receive,
            once: false,
            current: None,
            subscriber,
            listener,
            counter,
            is_notified: true,
            senders: Vec::with_capacity(64),
            shared: shared.clone(),
            created_ns: crate::clock::now_ns(),
            message: PhantomData,
        })
    }

    /// The same input, its losses counted in no report: for one that is not read from step to step.
    #[must_use]
    pub fn uncounted(self) -> Self {
        let mut counters = self.shared.counters.borrow_mut();
        counters.retain(|counter| !std::rc::Rc::ptr_eq(counter, &self.counter));
        drop(counters);
        self
    }

    /// The same input, which in lockstep hears of every step once: what is not later than the message taken last
    /// repeats it, as the successor of a dead process does with its last words, and is passed over. In real time a
    /// second message about a step says something new, such as a display that shows a late decision, and is heard.
    #[must_use]
    pub fn once_in(mut self, clock: ClockMode) -> Self {
        self.once = clock == ClockMode::Lockstep;
        self
    }

    /// The message taken last.
    pub fn message(&self) -> Option<&M> {
        self.current.as_ref().map(Received::message)
    }

    /// The header of the message taken last.
    pub fn header(&self) -> Option<&Header> {
        self.message().and_then(Message::header)
    }

    /// Takes a message: the newest that waits, or the next in order. False, and nothing changes, if none waits.
    ///
    /// # Errors
    /// [`PortError::Receive`].
    pub fn take(&mut self) -> Result<bool, PortError> {
        let mut taken = false;
        while let Some(sample) = self.receive()? {
            let header = sample.message::<M>().header();
            let position = header.map(|header| (header.episode, header.step));
            if self.once && position.is_some() && position <= self.position() {
                continue;
            }
            self.current = Some(sample);
            taken = true;
            if self.receive == Receive::InOrder {
                break;
            }
        }
        Ok(taken)
    }

    /// Takes a message as [`Input::take`] does, and returns it.
    ///
    /// # Errors
    /// [`PortError::Receive`].
    #[allow(clippy::should_implement_trait)] // it lends the message, which an iterator cannot
    pub fn next(&mut self) -> Result<Option<&M>, PortError> {
        Ok(if self.take()? { self.message() } else { None })
    }

    /// Messages received, passed-over ones included.
    pub fn received(&self) -> u64 {
        self.counter.received.get()
    }

    /// Messages lost: gaps in their senders' sequence numbers.
    pub fn lost(&self) -> u64 {
        self.counter.lost.get()
    }

    fn receive(&mut self) -> Result<Option<Received>, PortError> {
        let received = self.subscriber.receive();
        let sample = received.map_err(|reason| PortError::Receive {
            topic: self.topic,
            reason,
        })?;
        if let Some(sample) = &sample {
            self.is_notified = true;
            self.counter.received.set(self.counter.received.get() + 1);
            if let Some(header) = sample.message::<M>().header() {
                self.count_gap(sample.sender(), header.sequence);
            }
        }
        Ok(sample)
    }

    fn count_gap(&mut self, id: u128, sequence: u64) {
        let lost = match self.senders.iter_mut().find(|sender| sender.id == id) {
            Some(sender) => {
                let lost = sequence.saturating_sub(sender.next);
                sender.next = sequence + 1;
                lost
            }
            None => {
                if self.senders.len() == self.senders.capacity() {
                    self.senders.remove(0);
                }
                self.senders.push(Sender {
                    id,
                    next: sequence + 1,
                });
                // Who was there before the run started should have seen everything; a latecomer starts in the middle.
                let start = self.shared.start_ns.get();
                if start != 0 && self.created_ns < start {
                    sequence
                } else {
                    0
                }
            }
        };
        self.counter.lost.set(self.counter.lost.get() + lost);
    }

    fn position(&self) -> Option<(u32, u32)> {
        self.header().map(|header| (header.episode, header.step))
    }
}

impl<M: Message> Source for Input<M> {
    fn topic(&self) -> &'static str {
        self.topic
    }

    fn pending(&mut self) -> Result<bool, PortError> {
        let waits = self.subscriber.has_messages();
        waits.map_err(|reason| PortError::Receive {
            topic: self.topic,
            reason,
        })
    }

    fn advance_to(&mut self, episode: u32, step: u32) -> Result<Advance, PortError> {
        let wanted = (episode, step);
        loop {
            match self.position() {
                Some(position) if position == wanted => return Ok(Advance::There),
                Some(position) if position > wanted => {
                    return Ok(match self.receive {
                        Receive::Newest => Advance::There,
                        Receive::InOrder => Advance::Passed,
                    });
                }
                _ => {}
            }
            if !self.take()? {
                return Ok(Advance::Waiting);
            }
        }
    }

    fn descriptor(&self) -> RawFd {
        match &self.listener {
            // SAFETY: the descriptor is only polled, and lives as long as the listener.
            Some(listener) => unsafe { listener.file_descriptor().native_handle() },
            None => -1,
        }
    }

    fn mark_notified(&mut self) {
        self.is_notified = true;
    }

    fn drain(&mut self) -> Option<u64> {
        let listener = self.listener.as_ref().filter(|_| self.is_notified)?;
        // What fails, as by an interrupt, is tried again before the next sleep.
        let notifications = listener.try_wait(|_| {}).ok()?;
        self.is_notified = false;
        Some(notifications)
    }
}
