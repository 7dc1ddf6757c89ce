//! What is in an instance, and removing what dead processes left there.

use crate::error::InstanceError;
use crate::held::{launcher, try_lock};
use crate::paths::{check_name, config, directory, prefix};
use crate::transport::Ipc;
use crate::{orphans, private};
use iceoryx2::node::{NodeState, NodeView};
use iceoryx2::prelude::CallbackProgression;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// A process that has, or had, a node in an instance.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeEntry {
    /// The process's name.
    pub process: String,
    /// Its process id; 0 if its details were lost.
    pub pid: u32,
    /// Whether it lives.
    pub alive: bool,
}

/// The nodes of an instance.
///
/// # Errors
/// [`InstanceError::Nodes`].
pub fn nodes(root: &Path, instance: &str) -> Result<Vec<NodeEntry>, InstanceError> {
    let config = config(root, instance)?;
    let mut found = Vec::new();
    if !directory(root, instance).is_dir() {
        return Ok(found);
    }
    let mut entry = |details: &Option<iceoryx2::node::NodeDetails>, alive| {
        found.push(NodeEntry {
            process: details
                .as_ref()
                .map(|details| details.name().to_string())
                .unwrap_or_default(),
            pid: details
                .as_ref()
                .map_or(0, |details| details.process_id().value() as u32),
            alive,
        });
    };
    iceoryx2::node::Node::<Ipc>::list(&config, |state| {
        match &state {
            NodeState::Alive(view) => entry(view.details(), true),
            NodeState::Dead(view) => entry(view.details(), false),
            NodeState::Inaccessible(_) | NodeState::Undefined(_) => entry(&None, false),
        }
        CallbackProgression::Continue
    })
    .map_err(|error| InstanceError::Nodes {
        instance: instance.to_owned(),
        reason: format!("{error:?}"),
    })?;
    Ok(found)
}

/// What [`cleanup_dead`] removed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CleanupReport {
    /// Dead processes whose ports and connections were removed.
    pub nodes: u64,
    /// Dead processes that could not be cleaned up.
    pub failed: u64,
    /// Files in shared memory that belonged to nobody any more.
    pub files: u64,
}

/// Removes what dead processes left in an instance. In a running one these are their nodes, ports and connections; in
/// one without a launcher everything, after ending what still lives there.
///
/// # Errors
/// [`InstanceError`].
pub fn cleanup_dead(root: &Path, instance: &str) -> Result<CleanupReport, InstanceError> {
    check_name(instance)?;
    if private::open(root)?.is_none() {
        return Ok(CleanupReport::default());
    }
    // Held meanwhile, so that nobody starts in what is being removed.
    let Ok(_lock) = try_lock(root, instance)? else {
        return clean_nodes(root, instance);
    };
    orphans::end(root, instance)?;
    let mut report = clean_nodes(root, instance)?;
    report.files = remove_everything(root, instance)?;
    Ok(report)
}

/// Removes the nodes of dead processes: also called by the launcher when a child has died.
pub(crate) fn clean_nodes(root: &Path, instance: &str) -> Result<CleanupReport, InstanceError> {
    let mut report = CleanupReport::default();
    if !directory(root, instance).is_dir() {
        return Ok(report);
    }
    let config = config(root, instance)?;
    iceoryx2::node::Node::<Ipc>::list(&config, |state| {
        if let NodeState::Dead(dead) = state {
            match dead.blocking_remove_stale_resources(Duration::from_millis(500)) {
                Ok(()) => report.nodes += 1,
                Err(_) => report.failed += 1,
            }
        }
        CallbackProgression::Continue
    })
    .map_err(|error| InstanceError::Nodes {
        instance: instance.to_owned(),
        reason: format!("{error:?}"),
    })?;
    Ok(report)
}

/// Removes an instance's files; how many of them lay in shared memory.
pub(crate) fn remove_everything(root: &Path, instance: &str) -> Result<u64, InstanceError> {
    let prefix = prefix(root, instance);
    let files = private::remove_shared(&prefix);
    private::remove(root, instance, &prefix)?;
    Ok(files)
}

/// Takes from other users what rights they have to an instance's shared memory, and refuses what somebody else put
/// there. For after a process has joined: before, its files are not there.
///
/// # Errors
/// [`InstanceError::Untrusted`].
pub(crate) fn close_to_others(root: &Path, instance: &str) -> Result<(), InstanceError> {
    let prefix = prefix(root, instance);
    private::close_shared(&prefix);
    private::check_shared(&prefix)
}

/// An instance as `mirror doctor` shows it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InstanceState {
    /// The root that it is in.
    pub root: PathBuf,
    /// Its name.
    pub instance: String,
    /// Its launcher's process id, if one lives.
    pub launcher: Option<u32>,
    /// Its processes.
    pub nodes: Vec<NodeEntry>,
    /// Its files in shared memory.
    pub shared_files: usize,
}

/// All instances below `root` that run or that left something.
///
/// # Errors
/// [`InstanceError`].
pub fn list_instances(root: &Path) -> Result<Vec<InstanceState>, InstanceError> {
    let mut names = std::collections::BTreeSet::new();
    private::open(root)?;
    let entries = match std::fs::read_dir(root) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(source) => {
            return Err(InstanceError::Io {
                path: root.to_owned(),
                source,
            });
        }
    };
    for entry in entries.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let name = name.strip_suffix(".lock").unwrap_or(&name);
        if check_name(name).is_ok() {
            names.insert(name.to_owned());
        }
    }
    let mut states = Vec::new();
    for instance in names {
        let launcher = launcher(root, &instance);
        let nodes = nodes(root, &instance)?;
        let shared_files = private::shared_files(&prefix(root, &instance)).ours.len();
        if launcher.is_some() || !nodes.is_empty() || shared_files > 0 {
            states.push(InstanceState {
                root: root.to_owned(),
                instance,
                launcher,
                nodes,
                shared_files,
            });
        }
    }
    Ok(states)
}
