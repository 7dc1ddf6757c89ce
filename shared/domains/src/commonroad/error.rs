//! What can be wrong with a CommonRoad file, with the file, the line and the element's name.

use std::path::Path;

/// Why a scenario was refused.
#[derive(Debug, thiserror::Error)]
pub enum CommonRoadError {
    /// The file could not be opened or read.
    #[error("{file}: cannot be read: {source}")]
    Io {
        /// The file.
        file: String,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// The file is larger than any scenario is.
    #[error("{file}: {bytes} bytes are too many for a scenario (limit {limit})")]
    TooLarge {
        /// The file.
        file: String,
        /// Its size.
        bytes: u64,
        /// The largest size that is read.
        limit: u64,
    },
    /// Not UTF-8.
    #[error("{file}:{line}: byte {offset} is not UTF-8")]
    Encoding {
        /// The file.
        file: String,
        /// Line, from 1.
        line: usize,
        /// Bytes before the first that does not fit.
        offset: usize,
    },
    /// Not well-formed XML: cut off, or not XML at all.
    #[error("{file}:{line}: not well-formed XML: {reason}")]
    Xml {
        /// The file.
        file: String,
        /// Line, from 1.
        line: usize,
        /// What the XML parser said.
        reason: String,
    },
    /// A format version that is not read.
    #[error("{file}:{line}: <commonRoad>: format version {version:?} is not read, only {}", READ_VERSIONS.join(", "))]
    Version {
        /// The file.
        file: String,
        /// Line, from 1.
        line: usize,
        /// The version that the file states; empty where it states none.
        version: String,
    },
    /// An element that is missing, malformed, contradictory or not supported.
    #[error("{file}:{line}: <{element}>: {problem}")]
    Element {
        /// The file.
        file: String,
        /// Line of the element's start, from 1.
        line: usize,
        /// The element's name.
        element: String,
        /// What is wrong with it.
        problem: String,
    },
    /// A well-formed scenario that cannot be driven: no planning problem, no lanelets, no such car.
    #[error("{file}: {problem}")]
    Scenario {
        /// The file.
        file: String,
        /// What is missing.
        problem: String,
    },
}

/// The format versions that are read.
pub const READ_VERSIONS: [&str; 3] = ["2018a", "2018b", "2020a"];

/// A path as error messages show it.
pub(crate) fn name_of(path: &Path) -> String {
    path.display().to_string()
}
