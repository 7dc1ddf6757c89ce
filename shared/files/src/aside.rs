//! What a file held, kept until what replaces it is whole.

use crate::target::Target;
use crate::{FileError, at};
use rustix::fs::{CWD, RenameFlags, renameat_with};
use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

/// The contents of a file that is about to be written bit by bit, and so cannot be replaced whole.
///
/// Dropped before anything was written to the file, it puts them back. Else they stay, under [`Self::kept`], until
/// [`Self::remove`] is called.
#[derive(Debug)]
pub struct Aside {
    path: PathBuf,
    kept: PathBuf,
}

/// Moves what `path` holds to a name of its own beside it, and leaves an empty file of the same mode and owner. None
/// where nothing would be lost: there is no such file, it is empty, or it is a device or a pipe.
///
/// # Errors
/// [`FileError`] names the file; it then holds what it held.
pub fn set_aside(path: &Path) -> Result<Option<Aside>, FileError> {
    let Some(regular) = Target::look(path)? else {
        return Ok(None);
    };
    let Some(before) = regular.metadata().filter(|before| before.len() > 0) else {
        return Ok(None);
    };
    regular.check().map_err(at(path))?;
    let path = regular.path();
    let kept = move_beside(path).map_err(at(path))?;
    let aside = Aside {
        path: path.to_owned(),
        kept,
    };
    let successor = || -> io::Result<File> {
        let file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .mode(0o600)
            .open(path)?;
        // Only root can keep another owner; a file of one's own that is as readable as before loses nothing.
        let _ = std::os::unix::fs::fchown(&file, Some(before.uid()), Some(before.gid()));
        file.set_permissions(before.permissions())?;
        Ok(file)
    };
    successor().map_err(at(path))?;
    Ok(Some(aside))
}

/// Gives a file another name, which nothing has; that name.
fn move_beside(path: &Path) -> io::Result<PathBuf> {
    let mut count = 1;
    loop {
        let mut kept = path.as_os_str().to_owned();
        kept.push(".before");
        if count > 1 {
            kept.push(count.to_string());
        }
        match renameat_with(CWD, path, CWD, &kept, RenameFlags::NOREPLACE) {
            Ok(()) => return Ok(kept.into()),
            Err(rustix::io::Errno::EXIST) => count += 1,
            Err(error) => return Err(error.into()),
        }
    }
}

impl Aside {
    /// The file that they were set aside from, behind all links.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Where the contents are.
    pub fn kept(&self) -> &Path {
        &self.kept
    }

    /// Removes the contents: what replaces them is whole.
    ///
    /// # Errors
    /// [`FileError`] names the file that could not be removed.
    pub fn remove(self) -> Result<(), FileError> {
        std::fs::remove_file(&self.kept).map_err(at(&self.kept))
    }

    /// Puts the contents back if nothing took their place; whether they are back.
    pub fn restore(&self) -> bool {
        let is_untouched = match std::fs::metadata(&self.path) {
            Ok(now) => now.len() == 0,
            Err(error) => error.kind() == io::ErrorKind::NotFound,
        };
        is_untouched && std::fs::rename(&self.kept, &self.path).is_ok()
    }
}

impl Drop for Aside {
    fn drop(&mut self) {
        // After `remove` there is nothing to move.
        if self.kept.exists() {
            self.restore();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn what_was_there_is_put_back_kept_or_removed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("drive.mcap");
        assert!(set_aside(&path).unwrap().is_none(), "no file");
        std::fs::write(&path, "").unwrap();
        assert!(set_aside(&path).unwrap().is_none(), "an empty file");

        std::fs::write(&path, "old").unwrap();
        std::fs::set_permissions(&path, PermissionsExt::from_mode(0o640)).unwrap();
        let aside = set_aside(&path).unwrap().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"");
        let mode = std::fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o640);
        drop(aside);
        assert_eq!(std::fs::read(&path).unwrap(), b"old", "put back");

        let aside = set_aside(&path).unwrap().unwrap();
        std::fs::write(&path, "half").unwrap();
        let kept = aside.kept().to_owned();
        drop(aside);
        assert_eq!(std::fs::read(&kept).unwrap(), b"old", "kept");

        let aside = set_aside(&path).unwrap().unwrap();
        assert_ne!(aside.kept(), kept, "a name that nothing has");
        std::fs::write(&path, "whole").unwrap();
        aside.remove().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"whole");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    }
}
