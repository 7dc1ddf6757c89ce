//! Deciding what to communicate, by imagining both futures together (paper §III-C).

pub mod assistant;
pub mod cross_entropy;
pub mod discrete;
pub mod imagination;
pub mod items;
pub mod people;
pub mod planner;
pub mod round;

pub use assistant::Assistant;
pub use discrete::DiscreteAssistant;
pub use imagination::{Imagination, Stage};
pub use items::Items;
pub use people::{ImaginedPeople, LocalPeople, PeopleError};
pub use planner::{Decision, Planner, Settings};
