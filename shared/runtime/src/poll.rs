//! Waiting for descriptors without allocating.

use crate::error::NodeError;
use std::os::fd::RawFd;

/// A set of descriptors to poll. Filling and polling it allocates nothing once it has been as large before.
pub(crate) struct Poll {
    descriptors: Vec<libc::pollfd>,
}

impl Poll {
    pub(crate) fn new() -> Self {
        Self {
            descriptors: Vec::with_capacity(64),
        }
    }

    pub(crate) fn clear(&mut self) {
        self.descriptors.clear();
    }

    /// Adds a descriptor; a negative one keeps its place and is never ready.
    pub(crate) fn add(&mut self, fd: RawFd) {
        self.descriptors.push(libc::pollfd {
            fd,
            events: libc::POLLIN,
            revents: 0,
        });
    }

    pub(crate) fn is_ready(&self, index: usize) -> bool {
        self.descriptors[index].revents != 0
    }

    /// Blocks until a descriptor is ready or the time has come; false if none is ready.
    pub(crate) fn wait(&mut self, timeout_ns: u64) -> Result<bool, NodeError> {
        let timeout = libc::timespec {
            tv_sec: (timeout_ns / 1_000_000_000) as libc::time_t,
            tv_nsec: (timeout_ns % 1_000_000_000) as libc::c_long,
        };
        // SAFETY: a live array of the stated length, a live timespec, no signal mask.
        let ready = unsafe {
            libc::ppoll(
                self.descriptors.as_mut_ptr(),
                self.descriptors.len() as libc::nfds_t,
                &timeout,
                core::ptr::null(),
            )
        };
        if ready < 0 {
            let source = std::io::Error::last_os_error();
            if source.kind() != std::io::ErrorKind::Interrupted {
                return Err(NodeError::System {
                    call: "ppoll",
                    source,
                });
            }
            for descriptor in &mut self.descriptors {
                descriptor.revents = 0;
            }
        }
        Ok(ready > 0)
    }
}
