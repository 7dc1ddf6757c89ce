//! What tests of several crates need: directories of their own, a test program that also stands in for a process of a
//! set ([`stand_in!`]), and what the machine has to offer beside a Rust toolchain.
//!
//! A test that cannot run here calls [`skipped`] and returns. The line that it writes is seen although the test passes,
//! so that `.ci/run` counts and names all of them at its end. With `MIRROR_REQUIRE=all` in the environment a test that
//! would be skipped fails instead.

mod stand_in;

pub use stand_in::{Stander, run};

use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

/// A directory that is this user's alone, as roots of instances have to be; it goes with the value.
///
/// # Panics
/// If it cannot be made.
pub fn private_directory() -> TempDir {
    // Below /tmp whatever `TMPDIR` says: the paths of sockets in it must not be long.
    let made = tempfile::Builder::new()
        .permissions(std::fs::Permissions::from_mode(0o700))
        .tempdir_in("/tmp");
    made.expect("a directory below /tmp")
}

/// Says that `test` is skipped here, and why.
///
/// # Panics
/// If `MIRROR_REQUIRE` is `all`.
pub fn skipped(test: &str, why: &str) {
    let required = std::env::var_os("MIRROR_REQUIRE").is_some_and(|value| value == "all");
    assert!(
        !required,
        "MIRROR_REQUIRE=all, and {test} cannot run: {why}"
    );
    // Not by `eprintln!`, whose text is seen of failed tests alone; and as one write, so that lines stay whole.
    let line = format!("skipped: {test}: {why}\n");
    let _ = std::io::stderr().write_all(line.as_bytes());
}

/// A Python in which `needs` runs: the one that `MIRROR_PYTHON` names, `python3`, or one in an environment called
/// `name` below `directory`, into which `packages` are installed from PyPI. None where there is no such Python to be
/// had.
pub fn python(directory: &Path, name: &str, packages: &[&str], needs: &str) -> Option<PathBuf> {
    let done = |command: &mut Command| command.output().is_ok_and(|o| o.status.success());
    let serves = |python: &Path| done(Command::new(python).args(["-c", needs]));
    let given = std::env::var_os("MIRROR_PYTHON").map(PathBuf::from);
    let made = directory.join(name);
    let inside = made.join("bin/python3");
    let candidates = [given, Some(PathBuf::from("python3")), Some(inside.clone())];
    if let Some(python) = candidates.into_iter().flatten().find(|p| serves(p)) {
        return Some(python);
    }
    let installed = done(Command::new("python3").args(["-m", "venv"]).arg(&made))
        && done(
            Command::new(&inside)
                .args(["-m", "pip", "install", "--quiet", "--timeout", "20"])
                .args(packages),
        );
    (installed && serves(&inside)).then_some(inside)
}
