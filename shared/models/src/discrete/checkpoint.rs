//! The gridworlds' self-models and implants as files: safetensors, with what they are in the metadata.

use super::implants::Implants;
use super::self_model::DiscreteModel;
use super::sizes::Sizes;
use crate::checkpoint::{
    COMMAND, HOLDS, IMPLANTS, ModelFileError, SELF_MODEL, SELF_MODEL_DIGEST, SIZES,
};
use domains::discrete::Layout;
use nn::Parameters;
use nn::checkpoint::{Checkpoint, CheckpointError};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Metadata key of the domain.
pub const DOMAIN: &str = "mirror.domain";
/// Metadata key of the utterances that a person hears without an assistant, a bit each, as a decimal number.
pub const HEARD: &str = "mirror.heard";
/// Metadata key that tells whether implants have a policy residual.
const WITH_POLICY: &str = "mirror.with_policy";

/// A name for a model's exact parameters: FNV-1a over their bytes, in hexadecimal.
pub fn digest(parameters: &Parameters) -> String {
    let mut hash: u64 = 0xcbf2_9ce4_8422_2325;
    for (_, _, tensor) in parameters.iter() {
        for value in tensor.data() {
            for byte in value.to_le_bytes() {
                hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
            }
        }
    }
    format!("{hash:016x}")
}

/// The metadata that every gridworld's self-model file has; `command` is how it was made.
pub fn metadata(model: &DiscreteModel, command: &str) -> BTreeMap<String, String> {
    BTreeMap::from([
        (HOLDS.to_owned(), SELF_MODEL.to_owned()),
        (DOMAIN.to_owned(), model.sizes.domain.name().to_owned()),
        (
            SIZES.to_owned(),
            serde_json::to_string(&model.sizes).unwrap_or_default(),
        ),
        (COMMAND.to_owned(), command.to_owned()),
    ])
}

impl DiscreteModel {
    /// Writes the model; `command` is how it was made.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path, command: &str) -> Result<(), CheckpointError> {
        let metadata = metadata(self, command);
        nn::checkpoint::save(path, &[("", &self.parameters)], &[], &metadata)
    }

    /// Reads a model of the domain that `layout` is of.
    ///
    /// # Errors
    /// If the file is missing, damaged, of another version, or holds something else.
    pub fn load(path: &Path, layout: Arc<Layout>) -> Result<Self, ModelFileError> {
        model_from(&crate::shipped::load(path)?, layout)
    }
}

/// The self-model in a checkpoint.
///
/// # Errors
/// See [`DiscreteModel::load`].
pub fn model_from(
    checkpoint: &Checkpoint,
    layout: Arc<Layout>,
) -> Result<DiscreteModel, ModelFileError> {
    expect(checkpoint, SELF_MODEL)?;
    let file = checkpoint.file().to_owned();
    let sizes: Sizes = serde_json::from_str(checkpoint.metadata_value(SIZES)?).map_err(|e| {
        ModelFileError::Sizes {
            file: file.clone(),
            reason: e.to_string(),
        }
    })?;
    if let Some(reason) = sizes.problem(&layout) {
        return Err(ModelFileError::Sizes { file, reason });
    }
    let mut model = DiscreteModel::new(sizes, layout, &mut ChaCha8Rng::seed_from_u64(0));
    checkpoint.read("", &mut model.parameters)?;
    finite(&file, &model.parameters)?;
    Ok(model)
}

impl Implants {
    /// Writes the implants; `model` is the self-model that they were learned on, `heard` the utterances that the person hears
    /// without an assistant, `command` how they were made.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(
        &self,
        path: &Path,
        model: &DiscreteModel,
        heard: u32,
        command: &str,
    ) -> Result<(), CheckpointError> {
        let metadata = BTreeMap::from([
            (HOLDS.to_owned(), IMPLANTS.to_owned()),
            (DOMAIN.to_owned(), model.sizes.domain.name().to_owned()),
            (SELF_MODEL_DIGEST.to_owned(), digest(&model.parameters)),
            (WITH_POLICY.to_owned(), self.has_policy().to_string()),
            (HEARD.to_owned(), heard.to_string()),
            (COMMAND.to_owned(), command.to_owned()),
        ]);
        nn::checkpoint::save(path, &[("", &self.parameters)], &[], &metadata)
    }

    /// Reads implants that belong to `model`, and the utterances that their person hears without an assistant.
    ///
    /// # Errors
    /// If the file is missing, damaged, holds something else, or they were learned on another self-model.
    pub fn load(path: &Path, model: &DiscreteModel) -> Result<(Self, u32), ModelFileError> {
        let checkpoint = nn::checkpoint::load(path)?;
        expect(&checkpoint, IMPLANTS)?;
        expect_domain(&checkpoint, &model.layout)?;
        let file = checkpoint.file().to_owned();
        let theirs = checkpoint.metadata_value(SELF_MODEL_DIGEST)?;
        let ours = digest(&model.parameters);
        if theirs != ours {
            return Err(ModelFileError::OtherSelfModel {
                file,
                theirs: theirs.to_owned(),
                ours,
            });
        }
        let with_policy = checkpoint.metadata_value(WITH_POLICY)? == "true";
        let mut implants = Self::new(model, with_policy, &mut ChaCha8Rng::seed_from_u64(0));
        checkpoint.read("", &mut implants.parameters)?;
        finite(&file, &implants.parameters)?;
        Ok((implants, heard(&checkpoint, &model.layout)?))
    }
}

/// Fails for a file of another domain than the layout's.
pub(super) fn expect_domain(
    checkpoint: &Checkpoint,
    layout: &Layout,
) -> Result<(), ModelFileError> {
    let found = checkpoint.metadata_value(DOMAIN)?;
    if found == layout.domain.name() {
        return Ok(());
    }
    Err(ModelFileError::Holds {
        file: checkpoint.file().to_owned(),
        found: format!("something of domain `{found}`"),
        expected: layout.domain.name(),
    })
}

/// The utterances that the person hears without an assistant.
pub(super) fn heard(checkpoint: &Checkpoint, layout: &Layout) -> Result<u32, ModelFileError> {
    let text = checkpoint.metadata_value(HEARD)?;
    let everything = layout.everything().verbal;
    match text.parse::<u32>() {
        Ok(bits) if bits & !everything == 0 => Ok(bits),
        _ => Err(ModelFileError::Metadata {
            file: checkpoint.file().to_owned(),
            key: HEARD,
            reason: format!("{text} is no set of {} utterances", layout.utterances),
        }),
    }
}

pub(super) fn expect(
    checkpoint: &Checkpoint,
    expected: &'static str,
) -> Result<(), ModelFileError> {
    let found = checkpoint.metadata().get(HOLDS);
    let found = found.map_or("something else", String::as_str);
    if found == expected {
        return Ok(());
    }
    Err(ModelFileError::Holds {
        file: checkpoint.file().to_owned(),
        found: found.to_owned(),
        expected,
    })
}

pub(super) fn finite(file: &str, parameters: &Parameters) -> Result<(), ModelFileError> {
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
