//! Everything that can go wrong below a process's own work.

use std::path::PathBuf;
use thiserror::Error;

/// A port could not be made or used.
#[derive(Debug, Error)]
pub enum PortError {
    /// Somebody else speaks another version or layout of the message on this topic: build both from one source.
    #[error("topic `{topic}`: this process speaks {ours}, the running set speaks {theirs}")]
    Layout {
        /// The topic.
        topic: String,
        /// Type name and layout of this process.
        ours: String,
        /// Type name and layout of those who made the topic.
        theirs: String,
    },
    /// The service could not be opened or created.
    #[error("topic `{topic}`: could not open the service: {reason}")]
    Open {
        /// The topic.
        topic: String,
        /// iceoryx2's reason.
        reason: String,
    },
    /// The service has no place for another port or a buffer of that size.
    #[error("topic `{topic}`: could not make the port: {reason}")]
    Create {
        /// The topic.
        topic: String,
        /// iceoryx2's reason.
        reason: String,
    },
    /// No memory left to write a message into.
    #[error("topic `{topic}`: could not loan a message: {reason}")]
    Loan {
        /// The topic.
        topic: &'static str,
        /// iceoryx2's reason.
        reason: String,
    },
    /// The message could not be sent.
    #[error("topic `{topic}`: could not send: {reason}")]
    Send {
        /// The topic.
        topic: &'static str,
        /// iceoryx2's reason.
        reason: String,
    },
    /// The message could not be received.
    #[error("topic `{topic}`: could not receive: {reason}")]
    Receive {
        /// The topic.
        topic: &'static str,
        /// iceoryx2's reason.
        reason: String,
    },
}

/// An instance could not be used.
#[derive(Debug, Error)]
pub enum InstanceError {
    /// Another launcher runs this instance: stop it, or choose another name.
    #[error("instance `{instance}` is in use by process {pid}")]
    InUse {
        /// The instance.
        instance: String,
        /// Its launcher's process id; 0 if the lock does not say.
        pid: u32,
    },
    /// Not a name for an instance.
    #[error("instance name {name:?} is not 1 to 32 letters, digits, `-` and `_`, the first no `-`")]
    Name {
        /// What was given.
        name: String,
    },
    /// The root's path is too long for the sockets below it, or not UTF-8.
    #[error("{path}: not usable as the directory of instances: {reason}")]
    Root {
        /// The path.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// A directory or file is not this user's alone, and so not used.
    #[error("{path}: {reason}")]
    Untrusted {
        /// The directory or file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// A process's arguments are not what a launcher writes.
    #[error("{origin}: not the arguments of a run: {reason}")]
    Arguments {
        /// File, or where else the text came from.
        origin: String,
        /// What and where.
        reason: String,
    },
    /// A file or directory of the instance.
    #[error("{path}: {source}")]
    Io {
        /// The path.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// iceoryx2 could not list or clean.
    #[error("instance `{instance}`: {reason}")]
    Nodes {
        /// The instance.
        instance: String,
        /// iceoryx2's reason.
        reason: String,
    },
}

/// A process could not join its run, or lost its footing in it.
#[derive(Debug, Error)]
pub enum NodeError {
    /// See [`InstanceError`].
    #[error(transparent)]
    Instance(#[from] InstanceError),
    /// See [`PortError`].
    #[error(transparent)]
    Port(#[from] PortError),
    /// iceoryx2 could not make the node.
    #[error("process `{process}` could not join instance `{instance}`: {reason}")]
    Join {
        /// The instance.
        instance: String,
        /// The process.
        process: String,
        /// iceoryx2's reason.
        reason: String,
    },
    /// The launcher ended before the process joined.
    #[error("launcher {pid} of instance `{instance}` is gone")]
    LauncherGone {
        /// The instance.
        instance: String,
        /// The launcher's process id.
        pid: u32,
    },
    /// A system call that waiting needs failed.
    #[error("{call}: {source}")]
    System {
        /// The call.
        call: &'static str,
        /// The system's reason.
        source: std::io::Error,
    },
    /// Processes did not come up in time.
    #[error("not ready in time: {missing}")]
    NotReady {
        /// Their names.
        missing: String,
    },
    /// A process said that it failed.
    #[error("process `{process}` failed: {text}")]
    ProcessFailed {
        /// The process.
        process: String,
        /// Its words.
        text: String,
    },
}
