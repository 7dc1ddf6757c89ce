//! What human models learned of one person in a gridworld, as files, and the one place that turns such a file into a model.
//!
//! `mirror` and `mirror-p`: implants ([`Implants::save`]). `bc` and `sqil`: a policy's weights, in the metadata its kind, domain,
//! sizes and the command that made it, and, because these models are told what the person can perceive, the tensor `limits` with
//! their true sight.

use super::checkpoint::{DOMAIN, HEARD, expect, expect_domain, finite, heard};
use super::human::DiscreteHuman;
use super::implants::Implants;
use super::perception::{Perceiver, limits_of};
use super::recurrent::{ChooserSizes, RecurrentChooser, RecurrentHuman};
use super::self_model::DiscreteModel;
use crate::checkpoint::{COMMAND, HOLDS, ModelFileError, SIZES};
use crate::human::{HumanModel, Kind};
use crate::recurrent_file::POLICY;
use domains::discrete::{Layout, Sight};
use nn::checkpoint::{Checkpoint, CheckpointError, Extra};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use thiserror::Error;

/// Metadata key of the kind of human model.
const KIND: &str = "mirror.kind";
/// Tensor of what the person can see, as [`limits_of`] orders it.
const LIMITS: &str = "limits";

/// A human model could not be made.
#[derive(Debug, Error)]
pub enum HumanError {
    /// Its file cannot be used.
    #[error(transparent)]
    File(#[from] ModelFileError),
    /// It has to be learned, and no file was given.
    #[error(
        "human model `{}` needs a file of what was learned of the person (mirror train human)",
        .0.name()
    )]
    Unlearned(Kind),
    /// The unchanged self-model learns nothing, nor does the person's own.
    #[error("{}: human model `{}` learns nothing of a person and takes no file", .0.display(), .1.name())]
    NothingToTake(PathBuf, Kind),
    /// The ideal model is the person's own.
    #[error("human model `ideal` needs to know whose it is: a simulated person")]
    Nobody,
    /// A file of implants of the other kind.
    #[error(
        "{}: has {} policy implant, which is not human model `{}`",
        .file.display(),
        if *.with_policy { "a" } else { "no" },
        .kind.name()
    )]
    OtherImplants {
        /// The file.
        file: PathBuf,
        /// Whether it has a policy implant.
        with_policy: bool,
        /// What was asked for.
        kind: Kind,
    },
}

/// Writes a policy of `kind` of a person of this `sight`; `command` is how it was made, `about` further metadata.
///
/// # Errors
/// If the file cannot be written.
pub fn save_policy(
    path: &Path,
    kind: Kind,
    policy: &RecurrentChooser,
    sight: &Sight,
    command: &str,
    about: &[(&str, String)],
) -> Result<(), CheckpointError> {
    let sizes = serde_json::to_string(&policy.sizes).unwrap_or_default();
    let mut metadata = BTreeMap::from([
        (HOLDS.to_owned(), POLICY.to_owned()),
        (KIND.to_owned(), kind.name().to_owned()),
        (
            DOMAIN.to_owned(),
            policy.sizes.model.domain.name().to_owned(),
        ),
        (SIZES.to_owned(), sizes),
        (HEARD.to_owned(), sight.heard.to_string()),
        (COMMAND.to_owned(), command.to_owned()),
    ]);
    metadata.extend(about.iter().map(|(k, v)| ((*k).to_owned(), v.clone())));
    let limits = limits_of(&sight.perception);
    let extras = [(LIMITS, Extra::F32(&limits))];
    nn::checkpoint::save(path, &[("", &policy.parameters)], &extras, &metadata)
}

/// Reads a policy of `kind` in the domain of `layout`, and the sight of its person.
///
/// # Errors
/// If the file is missing, damaged, or holds something else.
pub fn load_policy(
    path: &Path,
    kind: Kind,
    layout: &Layout,
) -> Result<(RecurrentChooser, Sight), ModelFileError> {
    policy_from(&nn::checkpoint::load(path)?, kind, layout)
}

/// The policy in a checkpoint.
///
/// # Errors
/// See [`load_policy`].
pub fn policy_from(
    checkpoint: &Checkpoint,
    kind: Kind,
    layout: &Layout,
) -> Result<(RecurrentChooser, Sight), ModelFileError> {
    expect(checkpoint, POLICY)?;
    expect_domain(checkpoint, layout)?;
    let file = checkpoint.file().to_owned();
    let found = checkpoint.metadata_value(KIND)?;
    if found != kind.name() {
        return Err(ModelFileError::Holds {
            file,
            found: format!("a policy of kind `{found}`"),
            expected: kind.name(),
        });
    }
    let wrong = |reason: String| ModelFileError::Sizes {
        file: file.clone(),
        reason,
    };
    let sizes: ChooserSizes = serde_json::from_str(checkpoint.metadata_value(SIZES)?)
        .map_err(|e| wrong(e.to_string()))?;
    if let Some(reason) = sizes.problem(layout) {
        return Err(wrong(reason));
    }
    // The first weights are thrown away: every parameter is read.
    let mut policy = RecurrentChooser::new(sizes, layout, &mut ChaCha8Rng::seed_from_u64(0));
    checkpoint.read("", &mut policy.parameters)?;
    finite(&file, &policy.parameters)?;
    let limits = checkpoint.f32s(LIMITS)?;
    let perceiver = Perceiver::new(layout);
    let bad = |found: String| CheckpointError::Mismatch {
        file: file.clone(),
        name: LIMITS.to_owned(),
        expected: format!("{} limits of at least 0", perceiver.limits()),
        found,
    };
    if let Some(limit) = limits.iter().find(|limit| limit.is_nan() || **limit < 0.0) {
        return Err(bad(format!("{limit}")).into());
    }
    let sight = perceiver
        .sight(&limits, heard(checkpoint, layout)?)
        .ok_or_else(|| bad(format!("{} numbers", limits.len())))?;
    Ok((policy, sight))
}

/// A human model of `kind` on `model`, from the file of what was learned of the person; `self` takes none, and `ideal` is made
/// from the person ([`super::IdealHuman`]). `self` sees everything and hears nobody
/// but the assistant, as on the highway.
///
/// # Errors
/// If the file is missing, damaged, holds something else, or belongs to another self-model.
pub fn load_human(
    path: Option<&Path>,
    kind: Kind,
    model: &Arc<DiscreteModel>,
) -> Result<Box<dyn HumanModel>, HumanError> {
    let path = match (path, kind) {
        (None, Kind::Myself) => {
            let human = DiscreteHuman::new(Arc::clone(model), None, 0);
            return Ok(Box::new(human));
        }
        (Some(path), Kind::Myself | Kind::Ideal) => {
            return Err(HumanError::NothingToTake(path.to_owned(), kind));
        }
        (None, Kind::Ideal) => return Err(HumanError::Nobody),
        (None, kind) => return Err(HumanError::Unlearned(kind)),
        (Some(path), _) => path,
    };
    if !kind.is_self_model() {
        let layout = &model.layout;
        let (policy, sight) = load_policy(path, kind, layout)?;
        let human = RecurrentHuman::new(kind.name(), Arc::new(policy), layout, &sight);
        return Ok(Box::new(human));
    }
    let (implants, heard) = Implants::load(path, model)?;
    let with_policy = implants.has_policy();
    if with_policy != (kind == Kind::Mirror) {
        return Err(HumanError::OtherImplants {
            file: path.to_owned(),
            with_policy,
            kind,
        });
    }
    let human = DiscreteHuman::new(Arc::clone(model), Some(implants), heard);
    Ok(Box::new(human))
}
