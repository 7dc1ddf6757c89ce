//! Checkpoints of a training run: everything needed to continue exactly. Weights, target critics, the
//! optimiser's moments, temperature, replay buffer and the episode reached; randomness is drawn anew from (seed,
//! episode), so that there is no generator to store.

use crate::config::Checked;
use crate::replay::Replay;
use crate::self_model::{Settings, Trainer};
use domains::highway::{Scene, modalities};
use models::SelfModel;
use models::file::ModelFileError;
use models::utterances::UtteranceTable;
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
    /// The replay buffer in the file is no whole number of steps.
    #[error("{file}: tensor \"replay\" holds {bytes} bytes, which is no replay buffer of ours")]
    Replay {
        /// The file.
        file: String,
        /// Its size.
        bytes: usize,
    },
    /// The scene's road cannot be built.
    #[error(transparent)]
    Road(#[from] domains::highway::road::RoadError),
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
        let temperature = [
            self.log_temperature,
            self.temperature_moments[0],
            self.temperature_moments[1],
            self.temperature_moments[2],
        ];
        nn::checkpoint::save(
            path,
            &[
                ("", &self.model.parameters),
                ("targets", &self.targets.parameters),
                ("adam", self.adam.moments()),
            ],
            &[
                ("adam.step", Extra::U64(&[self.adam.step])),
                ("episode", Extra::U64(&[u64::from(self.episode)])),
                ("temperature", Extra::F32(&temperature)),
                ("replay", Extra::U8(&replay)),
            ],
            &metadata,
        )
    }

    /// Continues a run from its checkpoint, with the settings that stand in it.
    ///
    /// # Errors
    /// If the file is missing, damaged, or holds something else.
    pub fn resume(
        path: &Path,
        scene: Arc<Scene>,
        table: UtteranceTable,
    ) -> Result<Self, ResumeError> {
        let checkpoint = nn::checkpoint::load(path)?;
        let file = checkpoint.file().to_owned();
        let model = SelfModel::from_checkpoint(&checkpoint, modalities::layout())?;
        let settings: Settings = serde_json::from_str(checkpoint.metadata_value(SETTINGS)?)
            .map_err(|e| ResumeError::Settings {
                file: file.clone(),
                reason: e.to_string(),
            })?;
        if let Some(reason) = settings.problem() {
            return Err(ResumeError::Settings { file, reason });
        }
        let mut trainer = Self::with_sizes(scene, table, settings, model.sizes)?;
        trainer.model.parameters = model.parameters;
        checkpoint.read("targets", &mut trainer.targets.parameters)?;
        trainer.adam.load(&checkpoint, "adam")?;
        trainer.episode = checkpoint.u64s("episode", 1)?[0] as u32;
        let temperature = checkpoint.tensor("temperature")?;
        if temperature.rows() != 4 || temperature.cols() != 1 {
            return Err(CheckpointError::Mismatch {
                file,
                name: "temperature".to_owned(),
                expected: "F32 [4]".to_owned(),
                found: format!("F32 [{}, {}]", temperature.rows(), temperature.cols()),
            }
            .into());
        }
        let [log, first, second, steps] = [0, 1, 2, 3].map(|i| temperature.data()[i]);
        trainer.log_temperature = log;
        trainer.temperature_moments = [first, second, steps];
        let replay = checkpoint.u8s("replay")?;
        trainer.replay =
            Replay::from_bytes(replay, settings.replay).ok_or(ResumeError::Replay {
                file,
                bytes: replay.len(),
            })?;
        Ok(trainer)
    }
}
