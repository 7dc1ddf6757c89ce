//! Ending processes that outlived their launcher, and no others.
//!
//! A process id may have been given to somebody else by now, or be another machine's or container's. So a process is
//! only signalled through a descriptor, and only if the kernel says that the very process holds the lock on its node's
//! file in this instance's directory, which nobody but this user can reach.

use crate::error::InstanceError;
use crate::paths::{config, directory, prefix};
use crate::transport::Ipc;
use iceoryx2::node::{NodeState, NodeView};
use iceoryx2::prelude::CallbackProgression;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use rustix::process::{Flock, FlockType, PidfdFlags, Signal};
use std::os::fd::OwnedFd;
use std::path::Path;

/// Orphans end by themselves within a second.
const PATIENCE: Timespec = Timespec {
    tv_sec: 1,
    tv_nsec: 200_000_000,
};

/// Ends processes whose launcher is dead, giving them a second to do so themselves; only for who holds the instance's
/// lock.
///
/// # Errors
/// [`InstanceError::Nodes`] if somebody lives on who is not to be signalled.
pub(crate) fn end(root: &Path, instance: &str) -> Result<(), InstanceError> {
    for monitor in monitors(root, instance)? {
        let Some(lock) = lock_on(root, instance, &monitor)? else {
            continue;
        };
        let pid = lock.pid.ok_or_else(|| stranger(instance))?;
        let Ok(process) = rustix::process::pidfd_open(pid, PidfdFlags::empty()) else {
            continue;
        };
        // The descriptor stands for whoever has the id now: for the holder, if the lock is still that id's.
        let still = lock_on(root, instance, &monitor)?;
        if still.and_then(|lock| lock.pid) != Some(pid) {
            continue;
        }
        if !has_ended(&process, &PATIENCE) {
            // One that ended meanwhile needs no signal.
            let _ = rustix::process::pidfd_send_signal(&process, Signal::KILL);
            has_ended(&process, &PATIENCE);
        }
    }
    Ok(())
}

/// It has no id here: the instance is used from within a container, say.
fn stranger(instance: &str) -> InstanceError {
    InstanceError::Nodes {
        instance: instance.to_owned(),
        reason: "a process lives in it whose id is unknown here; choose another --instance"
            .to_owned(),
    }
}

/// The files that living processes other than this one hold locked, one a node.
fn monitors(root: &Path, instance: &str) -> Result<Vec<String>, InstanceError> {
    let config = config(root, instance)?;
    let mut monitors = Vec::new();
    if !directory(root, instance).is_dir() {
        return Ok(monitors);
    }
    let prefix = prefix(root, instance);
    let own = std::process::id();
    iceoryx2::node::Node::<Ipc>::list(&config, |state| {
        if let NodeState::Alive(view) = &state {
            let pid = view
                .details()
                .as_ref()
                .map(|details| details.process_id().value() as u32);
            // Looking at our own lock would release it.
            if pid != Some(own) {
                monitors.push(format!("{prefix}{}.node_monitor", view.id().value()));
            }
        }
        CallbackProgression::Continue
    })
    .map_err(|error| InstanceError::Nodes {
        instance: instance.to_owned(),
        reason: format!("{error:?}"),
    })?;
    Ok(monitors)
}

/// The lock on a node's file, with who holds it.
fn lock_on(root: &Path, instance: &str, monitor: &str) -> Result<Option<Flock>, InstanceError> {
    let path = directory(root, instance).join("nodes").join(monitor);
    let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
    // The directory is ours alone, or `config` had refused it.
    let Ok(file) = rustix::fs::open(&path, flags, Mode::empty()) else {
        return Ok(None);
    };
    rustix::process::fcntl_getlk(&file, &Flock::from(FlockType::WriteLock)).map_err(|error| {
        InstanceError::Io {
            path,
            source: error.into(),
        }
    })
}

/// Waits for a process's end, at most so long; true if it has ended.
fn has_ended(process: &OwnedFd, patience: &Timespec) -> bool {
    let mut polled = [PollFd::new(process, PollFlags::IN)];
    matches!(poll(&mut polled, Some(patience)), Ok(1..))
}
