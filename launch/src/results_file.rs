//! The file that a study writes its section into.

use std::path::{Path, PathBuf};

/// The given file, or else `RESULTS.md` in the study's folder.
pub fn results_file(given: Option<&Path>, out: &Path) -> PathBuf {
    given.map_or_else(|| out.join("RESULTS.md"), Path::to_owned)
}
