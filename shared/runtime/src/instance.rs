//! Instances: named process sets that never meet, and removing what a killed one left.
//!
//! An instance lives in `<root>/<name>/` (iceoryx2's nodes, services and sockets, and the arguments of its processes),
//! in files of `/dev/shm` that start with a prefix derived from root and name (the messages), and in
//! `<root>/<name>.lock`, which its launcher holds locked: the kernel releases it however the launcher ends. The lock
//! file itself stays. Where the usual root is, [`root_for`] says. Root and directories are this user's alone, or they
//! are not used.

use crate::error::InstanceError;
use crate::service::Ipc;
use crate::{orphans, private};
use iceoryx2::config::Config;
use iceoryx2::node::{NodeState, NodeView};
use iceoryx2::prelude::{
    CallbackProgression, FileName, LogLevel, Path as IoxPath, SemanticString, set_log_level,
};
use rustix::fs::OFlags;
use std::fs::File;
use std::io::{Read, Seek, Write};
use std::os::fd::{AsRawFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

pub use crate::roots::{lookup_roots, root_for, root_of};

/// Longest path of a Unix socket, without its terminating zero.
const SOCKET_PATH: usize = 107;
/// How long a start waits for somebody who just cleans up.
const CLEANING: Duration = Duration::from_secs(5);

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

/// Opens the file that a launcher holds locked; none if it is not there and shall not be made.
fn lock_file(
    root: &OwnedFd,
    path: &Path,
    instance: &str,
    flags: OFlags,
) -> Result<Option<File>, InstanceError> {
    let name = format!("{instance}.lock");
    private::file(root, &name, &path.join(&name), flags)
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

/// A write lock on a whole file that belongs to the open file, not to the process, and goes with it.
fn whole_file_lock() -> libc::flock {
    // SAFETY: a plain C structure for which all zeros is a value.
    let mut lock: libc::flock = unsafe { core::mem::zeroed() };
    lock.l_type = libc::F_WRLCK as libc::c_short;
    lock.l_whence = libc::SEEK_SET as libc::c_short;
    lock
}

/// Whether a launcher holds the instance. Asking takes no lock itself, so it disturbs nobody who wants it.
pub(crate) fn is_locked(root: &Path, instance: &str) -> bool {
    matches!(held(root, instance), Ok(Some(_)))
}

/// The file of an instance that somebody holds locked.
fn held(root: &Path, instance: &str) -> Result<Option<File>, InstanceError> {
    let Some(directory) = private::open(root)? else {
        return Ok(None);
    };
    let file = lock_file(&directory, root, instance, OFlags::RDONLY)?;
    Ok(file.filter(|file| {
        let mut lock = whole_file_lock();
        // SAFETY: a live descriptor and a live structure.
        let asked = unsafe { libc::fcntl(file.as_raw_fd(), libc::F_OFD_GETLK, &mut lock) };
        asked == 0 && lock.l_type != libc::F_UNLCK as libc::c_short
    }))
}

/// Process id of the launcher that holds the instance, if one does; 0 if it does not say.
pub fn launcher(root: &Path, instance: &str) -> Option<u32> {
    let mut file = held(root, instance).ok()??;
    let mut text = String::new();
    let _ = file.read_to_string(&mut text);
    Some(text.trim().parse().unwrap_or(0))
}

/// Takes the lock of an instance, and makes its root where there is none. If somebody else has it: their process id, or
/// 0 if they do not say.
fn try_lock(root: &Path, instance: &str) -> Result<Result<File, u32>, InstanceError> {
    let path = root.join(format!("{instance}.lock"));
    let io = |source| InstanceError::Io {
        path: path.clone(),
        source,
    };
    let directory = private::create(root)?;
    let made = lock_file(&directory, root, instance, OFlags::RDWR | OFlags::CREATE)?;
    let Some(mut file) = made else {
        return Err(io(std::io::ErrorKind::NotFound.into()));
    };
    // SAFETY: a live descriptor and a live structure.
    if unsafe { libc::fcntl(file.as_raw_fd(), libc::F_OFD_SETLK, &whole_file_lock()) } != 0 {
        let source = std::io::Error::last_os_error();
        if source.kind() != std::io::ErrorKind::WouldBlock {
            return Err(io(source));
        }
        let mut text = String::new();
        let _ = file.read_to_string(&mut text);
        return Ok(Err(text.trim().parse().unwrap_or(0)));
    }
    file.set_len(0).map_err(io)?;
    Ok(Ok(file))
}

/// A launcher's hold on an instance; released when dropped, or by the kernel when the launcher ends in any way.
#[derive(Debug)]
pub struct InstanceLock {
    root: PathBuf,
    instance: String,
    _file: File,
}

impl InstanceLock {
    /// Takes an instance where [`root_for`] puts it, unless one of that name runs in another of this user's roots.
    ///
    /// # Errors
    /// As [`InstanceLock::acquire`].
    pub fn take(instance: &str) -> Result<Self, InstanceError> {
        check_name(instance)?;
        let root = root_for(instance);
        for other in lookup_roots().iter().filter(|other| **other != root) {
            if let Some(pid) = launcher(other, instance) {
                let instance = instance.to_owned();
                return Err(InstanceError::InUse { instance, pid });
            }
        }
        Self::acquire(&root, instance)
    }

    /// Takes the instance, and removes what an earlier run of it left: processes that outlived their launcher get a
    /// second to end and are then killed.
    ///
    /// # Errors [`InstanceError::InUse`] while another launcher lives, [`InstanceError::Untrusted`] where others could
    /// reach into it.
    pub fn acquire(root: &Path, instance: &str) -> Result<Self, InstanceError> {
        check_name(instance)?;
        config(root, instance)?;
        let end = Instant::now() + CLEANING;
        let mut file = loop {
            match try_lock(root, instance)? {
                Ok(file) => break file,
                // Who holds it without a word is removing what a dead run left.
                Err(0) if Instant::now() < end => std::thread::sleep(Duration::from_millis(5)),
                Err(pid) => {
                    let instance = instance.to_owned();
                    return Err(InstanceError::InUse { instance, pid });
                }
            }
        };
        let written = file
            .rewind()
            .and_then(|()| writeln!(file, "{}", std::process::id()));
        written.map_err(|source| InstanceError::Io {
            path: root.join(format!("{instance}.lock")),
            source,
        })?;
        orphans::end(root, instance)?;
        remove_everything(root, instance)?;
        private::check_shared(&prefix(root, instance))?;
        private::create(&directory(root, instance))?;
        Ok(Self {
            root: root.to_owned(),
            instance: instance.to_owned(),
            _file: file,
        })
    }

    /// The root.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The instance.
    pub fn instance(&self) -> &str {
        &self.instance
    }
}

impl Drop for InstanceLock {
    fn drop(&mut self) {
        // With processes still alive in it, the next `acquire` or `cleanup_dead` finishes the work.
        if let Ok(nodes) = nodes(&self.root, &self.instance)
            && !nodes
                .iter()
                .any(|node| node.alive && node.pid != std::process::id())
        {
            let _ = remove_everything(&self.root, &self.instance);
        }
    }
}

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

fn remove_everything(root: &Path, instance: &str) -> Result<u64, InstanceError> {
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
