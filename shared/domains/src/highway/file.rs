//! Reading scene and person files: what can be wrong with them, and where.

use std::ops::Range;
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::road::RoadError;
use super::scene::BUILTIN;

/// Why a file could not be used; every variant names the file and, where there is one, the place in it.
#[derive(Debug, Error)]
pub enum FileError {
    /// The file could not be read.
    #[error("{file}: {source}")]
    Read {
        /// The file.
        file: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// Not TOML, not UTF-8, an unknown key, a missing key or a value of the wrong type.
    #[error("{file}:{line}:{column}: {message}")]
    Parse {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Column in characters, from 1.
        column: usize,
        /// What is wrong there.
        message: String,
    },
    /// A value outside its range.
    #[error("{file}: {key} is {value}, expected {expected}")]
    Range {
        /// The file.
        file: PathBuf,
        /// The key, as a dotted path.
        key: String,
        /// Its value.
        value: f64,
        /// What it may be.
        expected: String,
    },
    /// A road that cannot be built.
    #[error("{file}: [road]: {source}")]
    Road {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        source: RoadError,
    },
    /// A CommonRoad scenario that cannot be driven.
    #[error(transparent)]
    CommonRoad(#[from] crate::commonroad::CommonRoadError),
    /// No scene of that name ships with the project.
    #[error("no scene is called {name:?}; there are {}", scene_names())]
    Unknown {
        /// The name.
        name: String,
    },
}

/// Names of all scenes that ship, highway first.
fn scene_names() -> String {
    let recorded = crate::commonroad::shipped::names();
    let gridworlds = crate::discrete::Scene::names();
    let names: Vec<&str> = BUILTIN
        .iter()
        .map(|(name, _)| *name)
        .chain(recorded)
        .chain(gridworlds)
        .collect();
    names.join(", ")
}

/// Reads a whole file as TOML.
pub(crate) fn parse<T: serde::de::DeserializeOwned>(
    file: &Path,
    text: &str,
) -> Result<T, FileError> {
    toml::from_str(text).map_err(|error| {
        let (line, column) = position(text, error.span().unwrap_or(0..0));
        FileError::Parse {
            file: file.to_owned(),
            line,
            column,
            message: error.message().to_owned(),
        }
    })
}

/// Reads a file's text; bytes that are not UTF-8 are an error with their place.
pub(crate) fn read(file: &Path) -> Result<String, FileError> {
    let bytes = std::fs::read(file).map_err(|source| FileError::Read {
        file: file.to_owned(),
        source,
    })?;
    String::from_utf8(bytes).map_err(|error| {
        let valid = error.utf8_error().valid_up_to();
        let text = String::from_utf8_lossy(&error.as_bytes()[..valid]).into_owned();
        let (line, column) = position(&text, valid..valid);
        FileError::Parse {
            file: file.to_owned(),
            line,
            column,
            message: "not UTF-8 text".to_owned(),
        }
    })
}

fn position(text: &str, span: Range<usize>) -> (usize, usize) {
    let mut end = span.start.min(text.len());
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    let before = &text[..end];
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().unwrap_or("").chars().count() + 1;
    (line, column)
}

/// Checks numbers against ranges, remembering which file they stand in.
pub(crate) struct Check<'a> {
    pub(crate) file: &'a Path,
}

impl Check<'_> {
    pub(crate) fn range(
        &self,
        key: &str,
        value: f64,
        low: f64,
        high: f64,
    ) -> Result<(), FileError> {
        if value >= low && value <= high {
            return Ok(());
        }
        Err(FileError::Range {
            file: self.file.to_owned(),
            key: key.to_owned(),
            value,
            expected: format!("{low} to {high}"),
        })
    }
}
