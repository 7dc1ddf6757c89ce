//! Recurrent policies as files: safetensors with the networks' weights, what the person can see, and in the metadata the
//! kind, the sizes and the command that made them.

use crate::checkpoint::{COMMAND, HOLDS, ModelFileError, SIZES, expect, finite};
use crate::human::Kind;
use crate::observation::{AZIMUTHS, Shape};
use crate::recurrent::{RecurrentPolicy, RecurrentSizes};
use nn::checkpoint::{Checkpoint, CheckpointError, Extra};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::path::Path;

/// A recurrent policy, in the metadata's `mirror.holds`.
pub const POLICY: &str = "policy";
/// Metadata key of the kind of human model.
const KIND: &str = "mirror.kind";
/// Tensor of what the person can see of each azimuth, in metres.
const VISIBLE: &str = "visible_m";
/// Most neurons and layers that a file may claim.
const MOST: [usize; 2] = [1024, 8];

/// Writes a policy of `kind` for a person who sees `visible_m`; `command` is how it was made, `about` further metadata.
///
/// # Errors
/// If the file cannot be written.
pub fn save_policy(
    path: &Path,
    kind: Kind,
    policy: &RecurrentPolicy,
    visible_m: &[f32; AZIMUTHS],
    command: &str,
    about: &[(&str, String)],
) -> Result<(), CheckpointError> {
    let sizes = serde_json::to_string(&policy.sizes).unwrap_or_default();
    let mut metadata = BTreeMap::from([
        (HOLDS.to_owned(), POLICY.to_owned()),
        (KIND.to_owned(), kind.name().to_owned()),
        (SIZES.to_owned(), sizes),
        (COMMAND.to_owned(), command.to_owned()),
    ]);
    metadata.extend(about.iter().map(|(k, v)| ((*k).to_owned(), v.clone())));
    let extras = [(VISIBLE, Extra::F32(visible_m))];
    nn::checkpoint::save(path, &[("", &policy.parameters)], &extras, &metadata)
}

/// Reads a policy of `kind`, and what its person can see of each azimuth in metres.
///
/// # Errors
/// If the file is missing, damaged, or holds something else.
pub fn load_policy(
    path: &Path,
    kind: Kind,
) -> Result<(RecurrentPolicy, [f32; AZIMUTHS]), ModelFileError> {
    policy_from(&nn::checkpoint::load(path)?, kind)
}

/// The policy in a checkpoint.
///
/// # Errors
/// See [`load_policy`].
pub fn policy_from(
    checkpoint: &Checkpoint,
    kind: Kind,
) -> Result<(RecurrentPolicy, [f32; AZIMUTHS]), ModelFileError> {
    expect(checkpoint, POLICY)?;
    let file = checkpoint.file().to_owned();
    let found = checkpoint.metadata_value(KIND)?;
    if found != kind.name() {
        return Err(ModelFileError::Holds {
            file,
            found: format!("a policy of kind `{found}`"),
            expected: kind.name(),
        });
    }
    let sizes: RecurrentSizes =
        serde_json::from_str(checkpoint.metadata_value(SIZES)?).map_err(|e| {
            ModelFileError::Sizes {
                file: file.clone(),
                reason: e.to_string(),
            }
        })?;
    if sizes.shape != Shape::HIGHWAY
        || !(1..=MOST[0]).contains(&sizes.hidden)
        || !(1..=MOST[1]).contains(&sizes.layers)
    {
        let reason = format!("{sizes:?} is not a highway policy");
        return Err(ModelFileError::Sizes { file, reason });
    }
    // The first weights are thrown away: every parameter is read.
    let mut policy = RecurrentPolicy::new(sizes, &mut ChaCha8Rng::seed_from_u64(0));
    checkpoint.read("", &mut policy.parameters)?;
    finite(&file, &policy.parameters)?;
    let visible = checkpoint.f32s(VISIBLE)?;
    let bad = |found: String| CheckpointError::Mismatch {
        file: file.clone(),
        name: VISIBLE.to_owned(),
        expected: format!("{AZIMUTHS} distances of at least 0"),
        found,
    };
    if let Some(limit) = visible.iter().find(|limit| limit.is_nan() || **limit < 0.0) {
        return Err(bad(format!("{limit}")).into());
    }
    let visible: [f32; AZIMUTHS] = visible
        .try_into()
        .map_err(|other: Vec<f32>| bad(format!("{} numbers", other.len())))?;
    Ok((policy, visible))
}
