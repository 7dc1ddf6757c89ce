//! What a set of processes takes of the machine: shared memory and open files.

use crate::error::InstanceError;
use crate::private::SHARED_MEMORY;
use crate::service::{DEFAULT_BUFFER, HISTORY, TopicSizes};
use messages::{Message, topic};
use rustix::fs::{Access, StatVfsMountFlags};
use std::path::Path;

/// Open files that every process of a set needs: the launcher has 177, a planner 161, and a swap or a profiler adds its
/// own.
pub const OPEN_FILES_NEEDED: u64 = 256;
/// What iceoryx2 keeps for services, connections and events beside the messages; 0.9 MiB were measured.
const BOOKKEEPING: u64 = 3 << 19;

/// Bytes free for messages in `/dev/shm`.
///
/// # Errors
/// [`InstanceError::Io`] or [`InstanceError::Untrusted`] where it is missing, read-only, or not for this user
/// to write in.
pub fn shared_memory_free() -> Result<u64, InstanceError> {
    let path = Path::new(SHARED_MEMORY);
    let unusable = |reason: &str| InstanceError::Untrusted {
        path: path.to_owned(),
        reason: format!(
            "{reason}; the messages of a set lie there, in a file system of kind tmpfs"
        ),
    };
    let status = match rustix::fs::statvfs(path) {
        Ok(status) => status,
        Err(error) => return Err(unusable(&error.to_string())),
    };
    if status.f_flag.contains(StatVfsMountFlags::RDONLY) {
        return Err(unusable("it is mounted read-only"));
    }
    if rustix::fs::access(path, Access::WRITE_OK | Access::EXEC_OK).is_err() {
        return Err(unusable("this user may not write in it"));
    }
    Ok(status.f_bavail * status.f_frsize)
}

/// Bytes of shared memory that a set needs while its processes keep up with each other. Of a publisher's room, which is
/// as large as its slowest receiver may make it, only what is used is taken.
///
/// `is_gridworld` says which world's observations are sent, `plans` whether planner and human model imagine.
pub fn shared_memory_needed(is_gridworld: bool, plans: bool) -> u64 {
    let mut needed = BOOKKEEPING;
    if is_gridworld {
        needed += used::<messages::Observation>(topic::OBSERVATION);
        needed += used::<messages::Picture>(topic::PICTURE);
    } else {
        needed += used::<messages::LidarFrame>(topic::LIDAR);
    }
    needed += used::<messages::Scene>(topic::SCENE);
    needed += used::<messages::Outcome>(topic::OUTCOME);
    needed += used::<messages::RobotBelief>(topic::ROBOT_BELIEF);
    needed += used::<messages::HumanBelief>(topic::HUMAN_BELIEF);
    needed += used::<messages::CommAction>(topic::COMM_ACTION);
    needed += used::<messages::Display>(topic::DISPLAY);
    needed += used::<messages::DriverAction>(topic::DRIVER_ACTION);
    if plans {
        needed += used::<messages::ImagineRequest>(topic::IMAGINE);
        needed += used::<messages::ImagineAnswer>(topic::IMAGINE_ANSWER);
    }
    needed
}

/// What a publisher of a topic uses: the history, a usual buffer, and a message in hand; of bulk, the two halves of a
/// question for each of two that ask, and as many in hand.
fn used<M: Message>(topic: &str) -> u64 {
    let sizes = TopicSizes::of::<M>(topic);
    let messages = match sizes.history {
        0 => 2 * sizes.borrowed,
        _ => HISTORY + DEFAULT_BUFFER + 1,
    };
    (messages.min(sizes.slots) * size_of::<M>()) as u64
}

/// Files that a process may have open (`ulimit -n`).
pub fn open_files() -> u64 {
    let limit = rustix::process::getrlimit(rustix::process::Resource::Nofile);
    limit.current.unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_fits_into_the_shared_memory_of_a_container() {
        const CONTAINER: u64 = 64 << 20;
        for (is_gridworld, plans) in [(false, false), (false, true), (true, false), (true, true)] {
            let needed = shared_memory_needed(is_gridworld, plans);
            // Measured: 1.0 MiB at the start, 3.6 after 60,000 lockstep steps, 2.5 with planning.
            assert!(needed > 1 << 20, "{needed}");
            assert!(needed < CONTAINER / 4, "{needed}");
        }
        assert!(shared_memory_needed(false, true) > shared_memory_needed(false, false));
    }
}
