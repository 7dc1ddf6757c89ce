//! The pages in a browser: a small server for the live view and the cockpit.
//!
//! It listens on the machine itself unless told otherwise, and serves nobody who does not have the link: every path
//! begins with a token ([`Access`]). What a page is sent waits in a mailbox of its own, in which newer state replaces
//! older ([`Server::publish`]), so that a page that is slow, or has stopped reading, holds up nobody; what must arrive
//! in order ([`Server::tell`]) waits in a queue, and a page that lets too much of it pile up is let go.

mod access;
mod assets;
mod connection;
mod mailbox;
mod request;
mod server;

pub use access::{Access, AccessError};
pub use assets::{Asset, COCKPIT, LIVE_VIEW};
pub use mailbox::Slot;
pub use server::{Incoming, PageId, ServeError, Server};
