//! What a path names: a regular file, behind however many links, or something that bytes run through.

use crate::{FileError, at};
use rustix::fs::Access;
use std::fs::{File, FileType, Metadata, OpenOptions};
use std::io::{self, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};

/// As many links in a row as the system follows.
const MOST_LINKS: u32 = 40;

/// What can be written to.
pub(crate) enum Target {
    /// A regular file that is there or will be.
    Regular(Box<Regular>),
    /// An open device or pipe.
    Stream(File),
}

/// A regular file that is there or will be.
pub(crate) struct Regular {
    /// No link.
    path: PathBuf,
    directory: PathBuf,
    /// None if it is not there yet.
    before: Option<Metadata>,
}

impl Target {
    pub(crate) fn of(path: &Path) -> Result<Self, FileError> {
        if let Some(regular) = Self::look(path)? {
            return Ok(Self::Regular(Box::new(regular)));
        }
        if let Some(own) = own_output(path) {
            return own.map(Self::Stream).map_err(at(path));
        }
        let stream = OpenOptions::new().write(true).open(path);
        Ok(Self::Stream(stream.map_err(at(path))?))
    }

    /// The regular file; none for what bytes run through.
    pub(crate) fn look(path: &Path) -> Result<Option<Regular>, FileError> {
        let before = match std::fs::metadata(path) {
            Ok(metadata) => Some(metadata),
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(error) => return Err(at(path)(error)),
        };
        if let Some(before) = &before {
            match refused(before.file_type()) {
                Some(kind) => {
                    return Err(FileError::Kind {
                        path: path.to_owned(),
                        kind,
                        need: "a file is needed",
                    });
                }
                None if !before.is_file() || own_output(path).is_some() => return Ok(None),
                None => {}
            }
        }
        let resolved = resolve(path).map_err(at(path))?;
        // The links of /proc lead to open files that may have no name any more.
        if let Some(before) = &before
            && !std::fs::symlink_metadata(&resolved).is_ok_and(|found| same(&found, before))
        {
            return Ok(None);
        }
        let directory = match resolved.parent() {
            Some(directory) if !directory.as_os_str().is_empty() => directory.to_owned(),
            _ => PathBuf::from("."),
        };
        if resolved.file_name().is_none() {
            return Err(at(path)(io::ErrorKind::InvalidInput.into()));
        }
        Ok(Some(Regular {
            path: resolved,
            directory,
            before,
        }))
    }
}

/// What a file is that nothing can be written to.
fn refused(kind: FileType) -> Option<&'static str> {
    if kind.is_dir() {
        Some("a directory")
    } else if kind.is_block_device() {
        Some("a block device")
    } else if kind.is_socket() {
        Some("a socket")
    } else {
        None
    }
}

fn same(one: &Metadata, other: &Metadata) -> bool {
    (one.dev(), one.ino()) == (other.dev(), other.ino())
}

/// Our own standard output or error, if the path is a name of it: opened again it would be written from its start.
fn own_output(path: &Path) -> Option<io::Result<File>> {
    let named = std::fs::metadata(path).ok()?;
    let (output, error) = (io::stdout(), io::stderr());
    for own in [output.as_fd(), error.as_fd()] {
        let Ok(own) = own.try_clone_to_owned().map(File::from) else {
            continue;
        };
        if own.metadata().is_ok_and(|own| same(&own, &named)) {
            // What was printed before comes before.
            return Some(io::stdout().flush().map(|()| own));
        }
    }
    None
}

/// Follows links to the name of the file itself, which need not exist.
fn resolve(path: &Path) -> io::Result<PathBuf> {
    let mut path = path.to_owned();
    for _ in 0..MOST_LINKS {
        match std::fs::read_link(&path) {
            Ok(to) => path = path.parent().unwrap_or(Path::new("")).join(to),
            // Not a link, or not there.
            Err(error)
                if matches!(
                    error.kind(),
                    io::ErrorKind::InvalidInput | io::ErrorKind::NotFound
                ) =>
            {
                return Ok(path);
            }
            Err(error) => return Err(error),
        }
    }
    Err(rustix::io::Errno::LOOP.into())
}

impl Regular {
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn directory(&self) -> &Path {
        &self.directory
    }

    pub(crate) fn metadata(&self) -> Option<&Metadata> {
        self.before.as_ref()
    }

    pub(crate) fn exists(&self) -> bool {
        self.before.is_some()
    }

    /// Names that the file has.
    pub(crate) fn links(&self) -> u64 {
        self.before.as_ref().map_or(0, MetadataExt::nlink)
    }

    /// A file that nobody may write to is not replaced either.
    pub(crate) fn check_writable(&self) -> io::Result<()> {
        if self.exists() {
            rustix::fs::access(&self.path, Access::WRITE_OK)?;
        }
        Ok(())
    }

    /// Whether it can be written.
    pub(crate) fn check(&self) -> io::Result<()> {
        if self.exists() {
            return self.check_writable();
        }
        let directory = std::fs::metadata(&self.directory).map_err(|error| {
            io::Error::new(
                error.kind(),
                format!("its directory {}: {error}", self.directory.display()),
            )
        })?;
        if !directory.is_dir() {
            return Err(io::Error::new(
                io::ErrorKind::NotADirectory,
                format!("{} is no directory", self.directory.display()),
            ));
        }
        rustix::fs::access(&self.directory, Access::WRITE_OK | Access::EXEC_OK).map_err(|error| {
            io::Error::new(
                io::Error::from(error).kind(),
                format!("its directory {}: {error}", self.directory.display()),
            )
        })
    }
}
