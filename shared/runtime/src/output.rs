//! The sending side of a topic: loan, write in place, send.

use crate::alloc_count::in_transport;
use crate::clock::now_ns;
use crate::error::PortError;
use crate::service::{Ipc, Sizes, open_bell, open_topic};
use crate::shared::Shared;
use core::cell::Cell;
use core::mem::MaybeUninit;
use core::ops::{Deref, DerefMut};
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::EventId;
use iceoryx2::sample_mut::SampleMut;
use messages::{Header, Message};
use std::rc::Rc;

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

/// Something that a node keeps connected while it waits.
pub(crate) trait Connect {
    fn connect(&self);
}

struct Core<M: Message> {
    publisher: Publisher<Ipc, M, ()>,
    notifier: Notifier<Ipc>,
}

impl<M: Message> Connect for Core<M> {
    fn connect(&self) {
        // What fails here fails again, and is reported, at the next send.
        let _ = self.publisher.update_connections();
        let _ = self.notifier.update_connections();
    }
}

/// The sending side of a topic. It stamps headers, counts what it sent and wakes those who wait.
pub struct Output<M: Message> {
    topic: &'static str,
    core: Rc<Core<M>>,
    shared: Rc<Shared>,
    sequence: Cell<u64>,
}

impl<M: Message> Output<M> {
    pub(crate) fn new(shared: &Rc<Shared>, topic: &'static str) -> Result<Self, PortError> {
        let create = |reason: String| PortError::Create {
            topic: topic.to_owned(),
            reason,
        };
        let slots = Sizes::of::<M>(topic).slots;
        let publisher = open_topic::<M>(&shared.node, topic)?
            .publisher_builder()
            .max_loaned_samples(4)
            // A service's arithmetic would reserve the recorder's buffer for everybody; see `Sizes`.
            .override_sample_preallocation(move |_| slots)
            .create()
            .map_err(|error| create(format!("{error:?}")))?;
        let notifier = open_bell(&shared.node, topic)?
            .notifier_builder()
            .default_event_id(EventId::new(0))
            .create()
            .map_err(|error| create(format!("{error:?}")))?;
        let core = Rc::new(Core {
            publisher,
            notifier,
        });
        let weak: std::rc::Weak<dyn Connect> = Rc::downgrade(&(core.clone() as Rc<dyn Connect>));
        shared.ports.borrow_mut().push(weak);
        Ok(Self {
            topic,
            core,
            shared: shared.clone(),
            sequence: Cell::new(0),
        })
    }

    /// The topic.
    pub fn topic(&self) -> &'static str {
        self.topic
    }

    /// Messages sent so far.
    pub fn sent(&self) -> u64 {
        self.sequence.get()
    }

    /// A message in shared memory, all zeros, to be written in place and sent.
    ///
    /// # Errors
    /// [`PortError::Loan`] when stalled receivers hold all memory.
    pub fn loan(&self) -> Result<Loan<'_, M>, PortError> {
        let mut loan = self.loan_uncleared()?;
        // SAFETY: messages are plain numbers, for which all zeros is a value (it is `M::ZERO`).
        unsafe { core::ptr::write_bytes(&raw mut *loan, 0, 1) };
        Ok(loan)
    }

    /// A message in shared memory that still holds an older message's numbers, for large ones that are overwritten
    /// anyway ([`messages::ImagineRequest`] takes 480 kB).
    ///
    /// # Errors
    /// [`PortError::Loan`] when stalled receivers hold all memory.
    pub fn loan_uncleared(&self) -> Result<Loan<'_, M>, PortError> {
        let sample = in_transport(|| self.core.publisher.loan_uninit()).map_err(|error| {
            PortError::Loan {
                topic: self.topic,
                reason: format!("{error:?}"),
            }
        })?;
        let sample: iceoryx2::sample_mut_uninit::SampleMutUninit<Ipc, MaybeUninit<M>, ()> = sample;
        // SAFETY: iceoryx2 zeroes a segment when it makes it, and only messages are written to it later; for plain
        // numbers every bit pattern is a value.
        let sample = unsafe { sample.assume_init() };
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
        let sequence = self.sequence.get();
        self.sequence.set(sequence + 1);
        if let Some(header) = message.header_mut() {
            let now = now_ns();
            *header = Header {
                run_id: self.shared.run_id,
                sequence,
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
    sample: SampleMut<Ipc, M, ()>,
}

impl<M: Message> Loan<'_, M> {
    /// Stamps the header, sends the message and wakes those who wait for it.
    ///
    /// # Errors
    /// [`PortError::Send`].
    pub fn send(mut self, stamp: Stamp) -> Result<(), PortError> {
        let output = self.output;
        output.stamp(self.sample.payload_mut(), stamp);
        let failed = |reason: String| PortError::Send {
            topic: output.topic,
            reason,
        };
        self.sample
            .send()
            .map_err(|error| failed(format!("{error:?}")))?;
        output
            .core
            .notifier
            .notify()
            .map_err(|error| failed(format!("{error:?}")))?;
        Ok(())
    }
}

impl<M: Message> Deref for Loan<'_, M> {
    type Target = M;
    fn deref(&self) -> &M {
        self.sample.payload()
    }
}

impl<M: Message> DerefMut for Loan<'_, M> {
    fn deref_mut(&mut self) -> &mut M {
        self.sample.payload_mut()
    }
}
