//! `mirror exec-guard`: stands between a launcher and somebody else's program, so that the program, and whatever it starts,
//! ends with the set, whoever dies first.
//!
//! | ends | then |
//! | --- | --- |
//! | the program | the guard ends what it started, and ends as the program did |
//! | the launcher | the guard asks the program and all its children to end, and makes them within a second |
//! | the guard | the program ends with it; the launcher ends the rest, whose parent it has become |
//!
//! A program's children may leave its process group and its session, and outlive their parents: they stay descendants of
//! the guard, which adopts orphans (`PR_SET_CHILD_SUBREAPER`).

use crate::cli::ExecGuardArguments;
use crate::failure::Failure;
use anyhow::{Context, Result, ensure};
use runtime::process_descriptor;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::process::CommandExt;
use std::process::{Command, ExitCode};
use std::time::{Duration, Instant};

/// After a program that ended well, what it started may take so long to end, too.
const AFTER_PROGRAM: Duration = Duration::from_millis(300);
/// After the launcher, everything may take so long.
const AFTER_LAUNCHER: Duration = Duration::from_millis(700);
/// What does not end when it is killed is left after so long: the kernel holds it.
const KILLED: Duration = Duration::from_secs(2);
/// How often the dead are looked for.
const LOOK: Duration = Duration::from_millis(5);

/// Runs the program to its end.
pub fn guard(arguments: &ExecGuardArguments) -> Result<ExitCode, Failure> {
    runtime::name_thread("mirror:guard");
    let status = watch(arguments)?;
    if libc::WIFSIGNALED(status) {
        end_by(libc::WTERMSIG(status));
    }
    Ok(ExitCode::from(libc::WEXITSTATUS(status) as u8))
}

/// Returns the program's wait status, when nothing is left of it.
fn watch(arguments: &ExecGuardArguments) -> Result<libc::c_int> {
    let launcher = process_descriptor(arguments.launcher).context("watching the launcher")?;
    ensure!(
        // SAFETY: cannot fail.
        unsafe { libc::getppid() } as u32 == arguments.launcher,
        "the launcher, process {}, is gone",
        arguments.launcher
    );
    adopt_orphans()?;
    let signals = signals()?;
    let program = start(arguments)?;
    let mut status = None;
    let launcher_lives = loop {
        if let Some(ended) = reap(program) {
            status = Some(ended);
            break true;
        }
        let mut polled = [signals.as_raw_fd(), launcher.as_raw_fd()].map(|fd| libc::pollfd {
            fd,
            events: libc::POLLIN,
            revents: 0,
        });
        // SAFETY: a live array of two.
        unsafe { libc::poll(polled.as_mut_ptr(), 2, -1) };
        if polled[1].revents != 0 {
            break false;
        }
        for signal in taken(&signals) {
            // What is sent to the whole group reaches the program anyway; to be asked twice is no harm.
            if signal == libc::SIGTERM || signal == libc::SIGINT {
                // SAFETY: signals a child that was not waited for.
                unsafe { libc::kill(program, signal) };
            }
        }
    };
    let ended_well =
        status.is_some_and(|status| libc::WIFEXITED(status) && libc::WEXITSTATUS(status) == 0);
    let grace = match (launcher_lives, ended_well) {
        (false, _) => AFTER_LAUNCHER,
        (true, true) => AFTER_PROGRAM,
        (true, false) => Duration::ZERO,
    };
    if !grace.is_zero() {
        end_all(libc::SIGTERM, grace, program, &mut status);
    }
    end_all(libc::SIGKILL, KILLED, program, &mut status);
    status.context("the program does not end")
}

/// Signals every descendant until none is left, or for so long; keeps the program's status.
fn end_all(
    signal: libc::c_int,
    patience: Duration,
    program: libc::pid_t,
    status: &mut Option<libc::c_int>,
) {
    let since = Instant::now();
    let mut asked = Vec::new();
    loop {
        *status = status.or_else(|| reap(program));
        let left = descendants(std::process::id());
        if left.is_empty() || since.elapsed() > patience {
            return;
        }
        for pid in left {
            // Once each, for a program that counts; what must end may have been replaced by another of that number.
            if signal == libc::SIGKILL || !asked.contains(&pid) {
                asked.push(pid);
                // SAFETY: signals a descendant of this process.
                unsafe { libc::kill(pid as libc::pid_t, signal) };
            }
        }
        std::thread::sleep(LOOK);
    }
}

/// Waits for all children that have ended, adopted ones too; the program's status, if it is among them.
fn reap(program: libc::pid_t) -> Option<libc::c_int> {
    let mut found = None;
    loop {
        let mut status = 0;
        // SAFETY: a live variable of the right type.
        match unsafe { libc::waitpid(-1, &raw mut status, libc::WNOHANG) } {
            pid if pid == program => found = Some(status),
            pid if pid > 0 => {}
            _ => return found,
        }
    }
}

/// Processes that come from this one, directly or not, and have not ended; each after its parent.
pub fn descendants(of: u32) -> Vec<u32> {
    let mut all: Vec<(u32, u32)> = Vec::new();
    for entry in std::fs::read_dir("/proc").into_iter().flatten().flatten() {
        let Some(pid) = entry
            .file_name()
            .to_str()
            .and_then(|name| name.parse().ok())
        else {
            continue;
        };
        // `PID (NAME) STATE PARENT …`; the name may hold anything.
        let Ok(stat) = std::fs::read_to_string(entry.path().join("stat")) else {
            continue;
        };
        let rest = stat.rsplit_once(')').map_or("", |(_, rest)| rest);
        let mut rest = rest.split_ascii_whitespace();
        let (state, parent) = (rest.next(), rest.next().and_then(|text| text.parse().ok()));
        if let Some(parent) = parent.filter(|_| !matches!(state, Some("Z" | "X"))) {
            all.push((pid, parent));
        }
    }
    let mut found = vec![of];
    let mut at = 0;
    while at < found.len() {
        let parent = found[at];
        let children = all.iter().filter(|(_, of)| *of == parent);
        let new: Vec<u32> = children.map(|(pid, _)| *pid).collect();
        found.extend(new.into_iter().filter(|pid| *pid != of));
        at += 1;
    }
    found.remove(0);
    found
}

/// Ends the descendants of this process that are neither `known` nor come from these.
pub fn end_strays(known: &[u32]) {
    let since = Instant::now();
    loop {
        let mut left = descendants(std::process::id());
        for pid in known {
            let guarded = descendants(*pid);
            left.retain(|stray| stray != pid && !guarded.contains(stray));
        }
        if left.is_empty() || since.elapsed() > KILLED {
            return;
        }
        for pid in left {
            // SAFETY: signals a descendant of this process and waits for it, if it is a child.
            unsafe {
                libc::kill(pid as libc::pid_t, libc::SIGKILL);
                libc::waitpid(pid as libc::pid_t, core::ptr::null_mut(), libc::WNOHANG);
            }
        }
        std::thread::sleep(LOOK);
    }
}

/// Has this process become the parent of descendants whose parents end.
///
/// # Errors
/// When the kernel does not know how.
pub fn adopt_orphans() -> Result<()> {
    // SAFETY: plain numbers.
    let done = unsafe { libc::prctl(libc::PR_SET_CHILD_SUBREAPER, 1) } == 0;
    ensure!(done, "prctl: {}", std::io::Error::last_os_error());
    Ok(())
}

fn start(arguments: &ExecGuardArguments) -> Result<libc::pid_t> {
    let guard = std::process::id() as libc::pid_t;
    let mut command = Command::new("/bin/sh");
    command
        .arg("-c")
        .arg(format!("exec {} \"$@\"", arguments.program))
        .arg(&arguments.process)
        .arg(&arguments.run);
    // SAFETY: only calls what may be called between fork and exec.
    unsafe {
        command.pre_exec(move || {
            let mut none: libc::sigset_t = core::mem::zeroed();
            libc::sigemptyset(&mut none);
            libc::sigprocmask(libc::SIG_SETMASK, &none, core::ptr::null_mut());
            libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL);
            if libc::getppid() != guard {
                libc::_exit(1);
            }
            Ok(())
        });
    }
    let child = command.spawn().context("starting /bin/sh")?;
    Ok(child.id() as libc::pid_t)
}

/// The signals that this process hears of, through a descriptor.
fn signals() -> Result<OwnedFd> {
    // SAFETY: plain system calls with live structures; the descriptor is ours.
    unsafe {
        let mut heard: libc::sigset_t = core::mem::zeroed();
        libc::sigemptyset(&mut heard);
        for signal in [
            libc::SIGCHLD,
            libc::SIGTERM,
            libc::SIGINT,
            // From the kernel, when the launcher of a stopped set was killed; its descriptor says so, too.
            libc::SIGHUP,
        ] {
            libc::sigaddset(&mut heard, signal);
        }
        libc::sigprocmask(libc::SIG_BLOCK, &heard, core::ptr::null_mut());
        let descriptor = libc::signalfd(-1, &heard, libc::SFD_CLOEXEC | libc::SFD_NONBLOCK);
        ensure!(
            descriptor >= 0,
            "signalfd: {}",
            std::io::Error::last_os_error()
        );
        Ok(OwnedFd::from_raw_fd(descriptor))
    }
}

/// The signals that came.
fn taken(signals: &OwnedFd) -> Vec<libc::c_int> {
    let mut found = Vec::new();
    loop {
        // SAFETY: a plain C structure for which all zeros is a value.
        let mut info: libc::signalfd_siginfo = unsafe { core::mem::zeroed() };
        let size = size_of::<libc::signalfd_siginfo>();
        // SAFETY: reads at most as many bytes as the structure has.
        let read = unsafe { libc::read(signals.as_raw_fd(), (&raw mut info).cast(), size) };
        if read != size as isize {
            return found;
        }
        found.push(info.ssi_signo as libc::c_int);
    }
}

/// Ends this process as the program was ended, without a core file of its own.
fn end_by(signal: libc::c_int) {
    let none = libc::rlimit {
        rlim_cur: 0,
        rlim_max: 0,
    };
    // SAFETY: plain system calls with live structures; this process has one thread.
    unsafe {
        libc::setrlimit(libc::RLIMIT_CORE, &none);
        libc::signal(signal, libc::SIG_DFL);
        let mut only: libc::sigset_t = core::mem::zeroed();
        libc::sigemptyset(&mut only);
        libc::sigaddset(&mut only, signal);
        libc::sigprocmask(libc::SIG_UNBLOCK, &only, core::ptr::null_mut());
        libc::kill(std::process::id() as libc::pid_t, signal);
    }
}
