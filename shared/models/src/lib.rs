//! The robot's self-model, the implants that turn it into a model of a person, and the trait that every human model
//! implements. Nothing here knows of processes or topics, nor of a particular domain: what its numbers mean, a
//! [`domains::Layout`] says.

pub mod config;
pub mod file;
pub mod filter;
mod followed;
pub mod human;
pub mod human_file;
mod ideal;
pub mod imagined;
pub mod implants;
pub mod observation;
pub mod policy;
mod reader;
pub mod recurrent;
mod self_human;
pub mod self_model;
pub mod shipped;
mod sizes;
pub mod utterances;
mod view;
pub mod words;

pub use filter::{Filter, Scratch, WorldModel};
pub use followed::FollowedPerson;
pub use human::{Beliefs, HumanModel, Kind};
pub use human_file::{HumanError, PersonalPolicy, load_human};
pub use ideal::IdealHuman;
pub use implants::{Features, Implants, PolicyImplant, Posterior};
pub use observation::{Communicated, Observations, Shape};
pub use policy::{ActionDistribution, Policy};
pub use reader::{Reader, ReaderScratch};
pub use recurrent::{RecurrentHuman, RecurrentPolicy, RecurrentSizes};
pub use self_human::SelfHuman;
pub use self_model::SelfModel;
pub use sizes::{ImageSizes, MOST_LATENT, Sizes, SizesError};
pub use view::View;
