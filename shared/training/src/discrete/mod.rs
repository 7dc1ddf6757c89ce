//! Learning in the gridworlds: the self-model by ELBO and deep Q-learning, and people's implants from their rounds.

mod batch;
mod checkpoint;
pub mod cloning;
mod dqn;
pub mod implants;
pub mod people;
mod replay;
mod rollout;
mod rounds;
pub mod sqil;

pub use batch::{Dropout, Shard};
pub use checkpoint::ResumeError;
pub use dqn::{Metrics, Settings, Trainer};
pub use replay::{Episode, Replay};
pub use rollout::{Actor, Lived, Rollout};
pub use rounds::{Round, Rounds, RoundsError};
