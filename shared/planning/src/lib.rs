//! Deciding what to communicate, by imagining both futures together (paper §III-C).

pub mod assistant;
pub mod chooser;
pub mod cross_entropy;
pub mod imagination;
pub mod matching;
pub mod people;
pub mod planner;

pub use assistant::Assistant;
pub use chooser::{Chooser, Method};
pub use imagination::{Imagination, Stage};
pub use matching::Matcher;
pub use people::{ImaginedPeople, LocalPeople, PeopleError};
pub use planner::{Decision, Planner, Settings};
