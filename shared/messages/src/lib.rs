//! The fixed-layout messages that MIRROR's processes exchange, and the topics they travel on.
//!
//! Every message is `#[repr(C)]`, made of plain numbers and fixed arrays, without padding and with
//! every field at its natural alignment (asserted at compile time). Its bytes in shared memory are
//! therefore also its CDR body under the ROS 2 definition that [`Message::definition`] derives from
//! the same declaration; the two cannot drift. Text alone is a `string` to the rest of the world
//! ([`Message::ros_definition`], [`ros_package`]): a recorder writes it so.

mod catalogue;
mod field;
mod gridworld;
mod highway;
mod meaning;
mod message;
mod number;
mod python;
mod ros_package;
mod sensed;
mod step;

pub use catalogue::{Description, all_definitions, for_each_message, for_each_topic};
pub use field::{Field, FieldType};
pub use gridworld::*;
pub use highway::*;
pub(crate) use message::layout_text;
pub use message::{Header, Message, layout_hash};
pub use number::*;
pub use python::python_module;
pub use ros_package::ros_package;
pub use sensed::Sensed;
pub use step::*;

/// The processes of a set in launch order; a process's place is its index in messages as long as none was started
/// again.
pub const PROCESSES: [&str; 7] = [
    "world", "driver", "belief", "human", "planner", "renderer", "recorder",
];
