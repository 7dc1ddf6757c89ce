//! Who holds an instance: its launcher, by a lock on a file that the kernel releases however the launcher ends.

use crate::error::InstanceError;
use crate::private;
use rustix::fs::OFlags;
use std::fs::File;
use std::io::Read;
use std::os::fd::{AsRawFd, OwnedFd};
use std::path::Path;

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
pub(crate) fn try_lock(root: &Path, instance: &str) -> Result<Result<File, u32>, InstanceError> {
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
