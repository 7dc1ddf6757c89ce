//! The recorded scene that ships, inside the program. Its file lies in `examples/commonroad`, with the program that
//! makes it.
//!
//! A path of the form `shipped:NAME.xml` stands for it, wherever the path of a CommonRoad file is expected.

use std::path::{Path, PathBuf};

/// Recorded scenes that ship with the project: name and contents.
const SCENES: [(&str, &str); 1] = [(
    "highway-recorded",
    include_str!("../../../../examples/commonroad/highway-recorded.xml"),
)];

/// Names of the recorded scenes that ship.
pub fn names() -> impl Iterator<Item = &'static str> {
    SCENES.iter().map(|(name, _)| *name)
}

/// The path that stands for the recorded scene of that name, if it ships.
pub fn path(name: &str) -> Option<PathBuf> {
    let found = names().find(|known| *known == name)?;
    Some(PathBuf::from(format!("shipped:{found}.xml")))
}

/// The text of the scene that a path stands for, if it stands for one that ships.
pub(super) fn text(path: &Path) -> Option<&'static str> {
    let name = path.to_str()?.strip_prefix("shipped:")?;
    let name = name.strip_suffix(".xml")?;
    let found = SCENES.iter().find(|(known, _)| *known == name)?;
    Some(found.1)
}
