//! What this program writes to its standard output and its standard error.
//!
//! Commands that only print use [`out!`], and wait for their reader as every program does. Who runs a set, or talks to one,
//! must wait for nobody: it prints through a [`Printer`], a thread with a bounded queue. What finds no room there is
//! dropped, counted, and said where it is missing.
//!
//! An output that cannot be written makes the program's status 1, with the reason on the standard error ([`verdict`]). A
//! reader that went away is no error.

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TrySendError, bounded};
use std::fmt::Arguments;
use std::io::{self, ErrorKind, Write};
use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

/// Lines that may wait for their reader.
const QUEUE: usize = 8192;
/// How often a wait looks up.
const LOOK: Duration = Duration::from_millis(50);
/// At the end, a reader is waited for without a word for so long …
const PATIENCE: Duration = Duration::from_secs(2);
/// … and after Ctrl-C, in all, for so long.
const LAST_PATIENCE: Duration = Duration::from_secs(5);

/// Why the standard output could not be written, the first time.
static FAILED: OnceLock<String> = OnceLock::new();

/// Writes a line to the standard output.
macro_rules! out {
    ($($text:tt)*) => { $crate::console::write(format_args!($($text)*)) };
}
pub(crate) use out;

/// See [`out!`].
pub fn write(line: Arguments) {
    // A whole line is written at once: nothing is left to flush.
    note(writeln!(io::stdout().lock(), "{line}"));
}

/// Keeps why the standard output could not be written. A reader that went away is no error.
pub fn note(result: io::Result<()>) {
    if let Err(error) = result
        && error.kind() != ErrorKind::BrokenPipe
    {
        let _ = FAILED.set(error.to_string());
    }
}

/// The program's status: `status`, but a failure if something could not be printed, and then says why.
pub fn verdict(status: ExitCode) -> ExitCode {
    match FAILED.get() {
        None => status,
        Some(why) => {
            let _ = writeln!(io::stderr().lock(), "mirror: standard output: {why}");
            match status == ExitCode::SUCCESS {
                true => ExitCode::FAILURE,
                false => status,
            }
        }
    }
}

/// Where a line goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stream {
    /// The standard output.
    Out,
    /// The standard error.
    Err,
}

impl Stream {
    /// Writes a line, and waits for who reads it.
    pub fn write(self, line: &str) {
        match self {
            Self::Out => note(writeln!(io::stdout().lock(), "{line}")),
            // There is nowhere to say that this cannot be written.
            Self::Err => drop(writeln!(io::stderr().lock(), "{line}")),
        }
    }
}

/// What a printer's thread does for others.
pub enum PrintOrder {
    /// Writes a line.
    Line(Stream, String),
    /// Says that so many lines are missing here.
    Gap(u64),
    /// Tells that all before it has been written.
    Told(Sender<()>),
}

/// The way to a thread that prints. Nobody who prints waits for whoever reads.
pub struct Printer {
    orders: Sender<PrintOrder>,
    /// Lines dropped since the last that found room.
    gap: Mutex<u64>,
    dropped: AtomicU64,
}

impl Printer {
    /// A printer, and what its thread is to do.
    pub fn new() -> (Self, Receiver<PrintOrder>) {
        let (orders, todo) = bounded(QUEUE);
        let printer = Self {
            orders,
            gap: Mutex::new(0),
            dropped: AtomicU64::new(0),
        };
        (printer, todo)
    }

    /// Prints a line, or drops it where nobody reads. Whether it is the first that was dropped.
    pub fn line(&self, to: Stream, text: &str) -> bool {
        let mut gap = self.gap.lock().unwrap_or_else(PoisonError::into_inner);
        if *gap > 0 && self.orders.try_send(PrintOrder::Gap(*gap)).is_ok() {
            *gap = 0;
        }
        if *gap == 0 {
            let sent = self.orders.try_send(PrintOrder::Line(to, text.to_owned()));
            if !matches!(sent, Err(TrySendError::Full(_))) {
                return false;
            }
        }
        *gap += 1;
        self.dropped.fetch_add(1, Ordering::Relaxed) == 0
    }

    /// Lines dropped so far.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Waits until all has been written. A reader who takes long is waited for, after `say` was called once; but not for
    /// long any more once the program has been told to end. Whether all was written.
    pub fn drain(&self, say: impl FnOnce()) -> bool {
        let (told, all_told) = bounded(1);
        let mut order = Some(PrintOrder::Told(told));
        let (since, mut say) = (Instant::now(), Some(say));
        loop {
            order = match order.map(|order| self.orders.send_timeout(order, LOOK)) {
                Some(Err(crossbeam_channel::SendTimeoutError::Timeout(order))) => Some(order),
                _ => None,
            };
            if order.is_none() {
                match all_told.recv_timeout(LOOK) {
                    Err(RecvTimeoutError::Timeout) => {}
                    Ok(()) | Err(RecvTimeoutError::Disconnected) => return true,
                }
            }
            if since.elapsed() > PATIENCE
                && let Some(say) = say.take()
            {
                say();
            }
            if runtime::stop_requested() && since.elapsed() > LAST_PATIENCE {
                return false;
            }
        }
    }
}

/// How lines that were dropped are told of where they are missing.
pub fn gap_text(lines: u64) -> String {
    format!("… {lines} lines are missing here: nobody read them")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_finds_no_room_is_dropped_counted_and_told_of_where_it_is_missing() {
        let (printer, todo) = Printer::new();
        for line in 0..QUEUE {
            assert!(!printer.line(Stream::Out, &line.to_string()));
        }
        assert!(printer.line(Stream::Out, "lost"), "the first");
        assert!(!printer.line(Stream::Out, "lost too"));
        assert_eq!(printer.dropped(), 2);
        for line in 0..QUEUE {
            assert!(
                matches!(todo.recv(), Ok(PrintOrder::Line(_, text)) if text == line.to_string())
            );
        }
        assert!(!printer.line(Stream::Out, "again"));
        assert!(matches!(todo.recv(), Ok(PrintOrder::Gap(2))));
        assert!(matches!(todo.recv(), Ok(PrintOrder::Line(_, text)) if text == "again"));
        assert_eq!(printer.dropped(), 2);
    }
}
