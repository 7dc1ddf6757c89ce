//! Learning: the self-model by ELBO and soft actor-critic, and from a person's demonstrations implants or policies.

pub mod batches;
pub mod checkpoint;
pub mod cloning;
pub mod config;
pub mod demonstrations;
pub mod discrete;
pub mod implants;
pub mod irl;
pub mod lessons;
pub mod policies;
pub mod replay;
pub mod rollout;
pub mod sac;
pub mod self_model;
pub mod sqil;

/// Shards that a batch is cut into. Their gradients are added in this fixed order, so that the number of threads
/// changes no byte of the result.
pub const SHARDS: usize = 2;
