//! What a run was and what it was set up from, kept in its recording so that the recording can be replayed from nothing
//! else: every process's options, the model files with their digests, and what was learned of the person, as an
//! attachment.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// Version of [`Setup`]'s JSON.
pub const SCHEMA: u32 = 1;
/// Name of the metadata record that opens a recording.
pub const METADATA: &str = "mirror.setup";
/// Its key that holds a [`Setup`] as JSON.
pub const KEY: &str = "setup";
/// Its key that holds the run's identity.
pub const RUN_ID: &str = "run_id";

/// What a run was set up from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Setup {
    /// [`SCHEMA`]; 0 where nobody filled this in.
    pub schema: u32,
    /// `lockstep` or `realtime`.
    pub clock: String,
    /// Who drove, as on the command line.
    pub driver: String,
    /// Every process's options (scene, seed, planner's settings …), by process.
    pub options: BTreeMap<String, serde_json::Value>,
    /// Model files that the options name, by what they hold, such as `self-model`.
    pub files: BTreeMap<String, ModelFile>,
    /// Other programs that stood in for our processes: their command lines, by process.
    pub exec: BTreeMap<String, String>,
}

/// A model file at the time of the recording.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ModelFile {
    /// Where it lay.
    pub path: PathBuf,
    /// BLAKE3 of its bytes, as 64 hexadecimal digits.
    pub blake3: String,
    /// Whether its bytes are attached to the recording, under the name by which [`Setup::files`] knows it.
    pub attached: bool,
}

impl ModelFile {
    /// Takes down a file's digest.
    ///
    /// # Errors
    /// The system's, with the file's name.
    pub fn identify(path: &Path, attached: bool) -> io::Result<Self> {
        Ok(Self {
            path: path.to_owned(),
            blake3: digest(path)?,
            attached,
        })
    }
}

/// What a recording is of; part of the metadata at its head and at its end.
#[derive(Clone, Debug, Default, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub struct About {
    /// Scene name or file.
    pub scene: String,
    /// Kind of human model.
    pub human: String,
    /// Kind of planner.
    pub planner: String,
    /// Seed of the run.
    pub seed: u64,
    /// Identity of the run, as in every message's header.
    pub run_id: u64,
    /// Version of MIRROR.
    pub version: String,
    /// Length of a step in nanoseconds; 0 for unknown.
    pub step_ns: u64,
    /// What a replay needs; at the head only.
    pub setup: Setup,
}

impl About {
    /// The same as a metadata record's entries.
    pub fn entries(&self) -> BTreeMap<String, String> {
        BTreeMap::from([
            ("scene".to_owned(), self.scene.clone()),
            ("human".to_owned(), self.human.clone()),
            ("planner".to_owned(), self.planner.clone()),
            ("seed".to_owned(), self.seed.to_string()),
            (RUN_ID.to_owned(), self.run_id.to_string()),
            ("version".to_owned(), self.version.clone()),
            ("step_ns".to_owned(), self.step_ns.to_string()),
        ])
    }
}

/// BLAKE3 of a file's bytes, as 64 hexadecimal digits.
///
/// # Errors
/// The system's, with the file's name.
pub fn digest(path: &Path) -> io::Result<String> {
    let named =
        |error: io::Error| io::Error::new(error.kind(), format!("{}: {error}", path.display()));
    let mut hasher = blake3::Hasher::new();
    io::copy(&mut File::open(path).map_err(named)?, &mut hasher).map_err(named)?;
    Ok(hasher.finalize().to_hex().to_string())
}
