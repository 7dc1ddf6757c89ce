//! The self-model and the human models of the gridworlds: discrete actions, states or images, a Q-network instead of an actor.
//!
//! What the numbers mean is the domain's [`domains::discrete::Layout`]; [`Sizes`] holds the paper's network sizes for each
//! domain; [`DiscreteModel`] is the self-model, [`Implants`] turn it into a model of a person ([`DiscreteHuman`]), and
//! [`RecurrentChooser`] is what behavioural cloning and soft-Q imitation learn instead.

mod checkpoint;
mod filter;
mod human;
pub mod human_file;
mod ideal;
mod implants;
mod perception;
mod reader;
mod recurrent;
mod self_model;
mod sizes;
mod view;

pub use checkpoint::{DOMAIN, HEARD, digest, metadata, model_from};
pub use filter::{DiscreteFilter, DiscreteScratch};
pub use human::DiscreteHuman;
pub use ideal::IdealHuman;
pub use implants::{
    Attached, Implants, RESIDUAL_BOUND, RESIDUAL_HIDDEN, policy_on_tape, seen_on_tape,
};
pub use perception::{Perceiver, limits_of};
pub use reader::{Reader, ReaderScratch};
pub use recurrent::{ChooserSizes, RecurrentChooser, RecurrentHuman};
pub use self_model::{Batch, DiscreteModel, ElboTerms};
pub use sizes::{ImageSizes, Sizes};
pub use view::View;
