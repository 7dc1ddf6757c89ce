//! Learning: the self-model by ELBO and soft actor-critic, and from a person's demonstrations implants or policies.

pub mod batches;
pub mod checkpoint;
pub mod cloning;
pub mod config;
pub mod discrete;
pub mod environment;
pub mod implants;
pub mod implants_discrete;
pub mod irl;
pub mod people;
pub mod replay;
pub mod rollout;
pub mod rounds;
pub mod sac;
pub mod self_model;
pub mod sqil;
pub mod trajectory;

/// Shards that a batch is cut into. Their gradients are added in this fixed order, so that the number of threads
/// changes no byte of the result.
pub const SHARDS: usize = 2;
