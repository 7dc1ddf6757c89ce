//! What all messages have in common: the header, the trait, and the macro that declares them.

use crate::field::{Field, Text, write_definition};
use iceoryx2::prelude::ZeroCopySend;

/// A message that may cross a process border by shared memory.
pub trait Message: ZeroCopySend + Copy + core::fmt::Debug + Send + Sync + 'static {
    /// Name and version, such as `mirror/LidarFrame/1`: iceoryx2's type name for this message.
    const TYPE_NAME: &'static str;
    /// The ROS 2 type, such as `mirror_msgs/LidarFrame`.
    const ROS_TYPE: &'static str;
    /// What it is, as its documentation says.
    const DOC: &'static str = "";
    /// All zeros.
    const ZERO: Self;

    /// The fields in the order in which they lie in memory.
    fn fields() -> &'static [Field];

    /// The header, where the message has one.
    fn header(&self) -> Option<&Header>;

    /// The header, to be stamped by the port that sends the message.
    fn header_mut(&mut self) -> Option<&mut Header>;

    /// The message as it lies in memory, which is also its CDR body under [`Self::definition`].
    fn bytes(&self) -> &[u8] {
        // SAFETY: messages are `repr(C)` and have no padding (asserted by `message!`), so all bytes are initialised.
        unsafe {
            core::slice::from_raw_parts((self as *const Self).cast::<u8>(), size_of::<Self>())
        }
    }

    /// The ROS 2 definition (`ros2msg`) of the message's memory and everything nested in it: text is bytes.
    fn definition() -> String {
        let mut out = String::new();
        write_definition(Self::fields(), Text::Bytes, &mut out);
        out
    }

    /// The ROS 2 definition (`ros2msg`) of the message as a recording has it, for people and their tools: text is a
    /// `string`.
    fn ros_definition() -> String {
        let mut out = String::new();
        write_definition(Self::fields(), Text::String, &mut out);
        out
    }

    /// A number that changes when any field's name, type, order or size does. It travels as an attribute of the
    /// service, because iceoryx2 would accept a type of the same name and size with its fields swapped.
    fn layout() -> u64 {
        layout_hash(&format!("{}\n{}", Self::TYPE_NAME, Self::definition()))
    }

    /// Type name and layout, as the attribute of a topic's service carries them.
    fn layout_text() -> String {
        layout_text(Self::TYPE_NAME, Self::layout())
    }
}

/// A type name and its layout in one line.
pub(crate) fn layout_text(type_name: &str, layout: u64) -> String {
    format!("{type_name} layout {layout:016x}")
}

/// FNV-1a over a layout's description: stable over compilers, machines and languages.
pub fn layout_hash(description: &str) -> u64 {
    description
        .bytes()
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
        })
}

/// Declares a message: the `repr(C)` structure, its [`Message`] and [`FieldType`](crate::FieldType) implementations,
/// and the compile-time assertions that it has no padding and that every field is aligned as CDR wants it. A field
/// declared `as text` holds zero-padded UTF-8.
macro_rules! message {
    ($(#[doc = $doc:literal])* pub struct $name:ident, $version:literal {
        $($(#[doc = $field_doc:literal])* pub $field:ident: $type:ty $(as $text:ident)?,)*
    } header: $header:tt) => {
        $(#[doc = $doc])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[repr(C)]
        pub struct $name {
            $($(#[doc = $field_doc])* pub $field: $type,)*
        }

        // SAFETY: `repr(C)`, plain numbers and arrays only (every field is a `FieldType`), no pointers; the name
        // carries the version, and the layout hash tells apart what the name does not.
        unsafe impl iceoryx2::prelude::ZeroCopySend for $name {
            unsafe fn type_name() -> &'static str {
                concat!("mirror/", stringify!($name), "/", $version)
            }
        }

        impl $crate::Message for $name {
            const TYPE_NAME: &'static str = concat!("mirror/", stringify!($name), "/", $version);
            const ROS_TYPE: &'static str = concat!("mirror_msgs/", stringify!($name));
            const DOC: &'static str = concat!($($doc, "\n"),*);
            const ZERO: Self = Self { $($field: <$type as $crate::FieldType>::ZERO,)* };

            fn fields() -> &'static [$crate::Field] {
                const FIELDS: &[$crate::Field] = &[$($crate::Field {
                    name: stringify!($field),
                    offset: core::mem::offset_of!($name, $field),
                    element: <$type as $crate::FieldType>::ROS,
                    count: <$type as $crate::FieldType>::COUNT,
                    nested: <$type as $crate::FieldType>::NESTED,
                    size: size_of::<$type>(),
                    align: align_of::<$type>(),
                    is_text: message!(@text $($text)?),
                    doc: concat!($($field_doc, "\n"),*),
                },)*];
                FIELDS
            }

            message!(@header $header);
        }

        impl $crate::FieldType for $name {
            const ROS: &'static str = <$name as $crate::Message>::ROS_TYPE;
            const NESTED: Option<fn() -> &'static [$crate::Field]> = Some(<$name as $crate::Message>::fields);
            const ZERO: Self = <$name as $crate::Message>::ZERO;
        }

        impl Default for $name {
            fn default() -> Self {
                <$name as $crate::Message>::ZERO
            }
        }

        const _: () = assert!(
            size_of::<$name>() == 0 $(+ size_of::<$type>())*,
            concat!(stringify!($name), " has padding"),
        );
    };
    (@text) => { false };
    (@text text) => { true };
    (@header yes) => {
        fn header(&self) -> Option<&$crate::Header> { Some(&self.header) }
        fn header_mut(&mut self) -> Option<&mut $crate::Header> { Some(&mut self.header) }
    };
    (@header no) => {
        fn header(&self) -> Option<&$crate::Header> { None }
        fn header_mut(&mut self) -> Option<&mut $crate::Header> { None }
    };
}
pub(crate) use message;

message! {
    /// The start of every message. Times are nanoseconds of the system's monotonic clock, the same in all processes.
    pub struct Header, "1" {
        /// The run that the message belongs to.
        pub run_id: u64,
        /// Counts the messages that this sender put on this topic, from 0. A gap is a loss.
        pub sequence: u64,
        /// When the message was sent.
        pub sent_ns: u64,
        /// When the newest thing that the message depends on was sensed by the world.
        pub cause_ns: u64,
        /// How long the sender computed for this message, without waiting.
        pub compute_ns: u64,
        /// Episode, from 0.
        pub episode: u32,
        /// Step k of the episode, from 0.
        pub step: u32,
    } header: no
}
