//! Learning: the self-model by ELBO and soft actor-critic or deep Q-learning, and from a person's demonstrations implants or
//! policies.
//!
//! One file holds one algorithm: [`self_model`] with [`sac`] and [`dqn`], [`implants`], [`cloning`], [`sqil`], [`irl`]. What they
//! share: worlds as learning sees them ([`environment`]); of the robot's own rounds [`rollout`], [`replay`], [`batches`] and
//! [`checkpoint`]; of people's [`rounds`] and [`trajectory`]; settings ([`config`]). [`people`] learns a person of any kind.

pub mod batches;
pub mod checkpoint;
pub mod cloning;
pub mod config;
pub mod dqn;
pub mod environment;
pub mod implants;
pub mod irl;
mod linear;
pub mod people;
mod record;
pub mod replay;
pub mod rollout;
pub mod rounds;
pub mod sac;
pub mod self_model;
mod sighted;
pub mod sqil;
pub mod trajectory;

/// Shards that a batch is cut into. Their gradients are added in this fixed order, so that the number of threads
/// changes no byte of the result.
pub const SHARDS: usize = 2;
