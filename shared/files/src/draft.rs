//! A file under a name of its own, until it takes another's place.

use std::fs::{File, OpenOptions, Permissions};
use std::io;
use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// Keeps apart the drafts of one process.
static COUNT: AtomicU32 = AtomicU32::new(0);

/// A draft; removed when dropped, unless it was moved.
pub(crate) struct Draft {
    path: PathBuf,
    file: File,
    is_moved: bool,
}

impl Draft {
    /// Makes one that only this user can read: what it is to replace may be private.
    pub(crate) fn create(directory: &Path) -> io::Result<Self> {
        loop {
            let count = COUNT.fetch_add(1, Ordering::Relaxed);
            let path = directory.join(format!(".mirror-{}-{count}.partial", std::process::id()));
            // Neither somebody else's file nor a link that leads to one is opened.
            let made = OpenOptions::new()
                .read(true)
                .write(true)
                .create_new(true)
                .mode(0o600)
                .open(&path);
            match made {
                Ok(file) => {
                    let is_moved = false;
                    return Ok(Self {
                        path,
                        file,
                        is_moved,
                    });
                }
                // Of a process that had our id and was killed.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
    }

    pub(crate) fn file(&mut self) -> &mut File {
        &mut self.file
    }

    /// Moves it over `path`.
    pub(crate) fn move_over(mut self, path: &Path) -> io::Result<()> {
        std::fs::rename(&self.path, path)?;
        self.is_moved = true;
        Ok(())
    }
}

impl Drop for Draft {
    fn drop(&mut self) {
        if !self.is_moved {
            // Nothing more can be done about what is left than to try.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// The permissions of a file that is made without any wish: those that the process's mask leaves.
pub(crate) fn usual_permissions() -> Permissions {
    Permissions::from_mode(0o666 & !mask())
}

/// The mask, from where reading does not change it (`umask` sets it to read it, for all threads).
fn mask() -> u32 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("Umask:"));
    line.and_then(|mask| u32::from_str_radix(mask.trim(), 8).ok())
        .unwrap_or(0o077)
}
