//! The sending side of a topic: loan, write in place, send.

use crate::alloc_count::in_transport;
use crate::clock::now_ns;
use crate::error::PortError;
use crate::service::{TopicSizes, open_topic, open_wake_event};
use crate::shared::{Connect, SharedNode};
use crate::transport::Ipc;
use crate::transport::{RawLoan, RawPublisher};
use crate::turn::Position;
use core::cell::{Cell, RefCell};
use core::marker::PhantomData;
use core::ops::{Deref, DerefMut};
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::EventId;
use messages::{Header, Message};
use std::collections::VecDeque;
use std::rc::{Rc, Weak};

/// Where in the run a message belongs, and what it goes back to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamp {
    /// Episode, from 0.
    pub episode: u32,
    /// Step k of the episode, from 0.
    pub step: u32,
    /// When the newest thing that the message depends on was sensed by the world.
    pub cause_ns: u64,
}

impl Stamp {
    /// A message about the same step as the one with this header, and with the same cause.
    pub fn of(header: &Header) -> Self {
        Self {
            episode: header.episode,
            step: header.step,
            cause_ns: header.cause_ns,
        }
    }

    /// Where in the run that is.
    pub fn position(&self) -> Position {
        (self.episode, self.step)
    }

    /// A message about the step after this one, such as a decision for k + 1.
    pub fn next(self) -> Self {
        Self {
            step: self.step + 1,
            ..self
        }
    }

    /// Something that is sensed now: for the world.
    pub fn sensed(episode: u32, step: u32) -> Self {
        Self {
            episode,
            step,
            cause_ns: now_ns(),
        }
    }
}

/// Messages that an output holds back: in lockstep, nobody is further ahead of a process that is silent.
const MOST_HELD: usize = 4;

/// A message that is held back, and where in the run it belongs.
type Held = (Stamp, RawLoan);

struct Core<M: Message> {
    topic: &'static str,
    publisher: RawPublisher,
    notifier: Notifier<Ipc>,
    sequence: Cell<u64>,
    /// Whether the process's [`Turn`](crate::turn::Turn) decides what is sent.
    gated: bool,
    /// Written while the process had to be silent.
    held: RefCell<VecDeque<Held>>,
    shared: Weak<SharedNode>,
    message: PhantomData<M>,
}

impl<M: Message> Core<M> {
    /// Sends a message whose header is complete but for its number, and wakes those who wait for it.
    fn send(&self, mut sample: RawLoan) -> Result<(), PortError> {
        let sequence = self.sequence.get();
        self.sequence.set(sequence + 1);
        if let Some(header) = sample.message_mut::<M>().header_mut() {
            header.sequence = sequence;
        }
        let failed = |reason: String| PortError::Send {
            topic: self.topic,
            reason,
        };
        sample.send().map_err(failed)?;
        self.notifier
            .notify()
            .map_err(|error| failed(format!("{error:?}")))?;
        Ok(())
    }

    fn hold(&self, stamp: Stamp, sample: RawLoan) {
        let mut held = self.held.borrow_mut();
        if held.len() == MOST_HELD
            && let Some((oldest, _)) = held.pop_front()
            && let Some(shared) = self.shared.upgrade()
        {
            shared.turn.note_passed(oldest.position());
        }
        held.push_back((stamp, sample));
    }
}

impl<M: Message> Connect for Core<M> {
    fn release(&self) {
        let Some(shared) = self.shared.upgrade() else {
            return;
        };
        let mut held = self.held.borrow_mut();
        for _ in 0..held.len() {
            let Some((stamp, mut sample)) = held.pop_front() else {
                break;
            };
            if shared.turn.is_active(stamp.position()) {
                if let Some(header) = sample.message_mut::<M>().header_mut() {
                    header.sent_ns = now_ns();
                }
                // What fails here fails again, and is reported, at the next send.
                let _ = self.send(sample);
                shared.turn.note_sent(stamp.position());
            } else {
                held.push_back((stamp, sample));
            }
        }
    }

    fn connect(&self) {
        self.publisher.update_connections();
        // What fails here fails again, and is reported, at the next send.
        let _ = self.notifier.update_connections();
    }
}

/// The sending side of a topic. It stamps headers, counts what it sent and wakes those who wait.
pub struct Output<M: Message> {
    topic: &'static str,
    core: Rc<Core<M>>,
    shared: Rc<SharedNode>,
}

impl<M: Message> Output<M> {
    pub(crate) fn new(shared: &Rc<SharedNode>, topic: &'static str) -> Result<Self, PortError> {
        let create = |reason: String| PortError::Create {
            topic: topic.to_owned(),
            reason,
        };
        let TopicSizes { slots, gated, .. } = TopicSizes::of::<M>(topic);
        let service = open_topic::<M>(&shared.node, topic)?;
        // A service's arithmetic would reserve the recorder's buffer for everybody; see `Sizes`.
        let publisher = RawPublisher::create(&service, MOST_HELD + 4, slots).map_err(create)?;
        let notifier = open_wake_event(&shared.node, topic)?
            .notifier_builder()
            .default_event_id(EventId::new(0))
            .create()
            .map_err(|error| create(format!("{error:?}")))?;
        let core = Rc::new(Core {
            topic,
            publisher,
            notifier,
            sequence: Cell::new(0),
            gated,
            held: RefCell::new(VecDeque::with_capacity(MOST_HELD)),
            shared: Rc::downgrade(shared),
            message: PhantomData,
        });
        let weak: Weak<dyn Connect> = Rc::downgrade(&(core.clone() as Rc<dyn Connect>));
        shared.ports.borrow_mut().push(weak);
        Ok(Self {
            topic,
            core,
            shared: shared.clone(),
        })
    }

    /// The topic.
    pub fn topic(&self) -> &'static str {
        self.topic
    }

    /// Messages sent so far.
    pub fn sent(&self) -> u64 {
        self.core.sequence.get()
    }

    /// A message in shared memory, all zeros, to be written in place and sent.
    ///
    /// # Errors
    /// [`PortError::Loan`] when stalled receivers hold all memory.
    pub fn loan(&self) -> Result<Loan<'_, M>, PortError> {
        let mut loan = self.loan_uncleared()?;
        loan.sample.clear();
        Ok(loan)
    }

    /// A message in shared memory that still holds an older message's numbers, for large ones that are overwritten
    /// anyway ([`messages::ImagineRequest`] takes 480 kB).
    ///
    /// # Errors
    /// [`PortError::Loan`] when stalled receivers hold all memory.
    pub fn loan_uncleared(&self) -> Result<Loan<'_, M>, PortError> {
        let loan = in_transport(|| self.core.publisher.loan());
        let sample = loan.map_err(|reason| PortError::Loan {
            topic: self.topic,
            reason,
        })?;
        Ok(Loan {
            output: self,
            sample,
        })
    }

    /// Loans, lets `write` fill in the message (all zeros before), and sends it.
    ///
    /// # Errors
    /// As [`Output::loan`] and [`Loan::send`].
    pub fn send_with(&self, stamp: Stamp, write: impl FnOnce(&mut M)) -> Result<(), PortError> {
        let mut loan = self.loan()?;
        write(&mut loan);
        loan.send(stamp)
    }

    fn stamp(&self, message: &mut M, stamp: Stamp) {
        if let Some(header) = message.header_mut() {
            let now = now_ns();
            *header = Header {
                run_id: self.shared.run_id,
                sequence: 0,
                sent_ns: now,
                cause_ns: stamp.cause_ns,
                compute_ns: self.shared.computed_ns(now),
                episode: stamp.episode,
                step: stamp.step,
            };
        }
    }
}

/// A message that is being written in shared memory. Dropped, it is never sent and leaves no gap.
pub struct Loan<'output, M: Message> {
    output: &'output Output<M>,
    sample: RawLoan,
}

impl<M: Message> Loan<'_, M> {
    /// Stamps the header, sends the message and wakes those who wait for it. A process that is on standby, or has
    /// handed over, holds it back instead: see [`Node::is_active`](crate::Node::is_active).
    ///
    /// # Errors
    /// [`PortError::Send`].
    pub fn send(mut self, stamp: Stamp) -> Result<(), PortError> {
        let output = self.output;
        output.stamp(self.sample.message_mut(), stamp);
        if output.core.gated {
            let turn = &output.shared.turn;
            if !turn.is_active(stamp.position()) {
                output.core.hold(stamp, self.sample);
                return Ok(());
            }
            turn.note_sent(stamp.position());
        }
        output.core.send(self.sample)
    }
}

impl<M: Message> Deref for Loan<'_, M> {
    type Target = M;
    fn deref(&self) -> &M {
        self.sample.message()
    }
}

impl<M: Message> DerefMut for Loan<'_, M> {
    fn deref_mut(&mut self) -> &mut M {
        self.sample.message_mut()
    }
}
