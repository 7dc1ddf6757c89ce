//! The self-models that ship, inside the program: it works wherever it is moved to, and a recording that names one of
//! them can be replayed on any machine.
//!
//! A path of the form `shipped:NAME` stands for one, wherever the path of a self-model is expected.

use nn::checkpoint::{Checkpoint, CheckpointError};
use std::path::{Path, PathBuf};

/// The highway's self-model.
pub const HIGHWAY: &str = "highway-self.safetensors";
/// Gridworld driving's.
pub const DRIVING: &str = "driving-self.safetensors";
/// Search and rescue's.
pub const SEARCH_RESCUE: &str = "search-rescue-self.safetensors";
/// Bomb defusal's.
pub const BOMB_DEFUSAL: &str = "bomb-defusal-self.safetensors";

const SCHEME: &str = "shipped:";

macro_rules! files {
    ($($name:ident $file:literal),*) => {
        [$(($name, include_bytes!(concat!("../../pretrained/", $file)).as_slice()),)*]
    };
}

const FILES: [(&str, &[u8]); 4] = files!(
    HIGHWAY "highway-self.safetensors",
    DRIVING "driving-self.safetensors",
    SEARCH_RESCUE "search-rescue-self.safetensors",
    BOMB_DEFUSAL "bomb-defusal-self.safetensors"
);

/// The path that stands for one of them.
pub fn path(name: &str) -> PathBuf {
    PathBuf::from(format!("{SCHEME}{name}"))
}

/// Whether a path stands for something that ships, rather than for a file.
pub fn is_name(path: &Path) -> bool {
    path.to_str().is_some_and(|path| path.starts_with(SCHEME))
}

/// What a path stands for, if it is one of them.
pub fn bytes(path: &Path) -> Option<&'static [u8]> {
    let name = path.to_str()?.strip_prefix(SCHEME)?;
    let found = FILES.iter().find(|(known, _)| *known == name);
    found.map(|(_, bytes)| *bytes)
}

/// Reads a self-model's checkpoint: a file, or one that ships.
pub(crate) fn load(path: &Path) -> Result<Checkpoint, CheckpointError> {
    match bytes(path) {
        Some(bytes) => Checkpoint::from_bytes(&path.display().to_string(), bytes),
        None => nn::checkpoint::load(path),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_ships_is_found_by_name_and_nothing_else_is() {
        for (name, bytes) in FILES {
            assert_eq!(super::bytes(&path(name)), Some(bytes));
            load(&path(name)).expect("a checkpoint");
        }
        assert!(super::bytes(Path::new(HIGHWAY)).is_none());
        let error = load(&path("nobody.safetensors")).expect_err("there is none");
        assert!(error.to_string().contains("shipped:nobody"), "{error}");
    }
}
