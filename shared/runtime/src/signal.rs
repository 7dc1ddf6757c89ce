//! How a process learns that it has to end: SIGTERM, SIGINT, SIGHUP unless it was ignored from the start, or its
//! launcher's death.
//!
//! The handlers only set a flag and write to an event descriptor, which every wait polls; so no wait can miss a signal
//! that came just before it. The launcher's death arrives twice over: as SIGHUP by `PR_SET_PDEATHSIG`, and through a
//! process descriptor in the polled set (which also works for a process that a shell started for the launcher). An
//! alarm then ends, after a second, a process too busy to look.

use crate::error::NodeError;
use crate::instance;
use core::sync::atomic::{AtomicBool, AtomicI32, Ordering};
use std::os::fd::RawFd;
use std::sync::OnceLock;

static STOP: AtomicBool = AtomicBool::new(false);
static STOP_DESCRIPTOR: AtomicI32 = AtomicI32::new(-1);
static LAUNCHER: AtomicI32 = AtomicI32::new(0);
static INSTALLED: OnceLock<Result<(), i32>> = OnceLock::new();

/// Whether this process has been told to end.
pub fn stop_requested() -> bool {
    STOP.load(Ordering::Relaxed)
}

/// Becomes readable once, and for good, when the process is told to end; −1 before [`install`].
pub(crate) fn stop_descriptor() -> RawFd {
    STOP_DESCRIPTOR.load(Ordering::Relaxed)
}

/// Ends this process cleanly at its next wait; callable from a signal handler.
pub(crate) fn request_stop() {
    STOP.store(true, Ordering::Relaxed);
    let descriptor = STOP_DESCRIPTOR.load(Ordering::Relaxed);
    if descriptor >= 0 {
        let one = 1u64;
        // SAFETY: writes 8 bytes of a live variable; `write` may be called from a signal handler.
        unsafe { libc::write(descriptor, (&raw const one).cast(), 8) };
    }
}

/// The launcher is dead: stop, and be ended within a second if that does not work.
pub(crate) fn launcher_died() {
    request_stop();
    // SAFETY: no arguments to get wrong; `alarm` may be called from a signal handler.
    unsafe { libc::alarm(1) };
}

extern "C" fn on_stop(_signal: libc::c_int) {
    request_stop();
}

extern "C" fn on_parent_death(_signal: libc::c_int) {
    // The death signal also comes when only the launcher's thread that spawned us ends.
    // SAFETY: `getppid` cannot fail and may be called from a signal handler.
    if unsafe { libc::getppid() } != LAUNCHER.load(Ordering::Relaxed) {
        launcher_died();
    }
}

fn system(call: &'static str) -> NodeError {
    NodeError::System {
        call,
        source: std::io::Error::last_os_error(),
    }
}

/// Whether this process was started, as by `nohup`, with a signal ignored.
fn is_ignored(signal: libc::c_int) -> bool {
    // SAFETY: asks for the present action, into a live structure.
    unsafe {
        let mut action: libc::sigaction = core::mem::zeroed();
        libc::sigaction(signal, core::ptr::null(), &mut action) == 0
            && action.sa_sigaction == libc::SIG_IGN
    }
}

/// Installs the handlers, once per process.
pub(crate) fn install() -> Result<(), NodeError> {
    let installed = INSTALLED.get_or_init(|| {
        // SAFETY: plain system calls with valid arguments; the handlers do only what handlers may.
        unsafe {
            let descriptor = libc::eventfd(0, libc::EFD_CLOEXEC | libc::EFD_NONBLOCK);
            if descriptor < 0 {
                return Err(*libc::__errno_location());
            }
            STOP_DESCRIPTOR.store(descriptor, Ordering::Relaxed);
            for signal in [libc::SIGTERM, libc::SIGINT, libc::SIGHUP] {
                if signal == libc::SIGHUP && is_ignored(signal) {
                    continue; // `nohup`
                }
                let mut action: libc::sigaction = core::mem::zeroed();
                action.sa_sigaction = on_stop as *const () as usize;
                action.sa_flags = libc::SA_RESTART;
                if libc::sigaction(signal, &action, core::ptr::null_mut()) != 0 {
                    return Err(*libc::__errno_location());
                }
            }
        }
        Ok(())
    });
    (*installed).map_err(|code| NodeError::System {
        call: "installing signal handlers",
        source: std::io::Error::from_raw_os_error(code),
    })
}

/// Ties this process's life to the launcher's. Returns the launcher's process descriptor, to be polled.
pub(crate) fn follow_launcher(arguments: &crate::RunArguments) -> Result<RawFd, NodeError> {
    let gone = || NodeError::LauncherGone {
        instance: arguments.instance.clone(),
        pid: arguments.launcher_pid,
    };
    let launcher = arguments.launcher_pid as libc::pid_t;
    LAUNCHER.store(launcher, Ordering::Relaxed);
    // SAFETY: plain system calls with valid arguments.
    unsafe {
        if libc::getppid() == launcher {
            let mut action: libc::sigaction = core::mem::zeroed();
            action.sa_sigaction = on_parent_death as *const () as usize;
            action.sa_flags = libc::SA_RESTART;
            if libc::sigaction(libc::SIGHUP, &action, core::ptr::null_mut()) != 0 {
                return Err(system("sigaction"));
            }
            if libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGHUP) != 0 {
                return Err(system("prctl"));
            }
        }
        let descriptor = libc::syscall(libc::SYS_pidfd_open, launcher, 0) as RawFd;
        if descriptor < 0 {
            return Err(match *libc::__errno_location() {
                libc::ESRCH => gone(),
                _ => system("pidfd_open"),
            });
        }
        // The launcher may have died, and its id been given away, between its spawning us and the lines above: a living
        // launcher holds its instance's lock.
        if libc::getppid() != launcher && !instance::is_locked(&arguments.root, &arguments.instance)
        {
            libc::close(descriptor);
            return Err(gone());
        }
        Ok(descriptor)
    }
}

/// Names this thread for `ps` and `top`, in at most 15 bytes.
pub fn name_thread(name: &str) {
    if let Ok(name) = std::ffi::CString::new(name) {
        // SAFETY: a zero-terminated text, of which the system copies what it has room for.
        unsafe { libc::prctl(libc::PR_SET_NAME, name.as_ptr()) };
    }
}
