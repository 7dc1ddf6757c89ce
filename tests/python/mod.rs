//! A Python with what a test needs of it: `MIRROR_PYTHON`, `python3`, or an environment made for the tests, into which
//! the packages are installed from PyPI.
#![allow(dead_code)] // Each test program uses its own part.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// One that reads recordings; none where no such Python can be had.
pub fn python() -> Option<&'static PathBuf> {
    static FOUND: OnceLock<Option<PathBuf>> = OnceLock::new();
    let packages = ["mcap>=1.2", "mcap-ros2-support>=0.5"];
    let find = || find("python", &packages, "import mcap.reader, mcap_ros2.decoder");
    FOUND.get_or_init(find).as_ref()
}

/// One that checks recordings: with `rosbags`, and with the program `rerun` beside it.
pub fn python_with_rosbags() -> Option<&'static PathBuf> {
    static FOUND: OnceLock<Option<PathBuf>> = OnceLock::new();
    let packages = ["rosbags>=0.10.6", "rerun-sdk>=0.41"];
    let needs = "import rerun, rosbags.highlevel, sys, pathlib; assert pathlib.Path(sys.executable).with_name('rerun').exists()";
    FOUND
        .get_or_init(|| find("python-rosbags", &packages, needs))
        .as_ref()
}

/// One that can be a process of a set; none where no such Python can be had.
pub fn python_with_iceoryx2() -> Option<&'static PathBuf> {
    static FOUND: OnceLock<Option<PathBuf>> = OnceLock::new();
    let packages = ["iceoryx2==0.10.*", "numpy>=1.23"];
    let needs = "import iceoryx2, numpy; iceoryx2.AttributeVerifier.new()";
    FOUND
        .get_or_init(|| find("python-iceoryx2", &packages, needs))
        .as_ref()
}

fn find(environment: &str, packages: &[&str], needs: &str) -> Option<PathBuf> {
    testing::python(
        Path::new(env!("CARGO_TARGET_TMPDIR")),
        environment,
        packages,
        needs,
    )
}
