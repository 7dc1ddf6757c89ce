//! What every MIRROR process is built on: its node, its ports, waiting, clocks, stage timing and a clean end.
//!
//! A process is one loop over a [`Node`], inside [`run_process`]: make the ports, say [`Node::ready`], then wait,
//! compute and send until [`Wake::Stop`]. The launcher's side is [`Launcher`]. Runs are kept apart by [`RunArguments`]:
//! every instance has its own directory below the root and its own prefix for shared memory (see [`instance`]).
//!
//! What allocates, measured with [`CountingAllocator`] and read in iceoryx2 0.10's source: making nodes, services and
//! ports does, and so does the first send or receive after a port of the other side came or went. Loaning a message
//! takes one small block inside iceoryx2 each time (a reference counter); [`CountingAllocator`] hands it the block of
//! an earlier loan, so that none is asked of the system. Sending, notifying, receiving and releasing make no
//! allocation, and neither does [`Node::wait`], which calls `poll(2)` on the listeners' descriptors because iceoryx2's
//! own wait set collects what woke it in a fresh vector each time. Its request-response allocates once more for every
//! request received; see [`RequestServer`] for what is used instead.

pub mod alloc_count;
mod arguments;
mod cleanup;
pub mod clock;
mod control;
mod digest;
mod error;
mod held;
mod imagine;
mod input;
pub mod instance;
mod launcher;
mod lock;
mod node;
mod observer;
mod orphans;
mod output;
mod paths;
mod poll;
mod private;
mod process;
mod report;
mod room;
mod roots;
mod service;
mod shared;
mod signal;
mod sleeper;
mod timing;
mod transport;
mod turn;
mod wait;

pub use alloc_count::CountingAllocator;
pub use arguments::{ClockMode, RunArguments};
pub use clock::{Ticker, now_ns, stand_still};
pub use digest::Digest;
pub use error::{InstanceError, NodeError, PortError};
pub use imagine::{RequestClient, RequestServer};
pub use input::{Advance, Input, InputOptions, Receive, Source};
pub use instance::{CleanupReport, InstanceLock, InstanceState, cleanup_dead, list_instances};
pub use launcher::{Launcher, LauncherWake, process_descriptor, text_of};
pub use node::Node;
pub use observer::{Observer, ObserverWake};
pub use output::{Loan, Output, Stamp};
pub use process::run_process;
pub use room::{OPEN_FILES_NEEDED, open_files, shared_memory_free, shared_memory_needed};
pub use service::{DEFAULT_BUFFER, HISTORY, RECORDER_BUFFER};
pub use signal::{name_thread, stop_requested};
pub use timing::StageTimer;
pub use turn::{NEVER, Position};
pub use wait::Wake;
