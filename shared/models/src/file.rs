//! Self-models and implants as files: safetensors, with what they are in the metadata, readable from Python. Of whatever domain
//! they are, they have one format.

use crate::implants::{Features, Implants, PolicyImplant, Posterior};
use crate::self_model::SelfModel;
use crate::shipped;
use crate::sizes::Sizes;
use domains::{ActionSpace, Layout};
use nn::Parameters;
use nn::checkpoint::{Checkpoint, CheckpointError, Extra};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use thiserror::Error;

/// Metadata key that says what a file holds.
pub const HOLDS: &str = "mirror.holds";
/// A self-model.
pub const SELF_MODEL: &str = "self-model";
/// Implants.
pub const IMPLANTS: &str = "implants";
/// A recurrent policy.
pub const POLICY: &str = "policy";
/// Metadata key of a network's sizes, as JSON.
pub const SIZES: &str = "mirror.sizes";
/// Metadata key of the domain.
pub const DOMAIN: &str = "mirror.domain";
/// Metadata key of the command that made the file.
pub const COMMAND: &str = "mirror.command";
/// Metadata key of the digest of the self-model that implants belong to.
pub const SELF_MODEL_DIGEST: &str = "mirror.self_model";
/// Metadata key of the utterances that a person hears without an assistant, a bit each, as a decimal number.
pub const HEARD: &str = "mirror.heard";
/// Metadata key that tells whether there are policy implants.
const WITH_POLICY: &str = "mirror.with_policy";
/// Tensors of a posterior ([`Posterior::save`]).
const WEIGHTS: &str = "weights";
const LIMITS: &str = "limits";
const LOG_GAIN: &str = "log_gain";
const LAPSE: &str = "lapse";
const BIAS: &str = "bias";
const RESIDUAL: &str = "residual";
const NOISE: &str = "noise";
const CENTER: &str = "center";
const DIRECTIONS: &str = "directions";

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
    /// A number in it is not finite, or outside its range.
    #[error("{file}: tensor \"{tensor}\" holds {value} at {index}, which is out of range")]
    OutOfRange {
        /// The file.
        file: String,
        /// The tensor.
        tensor: &'static str,
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

impl SelfModel {
    /// A name for the exact parameters: FNV-1a over their bytes, in hexadecimal.
    pub fn digest(&self) -> String {
        let mut hash: u64 = 0xcbf2_9ce4_8422_2325;
        for (_, _, tensor) in self.parameters.iter() {
            for value in tensor.data() {
                for byte in value.to_le_bytes() {
                    hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
                }
            }
        }
        format!("{hash:016x}")
    }

    /// The metadata that every self-model's file has; `command` is how it was made.
    pub fn metadata(&self, command: &str) -> BTreeMap<String, String> {
        let sizes = serde_json::to_string(&self.sizes).unwrap_or_default();
        BTreeMap::from([
            (HOLDS.to_owned(), SELF_MODEL.to_owned()),
            (DOMAIN.to_owned(), self.layout.domain.to_owned()),
            (SIZES.to_owned(), sizes),
            (COMMAND.to_owned(), command.to_owned()),
        ])
    }

    /// Writes the model; `command` is how it was made.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path, command: &str) -> Result<(), CheckpointError> {
        let metadata = self.metadata(command);
        nn::checkpoint::save(path, &[("", &self.parameters)], &[], &metadata)
    }

    /// Reads a model of the domain that `layout` is of: a file, or one that ships ([`shipped`]).
    ///
    /// # Errors
    /// If the file is missing, damaged, of another version or domain, or holds something else.
    pub fn load(path: &Path, layout: Arc<Layout>) -> Result<Self, ModelFileError> {
        Self::from_checkpoint(&shipped::load(path)?, layout)
    }

    /// The model in a checkpoint.
    ///
    /// # Errors
    /// See [`Self::load`].
    pub fn from_checkpoint(
        checkpoint: &Checkpoint,
        layout: Arc<Layout>,
    ) -> Result<Self, ModelFileError> {
        expect(checkpoint, SELF_MODEL)?;
        expect_domain(checkpoint, &layout)?;
        let wrong = |reason: String| ModelFileError::Sizes {
            file: checkpoint.file().to_owned(),
            reason,
        };
        let sizes: Sizes = serde_json::from_str(checkpoint.metadata_value(SIZES)?)
            .map_err(|error| wrong(error.to_string()))?;
        if let Some(reason) = sizes.problem(&layout) {
            return Err(wrong(reason));
        }
        // The first weights are thrown away: every parameter is read.
        let mut model = Self::new(sizes, layout, &mut ChaCha8Rng::seed_from_u64(0));
        checkpoint.read("", &mut model.parameters)?;
        finite(checkpoint.file(), &model.parameters)?;
        Ok(model)
    }
}

impl Posterior {
    /// Writes the posterior; `model` is the self-model that it was learned on, `heard` the utterances that the person hears
    /// without an assistant, `command` how it was made.
    ///
    /// Tensors, flat, with n hypotheses one after the other: `weights` (n), `limits` (n · limits), and with policy implants
    /// `log_gain` and `lapse` (n), `bias` (n · actions), `residual` (n · actions · features), `noise` (n · actions where actions
    /// are numbers, else 0), `center` (latent), `directions` (features · latent).
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(
        &self,
        path: &Path,
        model: &SelfModel,
        heard: u32,
        command: &str,
    ) -> Result<(), CheckpointError> {
        let metadata = BTreeMap::from([
            (HOLDS.to_owned(), IMPLANTS.to_owned()),
            (DOMAIN.to_owned(), model.layout.domain.to_owned()),
            (SELF_MODEL_DIGEST.to_owned(), model.digest()),
            (WITH_POLICY.to_owned(), self.has_policy().to_string()),
            (HEARD.to_owned(), heard.to_string()),
            (COMMAND.to_owned(), command.to_owned()),
        ]);
        let policies: Vec<&PolicyImplant> = self
            .hypotheses
            .iter()
            .filter_map(|h| h.policy.as_ref())
            .collect();
        let all = |part: &dyn Fn(&PolicyImplant) -> &[f32]| -> Vec<f32> {
            policies
                .iter()
                .flat_map(|policy| part(policy))
                .copied()
                .collect()
        };
        let limits = self
            .hypotheses
            .iter()
            .flat_map(|h| h.limits.clone())
            .collect();
        let mut tensors = vec![(WEIGHTS, self.weights.clone()), (LIMITS, limits)];
        if !policies.is_empty() {
            tensors.extend([
                (LOG_GAIN, all(&|p| core::slice::from_ref(&p.log_gain))),
                (LAPSE, all(&|p| core::slice::from_ref(&p.lapse))),
                (BIAS, all(&|p| &p.bias)),
                (RESIDUAL, all(&|p| &p.residual)),
                (NOISE, all(&|p| &p.noise)),
                (CENTER, self.features.center.clone()),
                (DIRECTIONS, self.features.directions.clone()),
            ]);
        }
        let extras: Vec<(&str, Extra)> = tensors
            .iter()
            .map(|(name, data)| (*name, Extra::F32(data)))
            .collect();
        nn::checkpoint::save(path, &[], &extras, &metadata)
    }

    /// Reads what was learned of a person with `model`, and the utterances that they hear without an assistant.
    ///
    /// # Errors
    /// If the file is missing, damaged, holds something else, or was learned on another self-model.
    pub fn load(path: &Path, model: &SelfModel) -> Result<(Self, u32), ModelFileError> {
        let checkpoint = nn::checkpoint::load(path)?;
        expect(&checkpoint, IMPLANTS)?;
        expect_domain(&checkpoint, &model.layout)?;
        let theirs = checkpoint.metadata_value(SELF_MODEL_DIGEST)?;
        let ours = model.digest();
        if theirs != ours {
            return Err(ModelFileError::OtherSelfModel {
                file: checkpoint.file().to_owned(),
                theirs: theirs.to_owned(),
                ours,
            });
        }
        let with_policy = checkpoint.metadata_value(WITH_POLICY)? == "true";
        let posterior = Self::from_checkpoint(&checkpoint, model, with_policy)?;
        Ok((posterior, heard(&checkpoint, &model.layout)?))
    }

    fn from_checkpoint(
        checkpoint: &Checkpoint,
        model: &SelfModel,
        with_policy: bool,
    ) -> Result<Self, ModelFileError> {
        let perception = model.layout.perception;
        let (actions, latent) = (model.layout.actions, model.sizes.latent);
        let rows = actions.rows();
        let weights = numbers(checkpoint, WEIGHTS, None, |w| (0.0..=1.0).contains(&w))?;
        let sum: f32 = weights.iter().sum();
        if weights.is_empty() || (sum - 1.0).abs() > 1e-3 {
            return Err(CheckpointError::Mismatch {
                file: checkpoint.file().to_owned(),
                name: WEIGHTS.to_owned(),
                expected: "probabilities that sum to 1".to_owned(),
                found: format!("{} numbers that sum to {sum}", weights.len()),
            }
            .into());
        }
        let count = weights.len();
        let of_each = |name: &'static str, each: usize, is_sound: &dyn Fn(f32) -> bool| {
            numbers(checkpoint, name, Some(each * count), is_sound).map(|all| match each {
                0 => vec![Vec::new(); count],
                each => all.chunks_exact(each).map(<[f32]>::to_vec).collect(),
            })
        };
        let limits = of_each(LIMITS, perception.limits(), &|limit| limit >= 0.0)?;
        let mut hypotheses: Vec<Implants> = limits
            .into_iter()
            .map(|limits| Implants {
                limits,
                policy: None,
            })
            .collect();
        let mut features = Features::default();
        if with_policy {
            features.center = numbers(checkpoint, CENTER, Some(latent), |_| true)?;
            features.directions = numbers(checkpoint, DIRECTIONS, None, |_| true)?;
            if !features.directions.len().is_multiple_of(latent) {
                return Err(CheckpointError::Mismatch {
                    file: checkpoint.file().to_owned(),
                    name: DIRECTIONS.to_owned(),
                    expected: format!("a multiple of {latent} numbers"),
                    found: format!("{} numbers", features.directions.len()),
                }
                .into());
            }
            let gains = of_each(LOG_GAIN, 1, &|gain| gain.abs() < 20.0)?;
            let lapses = of_each(LAPSE, 1, &|lapse| (0.0..1.0).contains(&lapse))?;
            let biases = of_each(BIAS, rows, &|_| true)?;
            let residuals = of_each(RESIDUAL, rows * features.count(), &|_| true)?;
            let noises = match actions {
                ActionSpace::Discrete(_) => vec![Vec::new(); count],
                ActionSpace::Continuous(_) => of_each(NOISE, rows, &|noise| noise >= 0.0)?,
            };
            let parts = gains.into_iter().zip(lapses).zip(biases).zip(residuals);
            for (h, (part, noise)) in hypotheses.iter_mut().zip(parts.zip(noises)) {
                let (((gain, lapse), bias), residual) = part;
                h.policy = Some(PolicyImplant {
                    log_gain: gain[0],
                    bias,
                    residual,
                    noise,
                    lapse: lapse[0],
                });
            }
        }
        Ok(Self {
            perception,
            hypotheses,
            weights,
            features,
        })
    }
}

/// A tensor of finite numbers, all of which are sound; `count` of them, where that is known.
fn numbers(
    checkpoint: &Checkpoint,
    name: &'static str,
    count: Option<usize>,
    is_sound: impl Fn(f32) -> bool,
) -> Result<Vec<f32>, ModelFileError> {
    let data = checkpoint.f32s(name)?;
    if let Some(index) = data.iter().position(|x| !x.is_finite() || !is_sound(*x)) {
        return Err(ModelFileError::OutOfRange {
            file: checkpoint.file().to_owned(),
            tensor: name,
            value: data[index],
            index,
        });
    }
    match count {
        Some(count) if count != data.len() => Err(CheckpointError::Mismatch {
            file: checkpoint.file().to_owned(),
            name: name.to_owned(),
            expected: format!("{count} numbers"),
            found: format!("{} numbers", data.len()),
        }
        .into()),
        _ => Ok(data),
    }
}

/// Fails for a file that holds something else.
pub(crate) fn expect(
    checkpoint: &Checkpoint,
    expected: &'static str,
) -> Result<(), ModelFileError> {
    let found = checkpoint.metadata().get(HOLDS);
    let found = found.map_or("nothing of ours", String::as_str);
    if found == expected {
        return Ok(());
    }
    Err(ModelFileError::Holds {
        file: checkpoint.file().to_owned(),
        found: found.to_owned(),
        expected,
    })
}

/// Fails for a file of another domain than the layout's.
pub(crate) fn expect_domain(
    checkpoint: &Checkpoint,
    layout: &Layout,
) -> Result<(), ModelFileError> {
    let found = checkpoint.metadata_value(DOMAIN)?;
    if found == layout.domain {
        return Ok(());
    }
    Err(ModelFileError::Holds {
        file: checkpoint.file().to_owned(),
        found: format!("something of domain `{found}`"),
        expected: layout.domain,
    })
}

/// The utterances that the person hears without an assistant.
pub(crate) fn heard(checkpoint: &Checkpoint, layout: &Layout) -> Result<u32, ModelFileError> {
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

pub(crate) fn finite(file: &str, parameters: &Parameters) -> Result<(), ModelFileError> {
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
