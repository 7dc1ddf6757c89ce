//! `mirror messages`: the messages' definitions as a ROS 2 interface package.

use crate::cli::MessagesArguments;
use crate::failure::Failure;
use anyhow::{Context, Result, ensure};
use std::fs;
use std::path::Path;
use std::process::ExitCode;

/// What tells a package of ours from anybody's folder.
const NAME: &str = "<name>mirror_msgs</name>";

/// Runs `mirror messages`.
pub fn write(arguments: &MessagesArguments) -> Result<ExitCode, Failure> {
    let out = &arguments.out;
    check(out).map_err(Failure::refused)?;
    let files = messages::ros_package();
    for (path, text) in &files {
        let path = out.join(path);
        let folder = path.parent().unwrap_or(out);
        fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        fs::write(&path, text).with_context(|| path.display().to_string())?;
    }
    let interfaces = files.iter().filter(|(path, _)| path.ends_with(".msg"));
    println!(
        "{}: ROS 2 package mirror_msgs with {} messages",
        out.display(),
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
