//! Where a recorder writes: `drive.mcap`, or behind a recorder of the same run that was killed or replaced,
//! `drive.part2.mcap`, `drive.part3.mcap` …
//!
//! A part belongs to a run if the run's identity stands at its head. What a restarted recorder finds of its own run it
//! leaves as it is and goes on in the next part; what it finds of another run it overwrites, as a first recorder does.

use crate::read::run_of;
use std::path::{Path, PathBuf};

/// The path of a part, counted from 1: the first is the recording's own path.
pub fn part_path(path: &Path, part: usize) -> PathBuf {
    if part <= 1 {
        return path.to_owned();
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let name = match path.extension() {
        Some(extension) => format!("{stem}.part{part}.{}", extension.to_string_lossy()),
        None => format!("{stem}.part{part}"),
    };
    path.with_file_name(name)
}

/// The parts of a run's recording that there are, in order.
pub fn parts_of(path: &Path, run_id: u64) -> Vec<PathBuf> {
    (1..)
        .map(|part| part_path(path, part))
        .take_while(|part| run_of(part) == Some(run_id))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_is_named_after_the_first() {
        let path = |part| part_path(Path::new("/tmp/a.b/drive.mcap"), part);
        assert_eq!(path(1), Path::new("/tmp/a.b/drive.mcap"));
        assert_eq!(path(2), Path::new("/tmp/a.b/drive.part2.mcap"));
        assert_eq!(part_path(Path::new("drive"), 3), Path::new("drive.part3"));
    }

    #[test]
    fn nothing_is_no_part() {
        assert!(parts_of(Path::new("/nowhere/drive.mcap"), 1).is_empty());
    }
}
