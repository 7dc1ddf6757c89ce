//! Where an instance's files are, and iceoryx2's configuration that puts them there.

use crate::error::InstanceError;
use crate::private;
use iceoryx2::config::Config;
use iceoryx2::prelude::{FileName, LogLevel, Path as IoxPath, SemanticString, set_log_level};
use std::path::{Path, PathBuf};

/// Longest path of a Unix socket, without its terminating zero.
const SOCKET_PATH: usize = 107;

/// Whether an instance can have this name.
///
/// # Errors
/// [`InstanceError::Name`].
pub(crate) fn check_name(name: &str) -> Result<(), InstanceError> {
    // What begins with a dash is an option to every command.
    let fits = (1..=32).contains(&name.len())
        && !name.starts_with('-')
        && name
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_');
    if fits {
        Ok(())
    } else {
        Err(InstanceError::Name {
            name: name.to_owned(),
        })
    }
}

/// Directory of an instance.
pub fn directory(root: &Path, instance: &str) -> PathBuf {
    root.join(instance)
}

/// The start of all of an instance's file names in shared memory.
pub fn prefix(root: &Path, instance: &str) -> String {
    let place = format!("{}\n{instance}", root.display());
    format!("m{:08x}_", messages::layout_hash(&place) >> 32)
}

/// Whether the sockets of an instance have room for their paths. A listener's is `<directory>/<prefix><up to 39
/// digits>.event`.
pub(crate) fn fits(root: &Path, instance: &str) -> bool {
    let directory = directory(root, instance);
    let listener = "/".len() + prefix(root, instance).len() + 39 + ".event".len();
    directory.as_os_str().len() + listener <= SOCKET_PATH
}

/// iceoryx2's configuration for an instance: its own root path and its own prefix.
///
/// # Errors
/// [`InstanceError::Root`], and [`InstanceError::Untrusted`] if its directory is there and not this user's alone.
pub(crate) fn config(root: &Path, instance: &str) -> Result<Config, InstanceError> {
    set_log_level(LogLevel::Error);
    let directory = directory(root, instance);
    let bad = |reason: &str| InstanceError::Root {
        path: root.to_owned(),
        reason: reason.to_owned(),
    };
    if !root.is_absolute() {
        return Err(bad("it is not an absolute path"));
    }
    let text = directory.to_str().ok_or_else(|| bad("it is not UTF-8"))?;
    let prefix = prefix(root, instance);
    if !fits(root, instance) {
        return Err(bad("it is too long for the sockets below it"));
    }
    if private::open(root)?.is_some() {
        private::open(&directory)?;
    }
    let mut config = Config::default();
    let path = IoxPath::new(text.as_bytes()).map_err(|error| bad(&format!("{error:?}")))?;
    config.global.set_root_path(&path);
    config.global.prefix =
        FileName::new(prefix.as_bytes()).map_err(|error| bad(&format!("{error:?}")))?;
    // The launcher cleans up, at moments of its own choosing: a scan costs milliseconds.
    config.global.node.cleanup_dead_nodes_on_creation = false;
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    config.global.service.cleanup_dead_nodes_on_open = false;
    Ok(config)
}
