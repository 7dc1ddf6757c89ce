//! Instances: named process sets that never meet, and removing what a killed one left.
//!
//! An instance lives in `<root>/<name>/` (iceoryx2's nodes, services and sockets, and the arguments of its processes),
//! in files of `/dev/shm` that start with a prefix derived from root and name (the messages), and in
//! `<root>/<name>.lock`, which its launcher holds locked: the kernel releases it however the launcher ends. The lock
//! file itself stays. Where the usual root is, [`root_for`] says. Root and directories are this user's alone, or they
//! are not used.

pub use crate::cleanup::{
    CleanupReport, InstanceState, NodeEntry, cleanup_dead, list_instances, nodes,
};
pub(crate) use crate::cleanup::{clean_nodes, close_to_others};
pub(crate) use crate::held::is_locked;
pub use crate::held::launcher;
pub use crate::lock::InstanceLock;
pub(crate) use crate::paths::{check_name, config};
pub use crate::paths::{directory, prefix};
pub use crate::roots::{lookup_roots, root_for, root_of};
