//! The terminal: lines of several threads above one status line. Where there is no terminal, plain lines.

use crate::console::{PrintOrder, Printer, Stream, gap_text};
use crate::failure::Failure;
use crossbeam_channel::{Receiver, RecvTimeoutError};
use indicatif::{ProgressBar, ProgressStyle};
use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

/// How often the status line is drawn.
const TICK: Duration = Duration::from_millis(100);

/// Where lines and the status go; clones share the screen. Nobody who prints on it waits for whoever reads.
#[derive(Clone)]
pub struct Screen(Arc<Shared>);

struct Shared {
    /// The standard error, and the standard output where both are a terminal: one thread draws there.
    err: Printer,
    /// The standard output elsewhere.
    out: Option<Printer>,
    has_status: bool,
    /// What the status line says; none: there is no such line.
    status: Mutex<Option<String>>,
}

/// The screen of this process.
static SCREEN: OnceLock<Screen> = OnceLock::new();

impl Screen {
    /// The screen of this process, with a status line if there is a terminal.
    pub fn new() -> Self {
        SCREEN.get_or_init(Self::open).clone()
    }

    fn open() -> Self {
        let has_status = io::stderr().is_terminal();
        let is_one = has_status && io::stdout().is_terminal();
        let (err, errors) = Printer::new();
        let (out, lines) = Printer::new();
        let shared = Arc::new(Shared {
            err,
            out: (!is_one).then_some(out),
            has_status,
            status: Mutex::new(None),
        });
        let for_drawing = shared.clone();
        std::thread::spawn(move || draw(&for_drawing, &errors));
        if !is_one {
            std::thread::spawn(move || print(&lines));
        }
        Self(shared)
    }

    /// Whether a status line is shown.
    pub fn has_status(&self) -> bool {
        self.0.has_status
    }

    /// Changes the status line.
    pub fn status(&self, text: String) {
        if self.0.has_status {
            *self.0.lock_status() = Some(text);
        }
    }

    /// Writes a line to the standard output, above the status line.
    pub fn line(&self, text: &str) {
        let out = self.0.out.as_ref().unwrap_or(&self.0.err);
        if out.line(Stream::Out, text) {
            self.warn(
                "mirror: nobody reads the standard output: lines are dropped until somebody does",
            );
        }
    }

    /// Writes a line to the standard error, above the status line.
    pub fn warn(&self, text: &str) {
        self.0.err.line(Stream::Err, text);
    }

    /// Removes the status line.
    pub fn finish(&self) {
        *self.0.lock_status() = None;
    }

    /// Lines that were dropped because nobody read them.
    pub fn dropped(&self) -> u64 {
        let out = self.0.out.as_ref().map_or(0, Printer::dropped);
        out + self.0.err.dropped()
    }

    /// Removes the status line and waits until everything has been read.
    fn close(&self) {
        self.finish();
        if let Some(out) = &self.0.out {
            let waiting =
                "mirror: waiting for somebody to read the standard output; Ctrl-C ends without";
            if !out.drain(|| self.warn(waiting)) {
                self.warn("mirror: the end was not printed: nobody read the standard output");
            }
            if out.dropped() > 0 {
                let dropped = out.dropped();
                self.warn(&format!(
                    "mirror: {dropped} lines were not printed: nobody read the standard output"
                ));
            }
        }
        self.0.err.drain(|| ());
    }
}

/// Whether the standard output shows colours.
pub fn has_colours() -> bool {
    let unwanted = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    io::stdout().is_terminal() && !unwanted
}

/// Waits until everything that was printed on the screen has been read, if this process has one.
pub fn close() {
    if let Some(screen) = SCREEN.get() {
        screen.close();
    }
}

impl Shared {
    fn lock_status(&self) -> std::sync::MutexGuard<'_, Option<String>> {
        self.status.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Writes lines to the standard output.
fn print(lines: &Receiver<PrintOrder>) {
    for order in lines {
        match order {
            PrintOrder::Line(to, text) => to.write(&text),
            PrintOrder::Gap(lines) => Stream::Out.write(&gap_text(lines)),
            PrintOrder::Told(told) => drop(told.try_send(())),
        }
    }
}

/// Writes lines above the status line, and draws that.
fn draw(shared: &Shared, lines: &Receiver<PrintOrder>) {
    let mut bar: Option<ProgressBar> = None;
    loop {
        let order = match shared.has_status {
            true => lines.recv_timeout(TICK),
            false => lines.recv().map_err(|_| RecvTimeoutError::Disconnected),
        };
        let status = shared.lock_status().clone();
        match status {
            Some(status) => {
                let bar = bar.get_or_insert_with(status_line);
                bar.set_message(status);
                bar.tick();
            }
            None => {
                if let Some(bar) = bar.take() {
                    bar.finish_and_clear();
                }
            }
        }
        let above = |to: Stream, text: &str| match &bar {
            Some(bar) => bar.suspend(|| to.write(text)),
            None => to.write(text),
        };
        match order {
            Ok(PrintOrder::Line(to, text)) => above(to, &text),
            Ok(PrintOrder::Gap(lines)) => above(Stream::Err, &gap_text(lines)),
            Ok(PrintOrder::Told(told)) => drop(told.try_send(())),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

fn status_line() -> ProgressBar {
    let bar = ProgressBar::new_spinner();
    if let Ok(style) = ProgressStyle::with_template("{spinner} {msg}") {
        bar.set_style(style);
    }
    bar
}

/// A progress bar on a terminal; a plain line every tenth elsewhere. On the standard error; where this process has a screen,
/// in its status line.
pub struct Progress {
    bar: Option<ProgressBar>,
    screen: Option<Screen>,
    what: String,
    length: u64,
    started: Instant,
    /// Tenths written as plain lines, those before it included.
    tenths: AtomicU64,
}

impl Progress {
    /// Counts to `length`.
    pub fn new(what: &str, length: u64) -> Self {
        let screen = SCREEN.get().cloned();
        let bar = (screen.is_none() && io::stderr().is_terminal()).then(|| {
            let bar = ProgressBar::new(length);
            if let Ok(style) =
                ProgressStyle::with_template("{prefix} {wide_bar} {pos}/{len} {msg} {eta}")
            {
                bar.set_style(style);
            }
            bar.set_prefix(what.to_owned());
            bar
        });
        Self {
            bar,
            screen,
            what: what.to_owned(),
            length,
            started: Instant::now(),
            tenths: AtomicU64::new(0),
        }
    }

    /// So far, and a word about it.
    pub fn at(&self, position: u64, message: &str) {
        let Self { what, length, .. } = self;
        if let Some(bar) = &self.bar {
            bar.set_position(position);
            bar.set_message(message.to_owned());
            return;
        }
        if let Some(screen) = self.screen.as_ref().filter(|screen| screen.has_status()) {
            screen.status(format!("{what} · {position}/{length} {message}"));
            return;
        }
        // One line as each tenth is reached, whoever of several threads reaches it.
        let reached = position * 10 / (*length).max(1) + 1;
        if self.tenths.fetch_max(reached, Ordering::Relaxed) < reached {
            let mut left = String::new();
            if position > 0 && position < *length {
                let spent_s = self.started.elapsed().as_secs_f64();
                let left_s = spent_s / position as f64 * (length - position) as f64;
                left = format!("about {left_s:.0} s left ");
            }
            let line = format!("{what}: {position}/{length} {left}{message}");
            match &self.screen {
                Some(screen) => screen.warn(&line),
                None => Stream::Err.write(&line),
            }
        }
    }

    /// Removes the bar.
    pub fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// Tells the user why a command failed. Some errors repeat their causes' words in their own; those are not said twice.
pub fn error(failure: &Failure) {
    let mut text = String::from("mirror");
    for cause in failure.error.chain().map(|cause| cause.to_string()) {
        if !text.contains(&cause) {
            text += ": ";
            text += &cause;
        }
    }
    let _ = writeln!(io::stderr().lock(), "{text}");
}
