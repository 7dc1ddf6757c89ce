//! Checkpoints of a training run: everything needed to continue exactly. Weights, targets, the optimiser's moments, temperature,
//! replay buffer and the phase reached; randomness is drawn anew from (seed, phase), so that there is no generator to store.

use crate::config::Checked;
use crate::environment::Environment;
use crate::self_model::{Learner, SelfModelSettings, Trainer};
use domains::ActionSpace;
use models::SelfModel;
use models::file::ModelFileError;
use nn::checkpoint::{CheckpointError, Extra};
use std::path::Path;
use std::sync::Arc;
use thiserror::Error;

/// Metadata key of the settings, as JSON.
const SETTINGS: &str = "mirror.training";
/// Tensor of log α and its moments.
const TEMPERATURE: &str = "temperature";

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
    #[error("{file}: metadata \"{SETTINGS}\": {reason}; a run of an earlier version cannot go on")]
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
        let settings = serde_json::to_string(&self.settings).unwrap_or_default();
        metadata.insert(SETTINGS.to_owned(), settings);
        let replay = self.replay.to_bytes();
        let (step, phase) = ([self.adam.step], [u64::from(self.phase)]);
        let mut extras = vec![
            ("adam.step", Extra::U64(&step)),
            ("phase", Extra::U64(&phase)),
            ("replay", Extra::U8(&replay)),
        ];
        let temperature = match &self.learner {
            Learner::Sac(sac) => Some(sac.temperature),
            Learner::Dqn(_) => None,
        };
        if let Some(temperature) = &temperature {
            extras.push((TEMPERATURE, Extra::F32(temperature)));
        }
        let parameters = [
            ("", &self.model.parameters),
            ("target", self.learner.targets()),
            ("adam", self.adam.moments()),
        ];
        nn::checkpoint::save(path, &parameters, &extras, &metadata)
    }

    /// Continues a run from its checkpoint, with the settings that stand in it.
    ///
    /// # Errors
    /// If the file is missing, damaged, or holds something else.
    pub fn resume(path: &Path, environment: Box<dyn Environment>) -> Result<Self, ResumeError> {
        let checkpoint = nn::checkpoint::load(path)?;
        let file = checkpoint.file().to_owned();
        let layout = Arc::clone(environment.layout());
        let numbers = matches!(layout.actions, ActionSpace::Continuous(_));
        let model = SelfModel::from_checkpoint(&checkpoint, layout)?;
        let bad = |reason: String| ResumeError::Settings {
            file: file.clone(),
            reason,
        };
        let settings: SelfModelSettings =
            serde_json::from_str(checkpoint.metadata_value(SETTINGS)?)
                .map_err(|error| bad(error.to_string()))?;
        if let Some(reason) = settings.problem() {
            return Err(bad(reason));
        }
        if settings.sac.is_some() != numbers {
            return Err(bad("another learner's than this domain's".to_owned()));
        }
        let mut trainer = Self::with_model(environment, model, settings);
        checkpoint.read("target", trainer.learner.targets_mut())?;
        trainer.adam.load(&checkpoint, "adam")?;
        trainer.phase = checkpoint.u64s("phase", 1)?[0] as u32;
        if let Learner::Sac(sac) = &mut trainer.learner {
            let found = checkpoint.f32s(TEMPERATURE)?;
            sac.temperature = found[..]
                .try_into()
                .map_err(|_| CheckpointError::Mismatch {
                    file: file.clone(),
                    name: TEMPERATURE.to_owned(),
                    expected: "F32 [4]".to_owned(),
                    found: format!("F32 [{}]", found.len()),
                })?;
        }
        let bytes = checkpoint.u8s("replay")?;
        if trainer.replay.read_bytes(bytes).is_none() {
            let bytes = bytes.len();
            return Err(ResumeError::Replay { file, bytes });
        }
        Ok(trainer)
    }
}
