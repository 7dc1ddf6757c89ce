//! `mirror messages`: the messages' definitions as a ROS 2 interface package.

use crate::cli::MessagesArguments;
use crate::console::out;
use crate::failure::Failure;
use anyhow::{Context, Result, ensure};
use std::fs;
use std::path::Path;
use std::process::ExitCode;

/// What tells a package of ours from anybody's folder.
const NAME: &str = "<name>mirror_msgs</name>";

/// Runs `mirror messages`.
pub fn write(arguments: &MessagesArguments) -> Result<ExitCode, Failure> {
    let folder = &arguments.out;
    check(folder).map_err(Failure::refused)?;
    let package = messages::ros_package();
    for (path, text) in &package {
        let path = folder.join(path);
        let above = path.parent().unwrap_or(folder);
        fs::create_dir_all(above).with_context(|| above.display().to_string())?;
        files::write(&path, text.as_bytes()).map_err(anyhow::Error::from)?;
    }
    let interfaces = package.iter().filter(|(path, _)| path.ends_with(".msg"));
    out!(
        "{}: ROS 2 package mirror_msgs with {} messages",
        folder.display(),
        interfaces.count()
    );
    Ok(ExitCode::SUCCESS)
}

/// A folder that is new, empty, or has such a package already.
fn check(out: &Path) -> Result<()> {
    if !out.exists() {
        return Ok(());
    }
    let name = || format!("--out {}", out.display());
    let mut entries = fs::read_dir(out).with_context(name)?;
    let is_ours = fs::read_to_string(out.join("package.xml")).is_ok_and(|text| text.contains(NAME));
    ensure!(
        entries.next().is_none() || is_ours,
        "{}: has files in it that are no package mirror_msgs",
        name()
    );
    Ok(())
}
