//! A Python that reads recordings: `MIRROR_PYTHON`, `python3`, or an environment made for the tests.

use std::path::{Path, PathBuf};
use std::process::Command;

const PACKAGES: [&str; 2] = ["mcap>=1.2", "mcap-ros2-support>=0.5"];

/// Its path; none where no such Python can be had.
pub fn python() -> Option<PathBuf> {
    let given = std::env::var_os("MIRROR_PYTHON").map(PathBuf::from);
    let made = Path::new(env!("CARGO_TARGET_TMPDIR")).join("python");
    let inside = made.join("bin/python3");
    let candidates = [given, Some(PathBuf::from("python3")), Some(inside.clone())];
    if let Some(python) = candidates.into_iter().flatten().find(|p| can_read(p)) {
        return Some(python);
    }
    let done = |command: &mut Command| command.output().is_ok_and(|o| o.status.success());
    let installed = done(Command::new("python3").args(["-m", "venv"]).arg(&made))
        && done(
            Command::new(&inside)
                .args(["-m", "pip", "install", "--quiet", "--timeout", "20"])
                .args(PACKAGES),
        );
    (installed && can_read(&inside)).then_some(inside)
}

fn can_read(python: &Path) -> bool {
    Command::new(python)
        .args(["-c", "import mcap.reader, mcap_ros2.decoder"])
        .output()
        .is_ok_and(|output| output.status.success())
}
