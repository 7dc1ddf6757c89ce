//! Printing that holds nobody up: lines are written by a thread of their own. What finds no room is missing, and is
//! said to be where it is; a display must not wait for a reader who has stopped reading.

use std::io::{self, Write};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

/// Lines that may wait for their reader.
const QUEUE: usize = 1024;
/// At the end, the reader may take so long.
const PATIENCE: Duration = Duration::from_secs(1);

/// A writer of lines that never waits.
pub struct Unhurried {
    lines: Option<SyncSender<Vec<u8>>>,
    /// The line that has no end yet.
    line: Vec<u8>,
    /// Lines dropped since the last that found room.
    missing: u64,
    /// Closed when everything has been written.
    written: Receiver<()>,
}

impl Unhurried {
    /// Writes to `out`, whose errors are passed over: a closed terminal must not stop a run.
    pub fn new(mut out: impl Write + Send + 'static) -> Self {
        let (lines, queue) = sync_channel::<Vec<u8>>(QUEUE);
        let (at_work, written) = sync_channel(0);
        std::thread::spawn(move || {
            for line in queue {
                let _ = out.write_all(&line);
            }
            let _ = out.flush();
            drop(at_work);
        });
        Self {
            lines: Some(lines),
            line: Vec::with_capacity(256),
            missing: 0,
            written,
        }
    }

    fn send(&mut self) {
        let line = std::mem::take(&mut self.line);
        let Some(lines) = &self.lines else { return };
        if self.missing > 0 {
            let gap = format!(
                "… {} lines are missing here: nobody read them\n",
                self.missing
            );
            if lines.try_send(gap.into_bytes()).is_ok() {
                self.missing = 0;
            }
        }
        if self.missing > 0 || lines.try_send(line).is_err() {
            self.missing += 1;
        }
    }
}

impl Write for Unhurried {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let end = bytes.iter().position(|byte| *byte == b'\n');
        let taken = end.map_or(bytes.len(), |end| end + 1);
        self.line.extend_from_slice(&bytes[..taken]);
        if end.is_some() {
            self.send();
        }
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Drop for Unhurried {
    fn drop(&mut self) {
        self.lines = None;
        // Nothing is ever sent: this ends when the thread does.
        let _ = self.written.recv_timeout(PATIENCE);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Arc, Mutex};

    /// Writes nothing before it may.
    struct Stuck {
        gate: Receiver<()>,
        out: Arc<Mutex<Vec<u8>>>,
    }

    impl Write for Stuck {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let _ = self.gate.recv();
            self.out.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn nobody_waits_for_a_reader_and_what_is_missing_is_said() {
        let (open, gate) = sync_channel::<()>(0);
        let out = Arc::new(Mutex::new(Vec::new()));
        let stuck = Stuck {
            gate,
            out: out.clone(),
        };
        let mut printer = Unhurried::new(stuck);
        for line in 0..2 * QUEUE {
            writeln!(printer, "line {line}").unwrap();
        }
        let missing = printer.missing;
        assert!(missing > 0, "it did not wait");
        open.send(()).unwrap(); // one line is written, and another is on its way: there is room
        let said = loop {
            writeln!(printer, "after").unwrap();
            if printer.missing == 0 {
                break true;
            }
            let _ = open.try_send(());
        };
        assert!(said);
        drop(open); // everything may be written now
        drop(printer);
        let text = String::from_utf8(out.lock().unwrap().clone()).unwrap();
        assert!(text.starts_with("line 0\nline 1\n"), "in order");
        assert!(text.contains("lines are missing here"), "{}", text.len());
        assert!(text.ends_with("after\n"));
    }
}
