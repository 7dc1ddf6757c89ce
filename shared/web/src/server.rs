//! The server: one thread that accepts, one for every connection, and what they share.

use crate::access::Access;
use crate::assets::Asset;
use crate::connection::{self, LAST_WORDS};
use crate::mailbox::{Mailbox, Slot};
use rustix::event::{PollFd, PollFlags, poll};
use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener};
use std::os::fd::{AsFd, AsRawFd, RawFd};
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use thiserror::Error;

/// Connections at the same time.
const MOST_CONNECTIONS: usize = 64;
/// Messages of pages that may wait for the process; a page that sends more is let go.
const MOST_INCOMING: usize = 1024;

/// A page that is open: no two of a server have the same.
pub type PageId = u64;

/// What pages do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Incoming {
    /// One was opened.
    Joined(PageId),
    /// One said something.
    Said(PageId, String),
    /// One was closed, or let go.
    Left(PageId),
}

/// Why nothing is served.
#[derive(Debug, Error)]
pub enum ServeError {
    /// The address is taken, or another machine's.
    #[error("cannot listen on {listen}: {source}")]
    Listen {
        /// Where.
        listen: SocketAddr,
        /// The system's reason.
        source: io::Error,
    },
    /// No thread, or no descriptor.
    #[error("serving pages: {0}")]
    System(#[from] io::Error),
}

/// Wakes somebody who polls; waking twice is waking once.
pub(crate) struct Bell {
    ring: UnixStream,
    hear: UnixStream,
}

impl Bell {
    pub(crate) fn new() -> io::Result<Self> {
        let (ring, hear) = UnixStream::pair()?;
        ring.set_nonblocking(true)?;
        hear.set_nonblocking(true)?;
        Ok(Self { ring, hear })
    }

    pub(crate) fn ring(&self) {
        // Full: it rings already.
        let _ = (&self.ring).write(&[1]);
    }

    pub(crate) fn quiet(&self) {
        let mut rung = [0; 64];
        while (&self.hear).read(&mut rung).is_ok_and(|read| read > 0) {}
    }

    pub(crate) fn fd(&self) -> &UnixStream {
        &self.hear
    }
}

pub(crate) struct Page {
    pub(crate) id: PageId,
    pub(crate) mailbox: Mutex<Mailbox>,
    pub(crate) bell: Bell,
}

#[derive(Default)]
struct Pages {
    open: Vec<Arc<Page>>,
    next: PageId,
    /// What a page is told first.
    greeting: Option<Arc<str>>,
    newest: [Option<Arc<str>>; 2],
}

pub(crate) struct Shared {
    pub(crate) access: Access,
    pub(crate) assets: &'static [Asset],
    pages: Mutex<Pages>,
    incoming: Mutex<VecDeque<Incoming>>,
    /// Rings for whoever takes what comes in.
    inbox: Bell,
    connections: AtomicUsize,
    is_over: AtomicBool,
}

/// A panic of a connection's thread leaves nothing half done in these.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    pub(crate) fn is_over(&self) -> bool {
        self.is_over.load(Ordering::Acquire)
    }

    /// A page joins; what it is told first waits in its mailbox.
    pub(crate) fn join(&self) -> io::Result<Arc<Page>> {
        let bell = Bell::new()?;
        let mut pages = lock(&self.pages);
        pages.next += 1;
        let mut mailbox = Mailbox::default();
        if let Some(greeting) = &pages.greeting {
            mailbox.tell(greeting.clone());
        }
        for (slot, text) in [Slot::Motion, Slot::Step].into_iter().zip(&pages.newest) {
            if let Some(text) = text {
                mailbox.publish(slot, text.clone());
            }
        }
        let page = Arc::new(Page {
            id: pages.next,
            mailbox: Mutex::new(mailbox),
            bell,
        });
        pages.open.push(page.clone());
        drop(pages);
        self.bring(Incoming::Joined(page.id));
        Ok(page)
    }

    /// A page has gone.
    pub(crate) fn leave(&self, page: &Page) {
        lock(&page.mailbox).close();
        lock(&self.pages).open.retain(|open| open.id != page.id);
        lock(&self.incoming).push_back(Incoming::Left(page.id));
        self.inbox.ring();
    }

    /// What a page did; false if nobody keeps up with it.
    pub(crate) fn bring(&self, incoming: Incoming) -> bool {
        let mut waiting = lock(&self.incoming);
        if waiting.len() >= MOST_INCOMING {
            return false;
        }
        waiting.push_back(incoming);
        drop(waiting);
        self.inbox.ring();
        true
    }
}

/// A server of pages. Dropped, it closes all of them.
pub struct Server {
    shared: Arc<Shared>,
    stop: Arc<Bell>,
    acceptor: Option<JoinHandle<()>>,
}

impl Server {
    /// Serves these files, and a socket for each page, from now on.
    ///
    /// # Errors
    /// [`ServeError`].
    pub fn start(access: &Access, assets: &'static [Asset]) -> Result<Self, ServeError> {
        let listen = access.listen;
        let listener =
            TcpListener::bind(listen).map_err(|source| ServeError::Listen { listen, source })?;
        listener.set_nonblocking(true)?;
        let shared = Arc::new(Shared {
            access: access.clone(),
            assets,
            pages: Mutex::default(),
            incoming: Mutex::default(),
            inbox: Bell::new()?,
            connections: AtomicUsize::new(0),
            is_over: AtomicBool::new(false),
        });
        let stop = Arc::new(Bell::new()?);
        let acceptor = {
            let (shared, stop) = (shared.clone(), stop.clone());
            std::thread::Builder::new()
                .name("web:accept".to_owned())
                .spawn(move || accept(&listener, &shared, &stop))?
        };
        Ok(Self {
            shared,
            stop,
            acceptor: Some(acceptor),
        })
    }

    /// What every page is told first, from now on.
    pub fn greet(&self, text: &str) {
        lock(&self.shared.pages).greeting = Some(text.into());
    }

    /// Shows every page the newest of this; what it replaces is sent to nobody any more.
    pub fn publish(&self, slot: Slot, text: &str) {
        let text: Arc<str> = text.into();
        let mut pages = lock(&self.shared.pages);
        pages.newest[slot as usize] = Some(text.clone());
        for page in &pages.open {
            lock(&page.mailbox).publish(slot, text.clone());
            page.bell.ring();
        }
    }

    /// Tells every page something, after all that it was told before.
    pub fn tell(&self, text: &str) {
        let text: Arc<str> = text.into();
        for page in &lock(&self.shared.pages).open {
            lock(&page.mailbox).tell(text.clone());
            page.bell.ring();
        }
    }

    /// Tells one page something, if it is still open.
    pub fn tell_one(&self, page: PageId, text: &str) {
        let pages = lock(&self.shared.pages);
        if let Some(page) = pages.open.iter().find(|open| open.id == page) {
            lock(&page.mailbox).tell(text.into());
            page.bell.ring();
        }
    }

    /// What pages did since the last call, in order.
    pub fn take(&self) -> Option<Incoming> {
        self.shared.inbox.quiet();
        lock(&self.shared.incoming).pop_front()
    }

    /// Whether [`Server::take`] has something.
    pub fn has_incoming(&self) -> bool {
        !lock(&self.shared.incoming).is_empty()
    }

    /// Readable when [`Server::take`] has something new.
    pub fn descriptor(&self) -> RawFd {
        self.shared.inbox.fd().as_raw_fd()
    }

    /// Pages that are open.
    pub fn pages(&self) -> usize {
        lock(&self.shared.pages).open.len()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shared.is_over.store(true, Ordering::Release);
        self.stop.ring();
        for page in &lock(&self.shared.pages).open {
            page.bell.ring();
        }
        if let Some(acceptor) = self.acceptor.take() {
            let _ = acceptor.join();
        }
        // The process may end next, and with it what still waits for a page.
        let since = Instant::now();
        while self.pages() > 0 && since.elapsed() < LAST_WORDS {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

fn accept(listener: &TcpListener, shared: &Arc<Shared>, stop: &Bell) {
    while !shared.is_over() {
        let mut polled = [
            PollFd::from_borrowed_fd(listener.as_fd(), PollFlags::IN),
            PollFd::from_borrowed_fd(stop.fd().as_fd(), PollFlags::IN),
        ];
        if poll(&mut polled, None).is_err() {
            continue;
        }
        let Ok((stream, _)) = listener.accept() else {
            continue;
        };
        if shared.connections.fetch_add(1, Ordering::AcqRel) >= MOST_CONNECTIONS {
            shared.connections.fetch_sub(1, Ordering::AcqRel);
            continue;
        }
        let served = {
            let shared = shared.clone();
            std::thread::Builder::new()
                .name("web:page".to_owned())
                .spawn(move || {
                    connection::serve(stream, &shared);
                    shared.connections.fetch_sub(1, Ordering::AcqRel);
                })
        };
        if served.is_err() {
            shared.connections.fetch_sub(1, Ordering::AcqRel);
        }
    }
}
