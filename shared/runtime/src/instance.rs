//! Instances: named process sets that never meet, and removing what a killed one left.
//!
//! An instance lives in `<root>/<name>/` (iceoryx2's nodes, services and sockets, and the arguments of its processes), in
//! files of `/dev/shm` that start with a prefix derived from root and name (the messages), and in `<root>/<name>.lock`,
//! which its launcher holds locked: the kernel releases it however the launcher ends. The lock file itself
//! stays. The usual root is `/tmp/mirror-<uid>`.

use crate::error::InstanceError;
use crate::service::Ipc;
use iceoryx2::config::Config;
use iceoryx2::node::{NodeState, NodeView};
use iceoryx2::prelude::{
    CallbackProgression, FileName, LogLevel, Path as IoxPath, SemanticString, set_log_level,
};
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, Write};
use std::os::fd::AsRawFd;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Longest path of a Unix socket, without its terminating zero.
const SOCKET_PATH: usize = 107;
const SHARED_MEMORY: &str = "/dev/shm";

/// `/tmp/mirror-<uid>`.
pub fn default_root() -> PathBuf {
    // SAFETY: `getuid` cannot fail.
    PathBuf::from(format!("/tmp/mirror-{}", unsafe { libc::getuid() }))
}

pub(crate) fn check_name(name: &str) -> Result<(), InstanceError> {
    let fits = (1..=32).contains(&name.len())
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

fn lock_path(root: &Path, instance: &str) -> PathBuf {
    root.join(format!("{instance}.lock"))
}

pub(crate) fn create_private(directory: &Path) -> std::io::Result<()> {
    std::fs::DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(directory)
}

/// The start of all of an instance's file names in shared memory.
pub fn prefix(root: &Path, instance: &str) -> String {
    let place = format!("{}\n{instance}", root.display());
    format!("m{:08x}_", messages::layout_hash(&place) >> 32)
}

/// iceoryx2's configuration for an instance: its own root path and its own prefix.
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
    // A listener's socket is `<directory>/<prefix><up to 39 digits>.event`.
    if text.len() + 1 + prefix.len() + 39 + ".event".len() > SOCKET_PATH {
        return Err(bad("it is too long for the sockets below it"));
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
    match File::open(lock_path(root, instance)) {
        Ok(file) => {
            let mut lock = whole_file_lock();
            // SAFETY: a live descriptor and a live structure.
            let asked = unsafe { libc::fcntl(file.as_raw_fd(), libc::F_OFD_GETLK, &mut lock) };
            asked == 0 && lock.l_type != libc::F_UNLCK as libc::c_short
        }
        Err(_) => false,
    }
}

/// Process id of the launcher that holds the instance, if one does.
pub fn launcher(root: &Path, instance: &str) -> Option<u32> {
    is_locked(root, instance).then(|| {
        let text = std::fs::read_to_string(lock_path(root, instance)).unwrap_or_default();
        text.trim().parse().unwrap_or(0)
    })
}

/// Bytes free for messages in `/dev/shm`; a set needs about 32 MiB.
pub fn shared_memory_free() -> u64 {
    // SAFETY: a terminated path and a live structure.
    unsafe {
        let mut status: libc::statvfs = core::mem::zeroed();
        match libc::statvfs(c"/dev/shm".as_ptr(), &mut status) {
            0 => status.f_bavail * status.f_frsize,
            _ => 0,
        }
    }
}

/// A launcher's hold on an instance; released when dropped, or by the kernel when the launcher ends in any way.
#[derive(Debug)]
pub struct InstanceLock {
    root: PathBuf,
    instance: String,
    _file: File,
}

impl InstanceLock {
    /// Takes the instance, and removes what an earlier run of it left: processes that outlived their launcher get a
    /// second to end and are then killed.
    ///
    /// # Errors
    /// [`InstanceError::InUse`] while another launcher lives.
    pub fn acquire(root: &Path, instance: &str) -> Result<Self, InstanceError> {
        check_name(instance)?;
        config(root, instance)?;
        let path = lock_path(root, instance);
        let io = |source| InstanceError::Io {
            path: path.clone(),
            source,
        };
        create_private(root).map_err(io)?;
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .mode(0o600)
            .open(&path)
            .map_err(io)?;
        // SAFETY: a live descriptor and a live structure.
        if unsafe { libc::fcntl(file.as_raw_fd(), libc::F_OFD_SETLK, &whole_file_lock()) } != 0 {
            let source = std::io::Error::last_os_error();
            if source.kind() != std::io::ErrorKind::WouldBlock {
                return Err(io(source));
            }
            let mut text = String::new();
            let _ = file.read_to_string(&mut text);
            return Err(InstanceError::InUse {
                instance: instance.to_owned(),
                pid: text.trim().parse().unwrap_or(0),
            });
        }
        file.set_len(0).map_err(io)?;
        file.rewind().map_err(io)?;
        writeln!(file, "{}", std::process::id()).map_err(io)?;
        end_orphans(root, instance)?;
        remove_everything(root, instance)?;
        create_private(&directory(root, instance)).map_err(io)?;
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

/// Waits for a process's end, at most so long; true if it has ended.
fn wait_for_end(pid: u32, patience: Duration) -> bool {
    // SAFETY: plain system calls with valid arguments.
    unsafe {
        let descriptor = libc::syscall(libc::SYS_pidfd_open, pid as libc::pid_t, 0) as i32;
        if descriptor < 0 {
            return true;
        }
        let mut poll = libc::pollfd {
            fd: descriptor,
            events: libc::POLLIN,
            revents: 0,
        };
        let ended = libc::poll(&mut poll, 1, patience.as_millis() as i32) > 0;
        libc::close(descriptor);
        ended
    }
}

/// Ends processes whose launcher is dead; only for who holds the lock.
fn end_orphans(root: &Path, instance: &str) -> Result<(), InstanceError> {
    let orphans = nodes(root, instance)?
        .into_iter()
        .filter(|node| node.alive && node.pid != 0 && node.pid != std::process::id());
    for orphan in orphans {
        if !wait_for_end(orphan.pid, Duration::from_millis(1_200)) {
            // SAFETY: signals a process that holds a node of this instance.
            unsafe { libc::kill(orphan.pid as libc::pid_t, libc::SIGKILL) };
            wait_for_end(orphan.pid, Duration::from_secs(1));
        }
    }
    Ok(())
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
    let mut report = if is_locked(root, instance) {
        clean_nodes(root, instance)?
    } else {
        end_orphans(root, instance)?;
        clean_nodes(root, instance)?
    };
    if !is_locked(root, instance) {
        report.files = remove_everything(root, instance)?;
    }
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

fn shared_files(root: &Path, instance: &str) -> Vec<PathBuf> {
    let prefix = prefix(root, instance);
    let Ok(entries) = std::fs::read_dir(SHARED_MEMORY) else {
        return Vec::new();
    };
    entries
        .flatten()
        .filter(|entry| entry.file_name().to_string_lossy().starts_with(&prefix))
        .map(|entry| entry.path())
        .collect()
}

fn remove_everything(root: &Path, instance: &str) -> Result<u64, InstanceError> {
    let mut files = 0;
    for path in shared_files(root, instance) {
        if std::fs::remove_file(&path).is_ok() {
            files += 1;
        }
    }
    let path = directory(root, instance);
    match std::fs::remove_dir_all(&path) {
        Ok(()) => Ok(files),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(files),
        Err(source) => Err(InstanceError::Io { path, source }),
    }
}

/// An instance as `mirror doctor` shows it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InstanceState {
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
        let shared_files = shared_files(root, &instance).len();
        if launcher.is_some() || !nodes.is_empty() || shared_files > 0 {
            states.push(InstanceState {
                instance,
                launcher,
                nodes,
                shared_files,
            });
        }
    }
    Ok(states)
}
