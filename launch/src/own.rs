//! Starting this program once more.

use nn::vectors::{self, Vectors};
use std::os::unix::process::CommandExt;
use std::process::Command;

/// This very program, computing with the vectors that this process was told to compute with.
pub fn command() -> Command {
    // Not the path, which may by now hold another build, whose messages may differ.
    let mut command = Command::new("/proc/self/exe");
    command.arg0("mirror");
    let chosen = vectors::chosen();
    if chosen != Vectors::Widest {
        command.arg("--vectors").arg(chosen.to_string());
    }
    command
}
