//! A set that was started in order to be watched.

use std::process::Child;

/// A `mirror up` of our own. Dropped, it is ended and waited for.
pub struct StartedSet {
    child: Child,
}

impl StartedSet {
    /// Of the process that was started.
    pub fn new(child: Child) -> Self {
        Self { child }
    }

    /// Its process id.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Asks it to end, and waits for it.
    pub fn end(&mut self) {
        // The id of one that was waited for may be somebody else's.
        if self.ended().is_some() {
            return;
        }
        // SAFETY: signals a child that was not waited for yet, so its id is its own.
        unsafe { libc::kill(self.child.id() as libc::pid_t, libc::SIGTERM) };
        let _ = self.child.wait();
    }

    /// How it ended, if it has.
    pub fn ended(&mut self) -> Option<i32> {
        let status = self.child.try_wait().ok()??;
        Some(status.code().unwrap_or(1))
    }
}

impl Drop for StartedSet {
    fn drop(&mut self) {
        self.end();
    }
}
