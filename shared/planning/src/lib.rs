//! Deciding what to communicate, by imagining both futures together (paper §III-C).

pub mod assistant;
pub mod candidates;
pub mod chooser;
pub mod cross_entropy;
pub mod ideal;
pub mod imagination;
pub mod items;
pub mod matching;
pub mod people;
pub mod planner;
pub mod race;
mod race_planner;
pub mod round;
pub mod settings;
pub mod threaded;

pub use assistant::{Assistant, PlanMoment};
pub use chooser::{Chooser, Method};
pub use imagination::{Imagination, Stage};
pub use items::Items;
pub use matching::Matcher;
pub use people::{ImaginedPeople, LocalPeople, PeopleError};
pub use planner::{Decision, Planner};
pub use race::Race;
pub use race_planner::RacePlanner;
pub use settings::{RaceSettings, Settings};
pub use threaded::ThreadedPeople;
