//! How a process ended, and what that means.

use super::phase::Phase;
use serde::Serialize;
use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;

/// A process that has ended.
pub struct Ended {
    /// As in [`Child`].
    pub place: usize,
    /// As in [`Child`].
    pub index: u32,
    /// What it did last.
    pub phase: Phase,
    /// How and, where that is known, why.
    pub how: String,
    /// What ended it.
    pub cause: Cause,
    /// Whether it was our own executable.
    pub is_ours: bool,
    /// The signal that ended it.
    pub signal: Option<libc::c_int>,
    /// Whether its exit status is 0.
    pub well: bool,
}

/// What ended a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Cause {
    /// A signal for what it did itself, such as SIGSEGV, or a panic: a bug of the program.
    Crash,
    /// Another signal, which the launcher did not send.
    Signal,
    /// The launcher, because it hung or was to end.
    Launcher,
    /// It ended by itself.
    Exit,
}

impl Cause {
    /// What an exit status tells. `is_ours`: whether it is our own executable's; `was_signalled`: whether the launcher
    /// ended it.
    pub fn of(status: ExitStatus, is_ours: bool, was_signalled: bool) -> Self {
        match (status.signal(), status.code()) {
            // No matter whether it was to end: it was not sent one of these.
            (Some(signal), _) if CRASHES.contains(&signal) => Self::Crash,
            (_, Some(PANIC)) if is_ours => Self::Crash,
            _ if was_signalled => Self::Launcher,
            (Some(_), _) => Self::Signal,
            _ => Self::Exit,
        }
    }
}

/// An exit status in words.
pub fn how_it_ended(status: ExitStatus) -> String {
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("ended with status {code}"),
        (None, Some(signal)) => {
            let name = signal_name(signal).map_or(String::new(), |name| format!(" ({name})"));
            format!("was killed by signal {signal}{name}")
        }
        (None, None) => "ended".to_owned(),
    }
}

/// Signals that a process is sent for what it did itself.
const CRASHES: [libc::c_int; 7] = [
    libc::SIGSEGV,
    libc::SIGABRT,
    libc::SIGILL,
    libc::SIGBUS,
    libc::SIGFPE,
    libc::SIGTRAP,
    libc::SIGSYS,
];
/// Exit status of a Rust program that panicked.
const PANIC: i32 = 101;

/// A signal's name, of those that end processes.
pub fn signal_name(signal: libc::c_int) -> Option<&'static str> {
    Some(match signal {
        libc::SIGHUP => "SIGHUP",
        libc::SIGINT => "SIGINT",
        libc::SIGQUIT => "SIGQUIT",
        libc::SIGILL => "SIGILL",
        libc::SIGTRAP => "SIGTRAP",
        libc::SIGABRT => "SIGABRT",
        libc::SIGBUS => "SIGBUS",
        libc::SIGFPE => "SIGFPE",
        libc::SIGKILL => "SIGKILL",
        libc::SIGUSR1 => "SIGUSR1",
        libc::SIGSEGV => "SIGSEGV",
        libc::SIGUSR2 => "SIGUSR2",
        libc::SIGPIPE => "SIGPIPE",
        libc::SIGALRM => "SIGALRM",
        libc::SIGTERM => "SIGTERM",
        libc::SIGXCPU => "SIGXCPU",
        libc::SIGXFSZ => "SIGXFSZ",
        libc::SIGSYS => "SIGSYS",
        _ => return None,
    })
}
