//! Self-models and implants as files: safetensors, with what they are in the metadata, readable from Python.

use crate::implants::Implants;
use crate::self_model::{SelfModel, Sizes};
use crate::shipped;
use nn::checkpoint::{Checkpoint, CheckpointError};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::path::Path;
use thiserror::Error;

/// Metadata key that says what a file holds.
pub const HOLDS: &str = "mirror.holds";
/// A self-model.
pub const SELF_MODEL: &str = "self-model";
/// Implants.
pub const IMPLANTS: &str = "implants";
/// Metadata key of the self-model's sizes, as JSON.
pub const SIZES: &str = "mirror.sizes";
/// Metadata key of the command that made the file.
pub const COMMAND: &str = "mirror.command";
/// Metadata key of the digest of the self-model that implants belong to.
pub const SELF_MODEL_DIGEST: &str = "mirror.self_model";

/// A model file could not be used.
#[derive(Debug, Error)]
pub enum ModelFileError {
    /// It could not be read, or lacks a tensor.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// It holds something else.
    #[error("{file}: holds {found}, expected {expected}")]
    Holds {
        /// The file.
        file: String,
        /// What it holds.
        found: String,
        /// What was expected.
        expected: &'static str,
    },
    /// Its sizes cannot be understood, or are out of bounds.
    #[error("{file}: metadata \"{SIZES}\": {reason}")]
    Sizes {
        /// The file.
        file: String,
        /// What is wrong.
        reason: String,
    },
    /// Something that its metadata says cannot be understood.
    #[error("{file}: metadata \"{key}\": {reason}")]
    Metadata {
        /// The file.
        file: String,
        /// The key.
        key: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// A number in it is not finite.
    #[error("{file}: tensor \"{tensor}\" holds {value} at {index}")]
    NotFinite {
        /// The file.
        file: String,
        /// The tensor.
        tensor: String,
        /// The number.
        value: f32,
        /// Its place, column by column.
        index: usize,
    },
    /// Implants were learned on another self-model.
    #[error("{file}: these implants belong to self-model {theirs}, but {ours} is in use")]
    OtherSelfModel {
        /// The file.
        file: String,
        /// Digest of the self-model that they were learned on.
        theirs: String,
        /// Digest of the one in use.
        ours: String,
    },
}

/// A name for a self-model's exact parameters: FNV-1a over their bytes, in hexadecimal.
pub fn digest(model: &SelfModel) -> String {
    let mut hash: u64 = 0xcbf2_9ce4_8422_2325;
    for (_, _, tensor) in model.parameters.iter() {
        for value in tensor.data() {
            for byte in value.to_le_bytes() {
                hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
            }
        }
    }
    format!("{hash:016x}")
}

/// The metadata that every self-model file has.
pub fn self_model_metadata(model: &SelfModel, command: &str) -> BTreeMap<String, String> {
    let sizes = serde_json::to_string(&model.sizes).unwrap_or_default();
    BTreeMap::from([
        (HOLDS.to_owned(), SELF_MODEL.to_owned()),
        (SIZES.to_owned(), sizes),
        (COMMAND.to_owned(), command.to_owned()),
    ])
}

/// Writes a self-model; `command` is how it was made.
///
/// # Errors
/// If the file cannot be written.
pub fn save_self_model(
    path: &Path,
    model: &SelfModel,
    command: &str,
) -> Result<(), CheckpointError> {
    nn::checkpoint::save(
        path,
        &[("", &model.parameters)],
        &[],
        &self_model_metadata(model, command),
    )
}

/// Reads a self-model.
///
/// # Errors
/// If the file is missing, damaged, of another version, or holds something else.
pub fn load_self_model(path: &Path) -> Result<SelfModel, ModelFileError> {
    self_model_from(&shipped::load(path)?)
}

/// The self-model in a checkpoint.
///
/// # Errors
/// See [`load_self_model`].
pub fn self_model_from(checkpoint: &Checkpoint) -> Result<SelfModel, ModelFileError> {
    expect(checkpoint, SELF_MODEL)?;
    let file = checkpoint.file().to_owned();
    let sizes: Sizes = serde_json::from_str(checkpoint.metadata_value(SIZES)?).map_err(|e| {
        ModelFileError::Sizes {
            file: file.clone(),
            reason: e.to_string(),
        }
    })?;
    if sizes.shape != Sizes::HIGHWAY.shape
        || sizes.latent != Sizes::HIGHWAY.latent
        || !(1..=1024).contains(&sizes.hidden)
    {
        let reason = format!("{sizes:?} is not a highway self-model");
        return Err(ModelFileError::Sizes { file, reason });
    }
    // The first weights are thrown away: every parameter is read.
    let mut model = SelfModel::new(sizes, &mut ChaCha8Rng::seed_from_u64(0));
    checkpoint.read("", &mut model.parameters)?;
    finite(&file, &model.parameters)?;
    Ok(model)
}

/// Writes implants; `command` is how they were made.
///
/// # Errors
/// If the file cannot be written.
pub fn save_implants(
    path: &Path,
    implants: &Implants,
    model: &SelfModel,
    command: &str,
) -> Result<(), CheckpointError> {
    let metadata = BTreeMap::from([
        (HOLDS.to_owned(), IMPLANTS.to_owned()),
        (COMMAND.to_owned(), command.to_owned()),
        (SELF_MODEL_DIGEST.to_owned(), digest(model)),
    ]);
    nn::checkpoint::save(path, &[("", &implants.parameters)], &[], &metadata)
}

/// Reads implants for `model`.
///
/// # Errors
/// If the file is missing, damaged, holds something else, or belongs to another self-model.
pub fn load_implants(path: &Path, model: &SelfModel) -> Result<Implants, ModelFileError> {
    let checkpoint = nn::checkpoint::load(path)?;
    implants_from(&checkpoint, model)
}

/// The implants in a checkpoint.
///
/// # Errors
/// See [`load_implants`].
pub fn implants_from(
    checkpoint: &Checkpoint,
    model: &SelfModel,
) -> Result<Implants, ModelFileError> {
    expect(checkpoint, IMPLANTS)?;
    let file = checkpoint.file().to_owned();
    let (theirs, ours) = (checkpoint.metadata_value(SELF_MODEL_DIGEST)?, digest(model));
    if theirs != ours {
        let theirs = theirs.to_owned();
        return Err(ModelFileError::OtherSelfModel { file, theirs, ours });
    }
    let with_policy = checkpoint
        .names()
        .any(|name| name.starts_with("implant.residual"));
    let sizes = model.sizes;
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut implants = Implants::new(sizes.latent, sizes.shape.action, with_policy, &mut rng);
    checkpoint.read("", &mut implants.parameters)?;
    finite(&file, &implants.parameters)?;
    Ok(implants)
}

pub(crate) fn expect(
    checkpoint: &Checkpoint,
    expected: &'static str,
) -> Result<(), ModelFileError> {
    let found = checkpoint
        .metadata()
        .get(HOLDS)
        .map_or("nothing of ours", String::as_str);
    if found == expected {
        return Ok(());
    }
    Err(ModelFileError::Holds {
        file: checkpoint.file().to_owned(),
        found: found.to_owned(),
        expected,
    })
}

pub(crate) fn finite(file: &str, parameters: &nn::Parameters) -> Result<(), ModelFileError> {
    for (_, name, tensor) in parameters.iter() {
        if let Some(index) = tensor.data().iter().position(|x| !x.is_finite()) {
            return Err(ModelFileError::NotFinite {
                file: file.to_owned(),
                tensor: name.to_owned(),
                value: tensor.data()[index],
                index,
            });
        }
    }
    Ok(())
}
