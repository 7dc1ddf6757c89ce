//! Learning in the gridworlds: the self-model by ELBO and deep Q-learning, and people's implants from their rounds.

mod batch;
mod checkpoint;
mod dqn;
mod losses;
mod replay;
mod rollout;
mod settings;

pub use batch::{Dropout, Shard};
pub use checkpoint::ResumeError;
pub use dqn::{Metrics, Trainer};
pub use replay::{Episode, Replay};
pub use rollout::{Actor, Lived, Rollout};
pub use settings::Settings;
