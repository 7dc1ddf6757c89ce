//! One connection: a file, or a page's socket for as long as the page is open.

use crate::request::{self, Answer};
use crate::server::{Incoming, Page, Shared, lock};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::io;
use std::net::TcpStream;
use std::os::fd::AsFd;
use std::time::{Duration, Instant};
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Error, Message, Utf8Bytes, WebSocket};

/// Longest message of a page.
const MOST_BYTES: usize = 16 << 10;
/// A page that says nothing is asked so often whether it is there …
const ASK: Duration = Duration::from_secs(2);
/// … and let go when it has not answered for so long.
const PATIENCE: Duration = Duration::from_secs(10);
/// How long a page has to take what it is told last.
pub(crate) const LAST_WORDS: Duration = Duration::from_secs(2);
/// How long a file may take to be read by the other side.
const FILE_PATIENCE: Duration = Duration::from_secs(20);

/// Serves a connection to its end.
pub fn serve(mut stream: TcpStream, shared: &Shared) {
    // What goes wrong with a connection is the other side's loss.
    let _ = stream.set_nonblocking(false);
    let _ = stream.set_nodelay(true);
    let _ = stream.set_write_timeout(Some(FILE_PATIENCE));
    let Some(request) = request::read(&mut stream) else {
        return;
    };
    match request::answer(&request, &shared.access, shared.assets) {
        Answer::File(asset) => {
            let _ = request::write_file(&mut stream, asset);
        }
        Answer::Refused(status, why) => {
            let _ = request::write_refusal(&mut stream, status, why);
        }
        Answer::Socket(key) => {
            if request::write_upgrade(&mut stream, key).is_err()
                || stream.set_nonblocking(true).is_err()
            {
                return;
            }
            if let Ok(page) = shared.join() {
                let config = WebSocketConfig::default()
                    .max_message_size(Some(MOST_BYTES))
                    .max_frame_size(Some(MOST_BYTES))
                    .write_buffer_size(0);
                let socket = WebSocket::from_raw_socket(stream, Role::Server, Some(config));
                let mut socket = PageSocket {
                    socket,
                    is_flushed: true,
                    heard: Instant::now(),
                    asked: Instant::now(),
                };
                let _ = socket.follow(&page, shared);
                shared.leave(&page);
            }
        }
    }
}

struct PageSocket {
    socket: WebSocket<TcpStream>,
    /// Whether everything that was written has gone out; until then, nothing more is taken from the mailbox.
    is_flushed: bool,
    heard: Instant,
    asked: Instant,
}

impl PageSocket {
    fn follow(&mut self, page: &Page, shared: &Shared) -> Result<(), Error> {
        loop {
            if shared.is_over() || lock(&page.mailbox).is_closed {
                return self.part(page);
            }
            if !self.listen(page, shared)? {
                return Ok(());
            }
            self.ask()?;
            self.send(page)?;
            self.wait(page)?;
        }
    }

    /// Sends the last word, behind what the page was told before it, as far as the other side takes it in time.
    fn part(&mut self, page: &Page) -> Result<(), Error> {
        let since = Instant::now();
        self.send(page)?;
        while !self.is_flushed && since.elapsed() < LAST_WORDS {
            self.wait(page)?;
            self.send(page)?;
        }
        self.socket.close(None)?;
        self.socket.flush()
    }

    /// Hands over what the page says; false if nobody keeps up with it, or it is silent for too long.
    fn listen(&mut self, page: &Page, shared: &Shared) -> Result<bool, Error> {
        loop {
            match self.socket.read() {
                Ok(Message::Text(text)) => {
                    self.heard = Instant::now();
                    if !shared.bring(Incoming::Said(page.id, text.as_str().to_owned())) {
                        return Ok(false);
                    }
                }
                Ok(Message::Close(_)) => return Ok(false),
                Ok(_) => self.heard = Instant::now(),
                Err(error) if is_not_yet(&error) => return Ok(self.heard.elapsed() < PATIENCE),
                Err(error) => return Err(error),
            }
        }
    }

    fn ask(&mut self) -> Result<(), Error> {
        if self.is_flushed && self.asked.elapsed() >= ASK {
            self.asked = Instant::now();
            self.write(Message::Ping(Default::default()))?;
        }
        Ok(())
    }

    fn send(&mut self, page: &Page) -> Result<(), Error> {
        page.bell.quiet();
        if !self.is_flushed {
            match self.socket.flush() {
                Ok(()) => self.is_flushed = true,
                Err(error) if is_not_yet(&error) => return Ok(()),
                Err(error) => return Err(error),
            }
        }
        while self.is_flushed {
            let next = lock(&page.mailbox).next();
            let Some(text) = next else { break };
            self.write(Message::Text(Utf8Bytes::from(&*text)))?;
        }
        Ok(())
    }

    fn write(&mut self, message: Message) -> Result<(), Error> {
        match self.socket.send(message) {
            Ok(()) => Ok(()),
            // It is kept, and goes out with the next flush.
            Err(error) if is_not_yet(&error) => {
                self.is_flushed = false;
                Ok(())
            }
            Err(error) => Err(error),
        }
    }

    fn wait(&self, page: &Page) -> Result<(), Error> {
        let wanted = match self.is_flushed {
            true => PollFlags::IN,
            false => PollFlags::IN | PollFlags::OUT,
        };
        let mut polled = [
            PollFd::from_borrowed_fd(self.socket.get_ref().as_fd(), wanted),
            PollFd::from_borrowed_fd(page.bell.fd().as_fd(), PollFlags::IN),
        ];
        let timeout = Timespec {
            tv_sec: 1,
            tv_nsec: 0,
        };
        match poll(&mut polled, Some(&timeout)) {
            Ok(_) | Err(rustix::io::Errno::INTR) => Ok(()),
            Err(error) => Err(Error::Io(error.into())),
        }
    }
}

fn is_not_yet(error: &Error) -> bool {
    matches!(error, Error::Io(error) if error.kind() == io::ErrorKind::WouldBlock)
}
