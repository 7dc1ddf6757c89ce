//! Scenarios for tests: small ones made for them, and the real recordings where they are.
#![allow(dead_code, reason = "every test file uses a part")]

use std::path::{Path, PathBuf};

/// Two lanes, a car that accelerates, a lorry that comes and goes, a parked car; format 2020a.
pub const FIXTURE_2020A: &str = include_str!("2020a.xml");
/// Two lanes, a car, one that turns over π, a construction zone; positions and speeds as intervals; format 2018b.
pub const FIXTURE_2018B: &str = include_str!("2018b.xml");

/// The real recordings beside the project; says so where they are not.
pub fn real_files() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/commonroad");
    let names = [
        "USA_US101-4_1_T-1.xml",
        "USA_US101-3_3_T-1.xml",
        "DEU_A9-3_1_T-1.xml",
    ];
    let files: Vec<PathBuf> = names
        .iter()
        .map(|name| folder.join(name))
        .filter(|file| file.is_file())
        .collect();
    if files.len() < names.len() {
        let missing = names.len() - files.len();
        let why = format!(
            "{missing} of {} are not in {}",
            names.len(),
            folder.display()
        );
        testing::skipped("what is asked of real recordings", &why);
    }
    files
}

/// Fifteen recordings of three roads beside the project; says so where they are not.
pub fn ngsim_files() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/ngsim");
    let mut files: Vec<PathBuf> = std::fs::read_dir(&folder)
        .map(|entries| {
            entries
                .filter_map(|entry| Some(entry.ok()?.path()))
                .collect()
        })
        .unwrap_or_default();
    files.retain(|file| file.extension().is_some_and(|extension| extension == "xml"));
    files.sort();
    if files.is_empty() {
        let why = format!("there is none in {}", folder.display());
        testing::skipped("what is asked of fifteen real recordings", &why);
    }
    files
}
