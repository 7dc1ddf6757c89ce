//! Checkpoints of a gridworld's training run: everything needed to continue exactly.

use super::dqn::Trainer;
use super::settings::Settings;
use crate::config::Checked;
use domains::discrete::{Discrete, World};

use models::SelfModel;
use models::file::ModelFileError;
use nn::checkpoint::{CheckpointError, Extra};
use std::path::Path;
use std::sync::Arc;
use thiserror::Error;

/// Metadata key of the settings, as JSON.
const SETTINGS: &str = "mirror.training";

/// A training run could not be continued.
#[derive(Debug, Error)]
pub enum ResumeError {
    /// The file is missing, damaged, or holds something else.
    #[error(transparent)]
    Model(#[from] ModelFileError),
    /// A part of it is missing or of the wrong shape.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The settings in the file cannot be understood.
    #[error("{file}: metadata \"{SETTINGS}\": {reason}")]
    Settings {
        /// The file.
        file: String,
        /// What is wrong.
        reason: String,
    },
    /// The replay buffer in the file is none of ours.
    #[error(
        "{file}: tensor \"replay\" holds {bytes} bytes, which is no replay buffer of this domain"
    )]
    Replay {
        /// The file.
        file: String,
        /// Its size.
        bytes: usize,
    },
}

impl Trainer {
    /// Writes everything needed to continue.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path, command: &str) -> Result<(), CheckpointError> {
        let mut metadata = self.model.metadata(command);
        metadata.insert(
            SETTINGS.to_owned(),
            serde_json::to_string(&self.settings).unwrap_or_default(),
        );
        let replay = self.replay.to_bytes();
        nn::checkpoint::save(
            path,
            &[
                ("", &self.model.parameters),
                ("target", &self.target.parameters),
                ("adam", self.adam.moments()),
            ],
            &[
                ("adam.step", Extra::U64(&[self.adam.step])),
                ("phase", Extra::U64(&[u64::from(self.phase)])),
                ("replay", Extra::U8(&replay)),
            ],
            &metadata,
        )
    }

    /// Continues a run from its checkpoint, with the settings that stand in it.
    ///
    /// # Errors
    /// If the file is missing, damaged, or holds something else.
    pub fn resume(path: &Path, world: World) -> Result<Self, ResumeError> {
        let checkpoint = nn::checkpoint::load(path)?;
        let file = checkpoint.file().to_owned();
        let layout = Arc::new(world.layout().clone());
        let actions = layout.actions.rows();
        let model = SelfModel::from_checkpoint(&checkpoint, layout)?;
        let settings: Settings = serde_json::from_str(checkpoint.metadata_value(SETTINGS)?)
            .map_err(|e| ResumeError::Settings {
                file: file.clone(),
                reason: e.to_string(),
            })?;
        if let Some(reason) = settings.problem() {
            return Err(ResumeError::Settings { file, reason });
        }
        let mut trainer = Self::with_model(world, model, settings);
        checkpoint.read("target", &mut trainer.target.parameters)?;
        trainer.adam.load(&checkpoint, "adam")?;
        trainer.phase = checkpoint.u64s("phase", 1)?[0] as u32;
        let bytes = checkpoint.u8s("replay")?;
        let read = trainer.replay.read_bytes(bytes);
        if read.is_none() || !trainer.replay.is_sound(actions) {
            return Err(ResumeError::Replay {
                file,
                bytes: bytes.len(),
            });
        }
        Ok(trainer)
    }
}
