//! Another user of the machine, and what they can reach.

use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::Command;

/// Nobody, on most systems: a user who runs nothing.
pub const NOBODY: u32 = 65534;

pub fn is_root() -> bool {
    // SAFETY: cannot fail.
    unsafe { libc::geteuid() == 0 }
}

/// Whether a test can be two users; where it cannot, it says that it is skipped.
pub fn can_be_two_users(test: &str) -> bool {
    if !is_root() {
        testing::skipped(test, "only root can be two users");
    }
    is_root()
}

/// A directory that another user can look into, with this program in it.
pub struct Shared(tempfile::TempDir);

impl Shared {
    pub fn new() -> Self {
        let directory = tempfile::tempdir_in("/tmp").unwrap();
        std::fs::set_permissions(directory.path(), PermissionsExt::from_mode(0o755)).unwrap();
        std::fs::copy(
            env!("CARGO_BIN_EXE_mirror"),
            directory.path().join("mirror"),
        )
        .unwrap();
        Self(directory)
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// The program, as another user would start it.
    pub fn mirror_as(&self, user: u32) -> Command {
        let mut command = Command::new(self.path("mirror"));
        command
            .uid(user)
            .gid(user)
            .current_dir("/")
            .env_remove("XDG_RUNTIME_DIR");
        command
    }
}
