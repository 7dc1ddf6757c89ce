//! The terminal: lines of several threads above one status line. Where there is no terminal, plain lines.

use crate::failure::Failure;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Where lines and the status go; clones share the screen.
#[derive(Clone)]
pub struct Screen {
    /// Drawn on the standard error; absent where it is no terminal.
    status: Option<ProgressBar>,
}

impl Screen {
    /// A status line if there is a terminal.
    pub fn new() -> Self {
        let status = io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::new_spinner();
            if let Ok(style) = ProgressStyle::with_template("{spinner} {msg}") {
                bar.set_style(style);
            }
            bar.enable_steady_tick(Duration::from_millis(250));
            bar
        });
        Self { status }
    }

    /// Whether a status line is shown.
    pub fn has_status(&self) -> bool {
        self.status.is_some()
    }

    /// Changes the status line.
    pub fn status(&self, text: String) {
        if let Some(bar) = &self.status {
            bar.set_message(text);
        }
    }

    /// Writes a line to the standard output, above the status line.
    pub fn line(&self, text: &str) {
        // A closed output must not stop a run.
        self.above(|| drop(writeln!(io::stdout().lock(), "{text}")));
    }

    /// Writes a line to the standard error, above the status line.
    pub fn warn(&self, text: &str) {
        self.above(|| drop(writeln!(io::stderr().lock(), "{text}")));
    }

    /// Removes the status line.
    pub fn finish(&self) {
        if let Some(bar) = &self.status {
            bar.finish_and_clear();
        }
    }

    fn above(&self, write: impl FnOnce()) {
        match &self.status {
            Some(bar) => bar.suspend(write),
            None => write(),
        }
    }
}

/// A progress bar on a terminal; a plain line every tenth elsewhere. On the standard error.
pub struct Progress {
    bar: Option<ProgressBar>,
    what: String,
    length: u64,
    started: Instant,
    /// Tenths written as plain lines, those before it included.
    tenths: AtomicU64,
}

impl Progress {
    /// Counts to `length`.
    pub fn new(what: &str, length: u64) -> Self {
        let bar = io::stderr().is_terminal().then(|| {
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
            what: what.to_owned(),
            length,
            started: Instant::now(),
            tenths: AtomicU64::new(0),
        }
    }

    /// So far, and a word about it.
    pub fn at(&self, position: u64, message: &str) {
        match &self.bar {
            Some(bar) => {
                bar.set_position(position);
                bar.set_message(message.to_owned());
            }
            None => {
                // One line as each tenth is reached, whoever of several threads reaches it.
                let reached = position * 10 / self.length.max(1) + 1;
                if self.tenths.fetch_max(reached, Ordering::Relaxed) < reached {
                    let Self { what, length, .. } = self;
                    let mut left = String::new();
                    if position > 0 && position < *length {
                        let spent_s = self.started.elapsed().as_secs_f64();
                        let left_s = spent_s / position as f64 * (length - position) as f64;
                        left = format!("about {left_s:.0} s left ");
                    }
                    let _ = writeln!(
                        io::stderr().lock(),
                        "{what}: {position}/{length} {left}{message}"
                    );
                }
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
