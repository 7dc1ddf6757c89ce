//! How every file that a user named is written.
//!
//! A regular file is replaced whole or not at all: the new contents are written beside it, reach the disk, and are then
//! moved over it, with the mode and the owner that it had. Symbolic links stay, and what they point to is replaced.
//! What is no file is never replaced: devices and pipes are written to, and anything else is refused in words.

mod aside;
mod draft;
mod target;

pub use aside::{Aside, set_aside};
use draft::Draft;
use rustix::fs::FallocateFlags;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use target::{Regular, Target};

/// A file could not be written.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file, as it was named.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// It is not of a kind that can be written to.
    #[error("{}: that is {kind}; {need}", path.display())]
    Kind {
        /// The file, as it was named.
        path: PathBuf,
        /// What it is.
        kind: &'static str,
        /// What it would have to be.
        need: &'static str,
    },
}

impl From<FileError> for io::Error {
    fn from(error: FileError) -> Self {
        let kind = match &error {
            FileError::Io { source, .. } => source.kind(),
            FileError::Kind { .. } => io::ErrorKind::InvalidInput,
        };
        Self::new(kind, error)
    }
}

fn at(path: &Path) -> impl Fn(io::Error) -> FileError + '_ {
    |source| FileError::Io {
        path: path.to_owned(),
        source,
    }
}

/// Gives `path` these contents: all of them, or, where that fails, those that it had.
///
/// A file that cannot be replaced without losing something is written in place, once there is room for all of it: one
/// with several hard links, one of another owner whom only root could keep, one in a directory that takes no new file.
/// A device or a pipe gets the bytes as they are, and so does the program's own standard output by any of its names.
///
/// # Errors
/// [`FileError`] names the file.
pub fn write(path: &Path, contents: &[u8]) -> Result<(), FileError> {
    match Target::of(path)? {
        Target::Stream(mut stream) => stream
            .write_all(contents)
            .and_then(|()| stream.flush())
            .map_err(at(path)),
        Target::Regular(regular) => replace(&regular, contents).map_err(at(path)),
    }
}

/// Opens `path` for lines that come one by one; what a file held before stays only if `keep` says so.
///
/// # Errors
/// [`FileError`] names the file.
pub fn log(path: &Path, keep: bool) -> Result<File, FileError> {
    match Target::of(path)? {
        Target::Stream(stream) => Ok(stream),
        Target::Regular(_) => OpenOptions::new()
            .create(true)
            .append(true)
            .open(path)
            .and_then(|file| {
                if !keep {
                    file.set_len(0)?;
                }
                Ok(file)
            })
            .map_err(at(path)),
    }
}

/// Whether [`write`] can be expected to succeed: to be asked before the work whose result is to be written. Nothing is
/// created or changed.
///
/// # Errors
/// [`FileError`] names the file and what stands against it.
pub fn check(path: &Path) -> Result<(), FileError> {
    match Target::look(path)? {
        Some(regular) => regular.check().map_err(at(path)),
        None => Ok(()),
    }
}

/// As [`check`], for what is read back, or continued later: a device or a pipe will not do.
///
/// # Errors
/// [`FileError`] names the file and what stands against it.
pub fn check_regular(path: &Path) -> Result<(), FileError> {
    match Target::look(path)? {
        Some(regular) => regular.check().map_err(at(path)),
        None => Err(FileError::Kind {
            path: path.to_owned(),
            kind: "a device or a pipe",
            need: "a regular file is needed, which can be read back",
        }),
    }
}

/// Whether files can be made in a directory that exists.
///
/// # Errors
/// [`FileError`] names the directory.
pub fn check_directory(directory: &Path) -> Result<(), FileError> {
    Draft::create(directory).map(drop).map_err(at(directory))
}

fn replace(regular: &Regular, contents: &[u8]) -> io::Result<()> {
    regular.check_writable()?;
    if regular.links() > 1 {
        return overwrite(regular.path(), contents);
    }
    let mut draft = match Draft::create(regular.directory()) {
        Ok(draft) => draft,
        Err(error) if regular.exists() && takes_no_new_file(&error) => {
            return overwrite(regular.path(), contents);
        }
        Err(error) => return Err(error),
    };
    let file = draft.file();
    if let Some(before) = regular.metadata() {
        let made = file.metadata()?;
        let owners = (before.uid(), before.gid());
        if owners != (made.uid(), made.gid())
            && std::os::unix::fs::fchown(&*file, Some(owners.0), Some(owners.1)).is_err()
        {
            return overwrite(regular.path(), contents);
        }
        file.set_permissions(before.permissions())?;
    } else {
        // As if it had been created by its name.
        file.set_permissions(draft::usual_permissions())?;
    }
    file.write_all(contents)?;
    file.sync_all()?;
    match draft.move_over(regular.path()) {
        Ok(()) => {}
        // Something is mounted there: it can be written to, but not moved over.
        Err(error) if regular.exists() && error.kind() == io::ErrorKind::ResourceBusy => {
            return overwrite(regular.path(), contents);
        }
        Err(error) => return Err(error),
    }
    // The move itself reaches the disk with the directory; some file systems do not offer that.
    if let Ok(directory) = File::open(regular.directory()) {
        let _ = directory.sync_all();
    }
    Ok(())
}

fn takes_no_new_file(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem
    )
}

/// Writes over a file that keeps its place. Room for everything is taken first, so that a full disk changes nothing.
fn overwrite(path: &Path, contents: &[u8]) -> io::Result<()> {
    let mut file = OpenOptions::new().write(true).open(path)?;
    let before = file.metadata()?.len();
    let length = contents.len() as u64;
    if length > before
        && let Err(error) =
            rustix::fs::fallocate(&file, FallocateFlags::empty(), before, length - before)
        && error != rustix::io::Errno::OPNOTSUPP
    {
        // What was taken until then.
        let _ = file.set_len(before);
        return Err(error.into());
    }
    file.write_all(contents)?;
    file.set_len(length)?;
    file.sync_all()
}
