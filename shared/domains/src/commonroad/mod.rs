//! Recorded traffic: CommonRoad scenarios as roads, traffic and drivers.
//!
//! [`Scenario::read`] reads a file; [`Scenario::course`] makes road and traffic of it for the highway world;
//! [`Scene::from_commonroad`](crate::highway::Scene::from_commonroad) does both; [`RecordedSeat`] drives as one of the
//! recorded people.

mod course;
mod error;
mod lanes;
mod left_out;
mod read;
mod read_traffic;
mod scenario;
mod seat;
pub mod shipped;
mod start;
mod xml;

pub use course::{GoalRegion, between, box_pose};
pub use error::{CommonRoadError, READ_VERSIONS};
pub use lanes::LaneletMap;
pub use scenario::{
    Adjacent, BadLanelet, Goal, Lanelet, LocalBox, Mark, Obstacle, Place, PlanningProblem,
    Scenario, Shape, State, wrap,
};
pub use seat::{RecordedActions, RecordedSeat};
