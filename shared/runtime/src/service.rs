//! Opening iceoryx2 services: sizes, and the layout attribute that keeps out processes of another version.

use crate::error::PortError;
use crate::transport::{self, Ipc, PayloadType, Topic};
use iceoryx2::prelude::*;
use iceoryx2::service::ServiceDetails;
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenError;
use iceoryx2::service::port_factory::event;
use messages::Message;
use std::time::{Duration, Instant};

pub(crate) type WakeEvent = event::PortFactory<Ipc>;

/// Messages that an input holds before the oldest is lost, unless it asks otherwise.
pub const DEFAULT_BUFFER: usize = 64;
/// Messages that the recorder's inputs hold: half a second of the fastest lockstep run.
pub const RECORDER_BUFFER: usize = 1024;
/// Messages of the launcher and the processes to each other that a recorder's inputs hold: about ten seconds of
/// reports.
const RUN_BUFFER: usize = 3 * DEFAULT_BUFFER;
/// Messages that somebody who joins late still gets: what a process that starts again after a death needs for the step
/// at which the others wait for it, and the steps before it to catch up on.
pub const HISTORY: usize = 8;
/// From this size on a message is a bulk transfer between two processes (imagination) rather than state.
const BULK_BYTES: usize = 64 << 10;

/// Name of the attribute that carries a message's type and layout.
const LAYOUT_KEY: &str = "mirror.layout";

/// The sizes of a topic's service: the same in every process, because they follow from topic and message alone.
#[derive(Clone, Copy)]
pub(crate) struct TopicSizes {
    /// Largest buffer that an input may have.
    pub(crate) buffer: usize,
    pub(crate) subscribers: usize,
    pub(crate) publishers: usize,
    pub(crate) borrowed: usize,
    pub(crate) history: usize,
    /// Messages that a publisher's shared memory has room for.
    pub(crate) slots: usize,
    /// Whether a process that is on standby holds back what it would send here.
    pub(crate) gated: bool,
}

impl TopicSizes {
    pub(crate) fn of<M: Message>(topic: &str) -> Self {
        Self::of_size(size_of::<M>(), topic)
    }

    fn of_size(message: usize, topic: &str) -> Self {
        if message >= BULK_BYTES {
            // The human model, one that takes over from it, and somebody who only watches.
            Self {
                buffer: 4,
                subscribers: 5,
                publishers: 4,
                borrowed: 2,
                history: 0,
                slots: 36,
                gated: false,
            }
        } else if topic.starts_with("run/") {
            Self {
                buffer: RUN_BUFFER,
                subscribers: 24,
                publishers: 24,
                borrowed: 4,
                history: 1,
                slots: 512,
                gated: false,
            }
        } else {
            // One recorder and eight others may each have stalled with another set of messages in hand.
            let (buffer, borrowed) = (RECORDER_BUFFER, 4);
            let slots = RECORDER_BUFFER + 8 * (DEFAULT_BUFFER + borrowed) + HISTORY + 16;
            Self {
                buffer,
                subscribers: 16,
                publishers: 4,
                borrowed,
                history: HISTORY,
                slots,
                gated: true,
            }
        }
    }
}

fn name(topic: &str) -> Result<ServiceName, PortError> {
    ServiceName::new(topic).map_err(|reason| open_error(topic, reason))
}

fn open_error(topic: &str, reason: impl core::fmt::Debug) -> PortError {
    PortError::Open {
        topic: topic.to_owned(),
        reason: format!("{reason:?}"),
    }
}

/// Whether trying again can help: somebody else is just creating or removing the service.
fn passes<T: core::fmt::Debug>(error: &T) -> bool {
    let name = format!("{error:?}");
    [
        "SystemInFlux",
        "IsMarkedForDestruction",
        "IsBeingCreatedByAnotherInstance",
        "AlreadyExists",
        "HangsInCreation",
        "DoesNotExist",
    ]
    .iter()
    .any(|passing| name.contains(passing))
}

fn patiently<T, E: core::fmt::Debug>(mut open: impl FnMut() -> Result<T, E>) -> Result<T, E> {
    let end = Instant::now() + Duration::from_secs(2);
    loop {
        match open() {
            Err(error) if passes(&error) && Instant::now() < end => {
                std::thread::sleep(Duration::from_millis(2))
            }
            done => return done,
        }
    }
}

/// Opens or creates the publish-subscribe service of a topic.
pub(crate) fn open_topic<M: Message>(
    node: &iceoryx2::node::Node<Ipc>,
    topic: &str,
) -> Result<Topic, PortError> {
    open(
        node,
        topic,
        TopicSizes::of::<M>(topic),
        PayloadType::of::<M>(),
        M::layout_text(),
    )
}

fn open(
    node: &iceoryx2::node::Node<Ipc>,
    topic: &str,
    sizes: TopicSizes,
    payload: PayloadType,
    layout: String,
) -> Result<Topic, PortError> {
    let service_name = name(topic)?;
    let key = LAYOUT_KEY
        .try_into()
        .map_err(|error| open_error(topic, error))?;
    let value = layout
        .as_str()
        .try_into()
        .map_err(|error| open_error(topic, error))?;
    let verifier = AttributeVerifier::new()
        .require(&key, &value)
        .map_err(|error| open_error(topic, error))?;
    patiently(|| {
        transport::builder(node, &service_name, payload)
            .max_publishers(sizes.publishers)
            .max_subscribers(sizes.subscribers)
            .max_nodes(40)
            .subscriber_max_buffer_size(sizes.buffer)
            .subscriber_max_borrowed_samples(sizes.borrowed)
            .history_size(sizes.history)
            .enable_safe_overflow(true)
            .open_or_create_with_attributes(&verifier)
    })
    .map_err(|error| {
        use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenOrCreateError as Failure;
        match error {
            Failure::PublishSubscribeOpenError(
                PublishSubscribeOpenError::IncompatibleTypes | PublishSubscribeOpenError::IncompatibleAttributes,
            ) => PortError::Layout {
                topic: topic.to_owned(),
                ours: layout,
                theirs: layout_in_use(node, topic).unwrap_or_else(|| "an unknown layout".to_owned()),
            },
            other => open_error(topic, other),
        }
    })
}

/// What the existing service of a topic says about its message.
fn layout_in_use(node: &iceoryx2::node::Node<Ipc>, topic: &str) -> Option<String> {
    let details: ServiceDetails<Ipc> = Ipc::details(
        &ServiceName::new(topic).ok()?,
        node.config(),
        MessagingPattern::PublishSubscribe,
    )
    .ok()??;
    let key = LAYOUT_KEY.try_into().ok()?;
    match details.static_details.attributes().key_value(&key, 0) {
        Some(layout) => Some(layout.to_string()),
        None => Some(format!(
            "{} without a layout",
            details
                .static_details
                .publish_subscribe()
                .message_type_details()
                .payload
                .type_name()
        )),
    }
}

/// Opens or creates the event service of a topic, which wakes those who wait for its messages.
pub(crate) fn open_wake_event(
    node: &iceoryx2::node::Node<Ipc>,
    topic: &str,
) -> Result<WakeEvent, PortError> {
    let service_name = name(topic)?;
    patiently(|| {
        node.service_builder(&service_name)
            .event()
            .max_notifiers(32)
            .max_listeners(32)
            .max_nodes(40)
            .event_id_max_value(1)
            .open_or_create()
    })
    .map_err(|error| open_error(topic, error))
}
