//! The worlds that people and robots act in: state, reward, sensing and simulated people.
//!
//! A pure library: it knows nothing of processes or messages. [`highway`] is the continuous driving domain;
//! [`commonroad`] turns recorded traffic into a road and cars for it. [`driving`], [`search_rescue`] and [`bomb_defusal`] are the
//! paper's gridworlds; [`discrete`] is what these three have in common, and the place to start from.

#[macro_use]
mod table;

pub mod bomb_defusal;
pub mod commonroad;
pub mod discrete;
pub mod driving;
pub mod highway;
mod layout;
mod mask;
mod perception;
pub mod search_rescue;

pub use layout::{ActionSpace, Image, Layout, QuadraticCosts};
pub use mask::Mask;
pub use perception::Perception;
