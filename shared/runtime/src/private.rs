//! Directories and files that are this user's alone: found without following links, and checked before they are used.
//!
//! `/tmp` and `/dev/shm` are everybody's. A path there may be a link to this user's home, or another user's directory
//! that waits for somebody to put a run into it. So directories are opened by descriptor, link by link, and what is
//! below them is looked at and removed relative to these descriptors. A directory with no rights for others, below one
//! in which nobody else may rename it, stays what it was found to be.

use crate::error::InstanceError;
use rustix::fs::{AtFlags, CWD, Dir, FileType, Mode, OFlags, Stat};
use rustix::io::Errno;
use std::ffi::CString;
use std::fs::File;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::Path;

const DIRECTORY: OFlags = OFlags::RDONLY
    .union(OFlags::DIRECTORY)
    .union(OFlags::NOFOLLOW)
    .union(OFlags::CLOEXEC);

fn untrusted(path: &Path, reason: impl Into<String>) -> InstanceError {
    InstanceError::Untrusted {
        path: path.to_owned(),
        reason: reason.into(),
    }
}

fn io(path: &Path, source: impl Into<std::io::Error>) -> InstanceError {
    InstanceError::Io {
        path: path.to_owned(),
        source: source.into(),
    }
}

/// This user.
pub(crate) fn me() -> u32 {
    rustix::process::geteuid().as_raw()
}

fn kind(stat: &Stat) -> FileType {
    FileType::from_raw_mode(stat.st_mode)
}

/// Why an entry is not a directory of this user's alone, if it is not.
fn objection(stat: &Stat) -> Option<String> {
    let (owner, rights) = (stat.st_uid, stat.st_mode & 0o777);
    match kind(stat) {
        FileType::Directory => {}
        FileType::Symlink => return Some("it is a symbolic link, not a directory".to_owned()),
        _ => return Some("it is no directory".to_owned()),
    }
    if owner != me() {
        return Some(format!("it belongs to user {owner}, not to user {}", me()));
    }
    (rights & 0o077 != 0).then(|| {
        format!("its mode {rights:o} lets others in: it must be 700; look at what is in it before you use it")
    })
}

/// Opens a directory that is this user's alone; none if there is none.
///
/// # Errors
/// [`InstanceError::Untrusted`] for a link, another user's directory, or one that others may use.
pub(crate) fn open(path: &Path) -> Result<Option<OwnedFd>, InstanceError> {
    let opened = open_at(CWD, path, path)?;
    if opened.is_some() {
        check_parent(path)?;
    }
    Ok(opened)
}

fn open_at(
    base: BorrowedFd<'_>,
    name: &Path,
    path: &Path,
) -> Result<Option<OwnedFd>, InstanceError> {
    let descriptor = match rustix::fs::openat(base, name, DIRECTORY, Mode::empty()) {
        Ok(descriptor) => descriptor,
        Err(Errno::NOENT) => return Ok(None),
        Err(error) => {
            let found = rustix::fs::statat(base, name, AtFlags::SYMLINK_NOFOLLOW);
            return Err(match found.ok().as_ref().and_then(objection) {
                Some(reason) => untrusted(path, reason),
                None => io(path, error),
            });
        }
    };
    let stat = rustix::fs::fstat(&descriptor).map_err(|error| io(path, error))?;
    match objection(&stat) {
        Some(reason) => Err(untrusted(path, reason)),
        None => Ok(Some(descriptor)),
    }
}

/// Whoever may rename a directory can put another in its place between two looks.
fn check_parent(path: &Path) -> Result<(), InstanceError> {
    let Some(parent) = path
        .parent()
        .filter(|parent| !parent.as_os_str().is_empty())
    else {
        return Ok(());
    };
    let stat = rustix::fs::stat(parent).map_err(|error| io(parent, error))?;
    if stat.st_mode & 0o022 != 0 && stat.st_mode & 0o1000 == 0 {
        let reason = format!(
            "others could replace it, for {} has mode {:o} (without the sticky bit)",
            parent.display(),
            stat.st_mode & 0o7777
        );
        return Err(untrusted(path, reason));
    }
    Ok(())
}

/// Makes a directory that is this user's alone, or opens the one that is there.
///
/// # Errors
/// As [`open`].
pub(crate) fn create(path: &Path) -> Result<OwnedFd, InstanceError> {
    use std::os::unix::fs::DirBuilderExt;
    let make = || std::fs::DirBuilder::new().mode(0o700).create(path);
    let made = make().or_else(|error| match path.parent() {
        Some(parent) if error.kind() == std::io::ErrorKind::NotFound => {
            std::fs::DirBuilder::new()
                .recursive(true)
                .mode(0o700)
                .create(parent)?;
            make()
        }
        _ => Err(error),
    });
    match made {
        Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => {
            return Err(io(path, error));
        }
        _ => {}
    }
    open(path)?.ok_or_else(|| io(path, Errno::NOENT))
}

/// Opens a file of ours in a directory of ours, or makes it; none if it is not there and shall not be made.
///
/// # Errors
/// [`InstanceError::Untrusted`] for anything but a regular file of this user's with this one name.
pub(crate) fn file(
    directory: &OwnedFd,
    name: &str,
    path: &Path,
    flags: OFlags,
) -> Result<Option<File>, InstanceError> {
    // A pipe would be waited for.
    let flags = flags | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let file = match rustix::fs::openat(directory, name, flags, Mode::RUSR | Mode::WUSR) {
        Ok(file) => file,
        Err(Errno::NOENT) => return Ok(None),
        Err(Errno::LOOP) => return Err(untrusted(path, "it is a symbolic link, not a file")),
        Err(error) => return Err(io(path, error)),
    };
    let stat = rustix::fs::fstat(&file).map_err(|error| io(path, error))?;
    if kind(&stat) != FileType::RegularFile || stat.st_uid != me() || stat.st_nlink != 1 {
        return Err(untrusted(path, "it is not a file that this program made"));
    }
    Ok(Some(File::from(file)))
}

/// An entry of a directory, as it was when it was looked at.
struct Entry {
    name: CString,
    stat: Stat,
}

fn entries(directory: impl AsFd, path: &Path) -> Result<Vec<Entry>, InstanceError> {
    let mut found = Vec::new();
    let listed = Dir::read_from(&directory).map_err(|error| io(path, error))?;
    for entry in listed {
        let name = entry
            .map_err(|error| io(path, error))?
            .file_name()
            .to_owned();
        if matches!(name.to_bytes(), b"." | b"..") {
            continue;
        }
        // One that went away meanwhile.
        if let Ok(stat) = rustix::fs::statat(&directory, &name, AtFlags::SYMLINK_NOFOLLOW) {
            found.push(Entry { name, stat });
        }
    }
    Ok(found)
}

/// What an entry of an instance's directory is called that this program or iceoryx2 made.
struct Made<'a> {
    /// The start of all of iceoryx2's names.
    prefix: &'a str,
}

impl Made<'_> {
    fn is_directory(&self, depth: usize, name: &str) -> bool {
        match depth {
            0 => matches!(name, "nodes" | "services"),
            _ => !name.is_empty() && name.bytes().all(|byte| byte.is_ascii_digit()),
        }
    }

    fn is_file(&self, depth: usize, name: &str) -> bool {
        const ENDINGS: [&str; 6] = ["json", "jsonl", "safetensors", "toml", "sock", "partial"];
        let ending = || name.rsplit_once('.').map_or("", |(_, ending)| ending);
        name.starts_with(self.prefix) || depth == 0 && ENDINGS.contains(&ending())
    }
}

/// Removes a directory of an instance with everything that this program made in it. What is somebody else's, or a link,
/// or has a name that the program gives to nothing, stays, and the directory with it.
///
/// # Errors
/// As [`open`], or [`InstanceError::Io`] naming what could not be removed.
pub(crate) fn remove(root: &Path, instance: &str, prefix: &str) -> Result<(), InstanceError> {
    let Some(base) = open(root)? else {
        return Ok(());
    };
    let path = root.join(instance);
    let Some(directory) = open_at(base.as_fd(), Path::new(instance), &path)? else {
        return Ok(());
    };
    clear(&directory, &path, &Made { prefix }, 0)?;
    unlink(&base, instance, AtFlags::REMOVEDIR, &path)
}

fn clear(
    directory: &OwnedFd,
    path: &Path,
    made: &Made<'_>,
    depth: usize,
) -> Result<(), InstanceError> {
    for Entry { name, stat } in entries(directory, path)? {
        let Ok(text) = name.to_str() else {
            continue;
        };
        let below = path.join(text);
        match kind(&stat) {
            _ if stat.st_uid != me() => {}
            FileType::Directory if depth < 2 && made.is_directory(depth, text) => {
                let opened = rustix::fs::openat(directory, &name, DIRECTORY, Mode::empty());
                let inner = opened.map_err(|error| io(&below, error))?;
                clear(&inner, &below, made, depth + 1)?;
                unlink(directory, text, AtFlags::REMOVEDIR, &below)?;
            }
            FileType::RegularFile | FileType::Socket if made.is_file(depth, text) => {
                unlink(directory, text, AtFlags::empty(), &below)?;
            }
            _ => {}
        }
    }
    Ok(())
}

fn unlink(base: &OwnedFd, name: &str, flags: AtFlags, path: &Path) -> Result<(), InstanceError> {
    match rustix::fs::unlinkat(base, name, flags) {
        Ok(()) | Err(Errno::NOENT) => Ok(()),
        // Something in it is not ours to remove.
        Err(Errno::NOTEMPTY | Errno::EXIST) if flags == AtFlags::REMOVEDIR => Ok(()),
        Err(error) => Err(io(path, error)),
    }
}

/// Files of shared memory whose names begin so.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct SharedFiles {
    /// Those that this user's processes made.
    pub(crate) ours: Vec<CString>,
    /// Somebody else's, or no files: with the owner.
    pub(crate) others: Vec<(CString, u32)>,
}

/// Where shared memory has its names.
pub(crate) const SHARED_MEMORY: &str = "/dev/shm";

fn shared_memory() -> Result<OwnedFd, InstanceError> {
    let path = Path::new(SHARED_MEMORY);
    // A link here is the system's own.
    let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::CLOEXEC;
    rustix::fs::open(path, flags, Mode::empty()).map_err(|error| io(path, error))
}

/// The files of shared memory whose names begin with `prefix`; none where there is no shared memory.
pub(crate) fn shared_files(prefix: &str) -> SharedFiles {
    let mut files = SharedFiles::default();
    let path = Path::new(SHARED_MEMORY);
    let Ok(found) = shared_memory().and_then(|directory| entries(directory, path)) else {
        return files;
    };
    for Entry { name, stat } in found {
        if !name.to_bytes().starts_with(prefix.as_bytes()) {
            continue;
        }
        match kind(&stat) {
            FileType::RegularFile if stat.st_uid == me() => files.ours.push(name),
            _ => files.others.push((name, stat.st_uid)),
        }
    }
    files
}

/// Removes this user's files of shared memory whose names begin with `prefix`; how many there were.
pub(crate) fn remove_shared(prefix: &str) -> u64 {
    let Ok(directory) = shared_memory() else {
        return 0;
    };
    let ours = shared_files(prefix).ours;
    let removed = ours
        .iter()
        .filter(|name| rustix::fs::unlinkat(&directory, *name, AtFlags::empty()).is_ok());
    removed.count() as u64
}

/// Takes from others what rights they have to files of shared memory whose names begin with `prefix`: iceoryx2 makes
/// its node counter for everybody to read and write.
pub(crate) fn close_shared(prefix: &str) {
    let Ok(directory) = shared_memory() else {
        return;
    };
    for name in shared_files(prefix).ours {
        let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::CLOEXEC;
        let opened = rustix::fs::openat(&directory, &name, flags, Mode::empty());
        if let Ok(file) = opened
            && let Ok(stat) = rustix::fs::fstat(&file)
            && stat.st_mode & 0o077 != 0
        {
            let _ = rustix::fs::fchmod(&file, Mode::from_raw_mode(stat.st_mode & 0o700));
        }
    }
}

/// Refuses an instance in whose shared memory somebody else has put something: its processes would take it for their
/// own.
///
/// # Errors
/// [`InstanceError::Untrusted`] naming the file and its owner.
pub(crate) fn check_shared(prefix: &str) -> Result<(), InstanceError> {
    match shared_files(prefix).others.first() {
        None => Ok(()),
        Some((name, owner)) => Err(untrusted(
            &Path::new(SHARED_MEMORY).join(name.to_string_lossy().as_ref()),
            format!(
                "user {owner} has put it where this instance's messages would lie; choose another --instance"
            ),
        )),
    }
}
