//! The robot's self-model, the implants that turn it into a model of a person, and the trait that every human model
//! implements. Nothing here knows of processes or topics.

pub mod checkpoint;
pub mod discrete;
pub mod human;
pub mod imagined;
pub mod implants;
pub mod observation;
pub mod policy;
pub mod recurrent;
pub mod recurrent_file;
pub mod self_model;
pub mod shipped;
pub mod utterances;
pub mod words;
pub mod world_model;

pub use human::{Beliefs, HumanModel, Kind, SelfHuman};
pub use implants::Implants;
pub use observation::{Communicated, Observations, Shape};
pub use recurrent::{RecurrentHuman, RecurrentPolicy, RecurrentSizes};
pub use self_model::{Filter, SelfModel};
pub use world_model::WorldModel;
