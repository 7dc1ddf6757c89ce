//! Publish-subscribe ports for any message, on iceoryx2's untyped interface.
//!
//! iceoryx2's ports are generic, and each message's would be compiled once more in every crate that opens them: most of
//! the time that this workspace took to build. Its other languages' bindings describe the type at run time instead
//! (`CustomPayloadMarker`); so do we. On the wire nothing differs: services carry the same type name, size, alignment
//! and attribute as with typed ports, and either opens the other's.

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::service::builder::publish_subscribe::Builder;
use iceoryx2::service::marker::{CustomHeaderMarker, CustomPayloadMarker};
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use iceoryx2::service::static_config::message_type_details::{TypeDetail, TypeVariant};
use messages::Message;

/// iceoryx2 over shared memory.
pub(crate) type Ipc = ipc::Service;

type Bytes = [CustomPayloadMarker];

/// What iceoryx2 has to know of a message's type.
#[derive(Clone, Copy)]
pub(crate) struct PayloadType(TypeDetail);

impl PayloadType {
    pub(crate) fn of<M: Message>() -> Self {
        Self(TypeDetail::new::<M>(TypeVariant::FixedSize))
    }
}

/// The builder of a topic's service.
pub(crate) fn builder(
    node: &iceoryx2::node::Node<Ipc>,
    name: &ServiceName,
    payload: PayloadType,
) -> Builder<Bytes, CustomHeaderMarker, Ipc> {
    let builder = node
        .service_builder(name)
        .publish_subscribe::<Bytes>()
        .user_header::<CustomHeaderMarker>();
    // SAFETY: payloads are only read and written by `Loan::message` and `Received::message`, as messages of the
    // described size and alignment; nobody touches user headers, which are described as empty.
    unsafe {
        builder
            .__internal_set_payload_type_details(&payload.0)
            .__internal_set_user_header_type_details(&TypeDetail::new::<()>(TypeVariant::FixedSize))
    }
}

/// A topic's service.
pub(crate) type Topic = PortFactory<Ipc, Bytes, CustomHeaderMarker>;

/// Sends messages of one type.
pub(crate) struct RawPublisher(Publisher<Ipc, Bytes, CustomHeaderMarker>);

impl RawPublisher {
    /// A publisher with memory for `slots` messages, of which so many may be on loan at once.
    pub(crate) fn create(topic: &Topic, loans: usize, slots: usize) -> Result<Self, String> {
        topic
            .publisher_builder()
            .max_loaned_samples(loans)
            .override_sample_preallocation(move |_| slots)
            .create()
            .map(Self)
            .map_err(|error| format!("{error:?}"))
    }

    /// Memory for a message. It holds an older one, or zeros.
    pub(crate) fn loan(&self) -> Result<RawLoan, String> {
        // SAFETY: one element of a type of fixed size. iceoryx2 zeroes a segment when it makes it, and only messages
        // are written to it later, so that every byte is initialised.
        unsafe {
            self.0
                .loan_custom_payload(1)
                .map(|sample| RawLoan(sample.assume_init()))
                .map_err(|error| format!("{error:?}"))
        }
    }

    pub(crate) fn update_connections(&self) {
        // What fails here fails again, and is reported, at the next send.
        let _ = self.0.update_connections();
    }
}

/// A message that is being written.
pub(crate) struct RawLoan(SampleMut<Ipc, Bytes, CustomHeaderMarker>);

impl RawLoan {
    pub(crate) fn message<M: Message>(&self) -> &M {
        let bytes = self.0.payload();
        // SAFETY: the pointer is to initialised bytes of the message's size and alignment, and messages are plain
        // numbers, for which every bit pattern is a value.
        unsafe { &*message_at::<M>(bytes.as_ptr().cast_mut().cast(), bytes.len()) }
    }

    pub(crate) fn message_mut<M: Message>(&mut self) -> &mut M {
        let bytes = self.0.payload_mut();
        // SAFETY: as in `message`; the exclusive borrow of the loan makes the reference exclusive.
        unsafe { &mut *message_at::<M>(bytes.as_mut_ptr().cast(), bytes.len()) }
    }

    /// Sets every byte to zero, which is `M::ZERO` for every message.
    pub(crate) fn clear(&mut self) {
        let bytes = self.0.payload_mut();
        // SAFETY: the bytes are this loan's own, and zero is a value of a byte.
        unsafe { core::ptr::write_bytes(bytes.as_mut_ptr(), 0, bytes.len()) };
    }

    pub(crate) fn send(self) -> Result<(), String> {
        match self.0.send() {
            Ok(_) => Ok(()),
            Err(error) => Err(format!("{error:?}")),
        }
    }
}

/// Receives messages of one type.
pub(crate) struct RawSubscriber(Subscriber<Ipc, Bytes, CustomHeaderMarker>);

impl RawSubscriber {
    /// A subscriber that holds so many messages before the oldest is lost.
    pub(crate) fn create(topic: &Topic, buffer: usize) -> Result<Self, String> {
        topic
            .subscriber_builder()
            .buffer_size(buffer)
            .create()
            .map(Self)
            .map_err(|error| format!("{error:?}"))
    }

    /// The next message, if one waits.
    pub(crate) fn receive(&self) -> Result<Option<Received>, String> {
        match self.0.receive() {
            Ok(sample) => Ok(sample.map(Received)),
            Err(error) => Err(format!("{error:?}")),
        }
    }

    pub(crate) fn has_messages(&self) -> Result<bool, String> {
        self.0.has_samples().map_err(|error| format!("{error:?}"))
    }

    pub(crate) fn update_connections(&self) {
        // What fails here fails again, and is reported, at the next receive.
        let _ = self.0.update_connections();
    }
}

/// A message that was received, held until dropped.
pub(crate) struct Received(Sample<Ipc, Bytes, CustomHeaderMarker>);

impl Received {
    pub(crate) fn message<M: Message>(&self) -> &M {
        let bytes = self.0.payload();
        // SAFETY: as in `RawLoan::message`; a sender no longer writes to what it has sent.
        unsafe { &*message_at::<M>(bytes.as_ptr().cast_mut().cast(), bytes.len()) }
    }

    /// Who sent it.
    pub(crate) fn sender(&self) -> u128 {
        self.0.header().publisher_id().value()
    }
}

/// The message in `length` bytes from `bytes` on.
fn message_at<M: Message>(bytes: *mut u8, length: usize) -> *mut M {
    assert_eq!(length, size_of::<M>(), "size of {}", M::TYPE_NAME);
    let message = bytes.cast::<M>();
    assert!(message.is_aligned(), "alignment of {}", M::TYPE_NAME);
    message
}
