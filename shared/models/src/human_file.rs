//! What human models learned of one person, as files, and the one place that turns a kind and such a file into a model.
//!
//! `mirror` and `mirror-p`: implants ([`Posterior::save`]). `bc` and `sqil`: a policy's weights, in the metadata its kind, domain,
//! sizes and the command that made it, and, because these models are told what the person can perceive, the tensor `limits` with
//! their true sight.

use crate::file::{
    COMMAND, DOMAIN, HEARD, HOLDS, ModelFileError, POLICY, SIZES, expect, expect_domain, finite,
    heard,
};
use crate::human::{HumanModel, Kind};
use crate::implants::Posterior;
use crate::recurrent::{RecurrentHuman, RecurrentPolicy, RecurrentSizes};
use crate::self_human::SelfHuman;
use crate::self_model::SelfModel;
use domains::Layout;
use nn::checkpoint::{Checkpoint, CheckpointError, Extra};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use thiserror::Error;

/// Metadata key of the kind of human model.
const KIND: &str = "mirror.kind";
/// Tensor of what limits the person's sight, in the order of [`domains::Perception`].
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

/// A recurrent policy of one person, and what it is told of them.
#[derive(Clone, Debug)]
pub struct PersonalPolicy {
    /// The networks.
    pub policy: RecurrentPolicy,
    /// What limits the person's sight, in the order of [`domains::Perception`].
    pub limits: Vec<f32>,
    /// Utterances that the person hears without an assistant.
    pub heard: u32,
}

impl PersonalPolicy {
    /// Writes the policy, which is of `kind`; `command` is how it was made, `about` further metadata.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(
        &self,
        path: &Path,
        kind: Kind,
        layout: &Layout,
        command: &str,
        about: &[(&str, String)],
    ) -> Result<(), CheckpointError> {
        let sizes = serde_json::to_string(&self.policy.sizes).unwrap_or_default();
        let mut metadata = BTreeMap::from([
            (HOLDS.to_owned(), POLICY.to_owned()),
            (KIND.to_owned(), kind.name().to_owned()),
            (DOMAIN.to_owned(), layout.domain.to_owned()),
            (SIZES.to_owned(), sizes),
            (HEARD.to_owned(), self.heard.to_string()),
            (COMMAND.to_owned(), command.to_owned()),
        ]);
        metadata.extend(about.iter().map(|(k, v)| ((*k).to_owned(), v.clone())));
        let extras = [(LIMITS, Extra::F32(&self.limits))];
        let parameters = &self.policy.parameters;
        nn::checkpoint::save(path, &[("", parameters)], &extras, &metadata)
    }

    /// Reads a policy of `kind` in the domain of `layout`.
    ///
    /// # Errors
    /// If the file is missing, damaged, or holds something else.
    pub fn load(path: &Path, kind: Kind, layout: &Layout) -> Result<Self, ModelFileError> {
        Self::from_checkpoint(&nn::checkpoint::load(path)?, kind, layout)
    }

    /// The policy in a checkpoint.
    ///
    /// # Errors
    /// See [`Self::load`].
    pub fn from_checkpoint(
        checkpoint: &Checkpoint,
        kind: Kind,
        layout: &Layout,
    ) -> Result<Self, ModelFileError> {
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
        let sizes: RecurrentSizes = serde_json::from_str(checkpoint.metadata_value(SIZES)?)
            .map_err(|e| wrong(e.to_string()))?;
        if let Some(reason) = sizes.problem(layout) {
            return Err(wrong(reason));
        }
        // The first weights are thrown away: every parameter is read.
        let mut policy = RecurrentPolicy::new(sizes, layout, &mut ChaCha8Rng::seed_from_u64(0));
        checkpoint.read("", &mut policy.parameters)?;
        finite(&file, &policy.parameters)?;
        let limits = checkpoint.f32s(LIMITS)?;
        let expected = layout.perception.limits();
        let bad = |found: String| CheckpointError::Mismatch {
            file: file.clone(),
            name: LIMITS.to_owned(),
            expected: format!("{expected} limits of at least 0"),
            found,
        };
        if let Some(limit) = limits.iter().find(|limit| limit.is_nan() || **limit < 0.0) {
            return Err(bad(format!("{limit}")).into());
        }
        if limits.len() != expected {
            return Err(bad(format!("{} numbers", limits.len())).into());
        }
        Ok(Self {
            policy,
            limits,
            heard: heard(checkpoint, layout)?,
        })
    }

    /// As a human model.
    pub fn human(self, kind: Kind, layout: &Arc<Layout>) -> RecurrentHuman {
        RecurrentHuman::new(kind, Arc::new(self.policy), layout, self.limits, self.heard)
    }
}

/// A human model of `kind` on `model`, from the file of what was learned of the person; `self` takes none, and `ideal` is made
/// from the person ([`crate::IdealHuman`]). `self` sees everything and hears nobody but the assistant.
///
/// # Errors
/// If the file is missing, damaged, holds something else, or belongs to another self-model.
pub fn load_human(
    path: Option<&Path>,
    kind: Kind,
    model: &Arc<SelfModel>,
) -> Result<Box<dyn HumanModel>, HumanError> {
    let path = match (path, kind) {
        (None, Kind::Myself) => {
            let human = SelfHuman::new(Arc::clone(model), None, 0);
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
        let person = PersonalPolicy::load(path, kind, &model.layout)?;
        return Ok(Box::new(person.human(kind, &model.layout)));
    }
    let (posterior, heard) = Posterior::load(path, model)?;
    let with_policy = posterior.has_policy();
    if with_policy != (kind == Kind::Mirror) {
        return Err(HumanError::OtherImplants {
            file: path.to_owned(),
            with_policy,
            kind,
        });
    }
    let human = SelfHuman::new(Arc::clone(model), Some(posterior), heard);
    Ok(Box::new(human))
}
