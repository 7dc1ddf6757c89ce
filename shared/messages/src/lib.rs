//! The fixed-layout messages that MIRROR's processes exchange, and the topics they travel on.
//!
//! Every message is `#[repr(C)]`, made of plain numbers and fixed arrays, without padding and with
//! every field at its natural alignment (asserted at compile time). Its bytes in shared memory are
//! therefore also its CDR body, so a recorder can write them as they are with the ROS 2 definition
//! that [`Message::definition`] derives from the same declaration; the two cannot drift.

mod catalogue;
mod field;
mod gridworld;
mod highway;
mod message;
mod python;
mod sensed;
mod step;

pub use catalogue::{Description, all_definitions, for_each_message, for_each_topic};
pub use field::{Field, FieldType};
pub use gridworld::*;
pub use highway::*;
pub(crate) use message::layout_text;
pub use message::{Header, Message, layout_hash};
pub use python::python_module;
pub use sensed::Sensed;
pub use step::*;
