//! Ctrl-Z: a set stops as a whole with its launcher, and goes on with it.
//!
//! The processes of a set are in process groups of their own, which the terminal's SIGTSTP does not reach. The launcher
//! stops them, then itself, and has them go on when it does. The run's clock stands still meanwhile ([`runtime::stand_still`]).

use anyhow::{Result, bail};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd, RawFd};
use std::sync::atomic::{AtomicI32, Ordering};

/// What the handler writes to; −1 without one.
static ASKED: AtomicI32 = AtomicI32::new(-1);

extern "C" fn on_suspend(_signal: libc::c_int) {
    let (asked, one) = (ASKED.load(Ordering::Relaxed), 1_u64);
    if asked >= 0 {
        // SAFETY: writes 8 bytes of a live variable; `write` may be called from a signal handler.
        unsafe { libc::write(asked, (&raw const one).cast(), 8) };
    }
}

/// Hears SIGTSTP in place of being stopped by it. There is one in a process.
pub struct Suspension {
    asked: OwnedFd,
}

impl Suspension {
    /// Listens from now on; not where the signal was ignored when this program was started.
    ///
    /// # Errors
    /// When the operating system does not let us.
    pub fn new() -> Result<Self> {
        // SAFETY: plain system calls with valid arguments; the descriptor is ours.
        unsafe {
            let asked = libc::eventfd(0, libc::EFD_CLOEXEC | libc::EFD_NONBLOCK);
            if asked < 0 {
                bail!("eventfd: {}", std::io::Error::last_os_error());
            }
            let asked = OwnedFd::from_raw_fd(asked);
            let mut present: libc::sigaction = core::mem::zeroed();
            libc::sigaction(libc::SIGTSTP, core::ptr::null(), &mut present);
            if present.sa_sigaction != libc::SIG_IGN {
                ASKED.store(asked.as_raw_fd(), Ordering::Relaxed);
                set_action(on_suspend as *const () as usize);
            }
            Ok(Self { asked })
        }
    }

    /// Becomes readable when the set shall be suspended.
    pub fn descriptor(&self) -> RawFd {
        self.asked.as_raw_fd()
    }

    /// For a launcher: suspends the set if that was asked for. Sends `signal`s to its processes, and returns when this process
    /// goes on; the run's clock stands still meanwhile.
    pub fn heed(&self, signal: impl Fn(libc::c_int)) {
        if self.is_asked() {
            signal(libc::SIGSTOP);
            runtime::stand_still(stop_here);
            signal(libc::SIGCONT);
        }
    }

    /// For who has a launcher as a child: whenever it is suspended, so is the launcher. Never returns.
    pub fn pass_on(&self, launcher: u32) {
        let signal = |signal| {
            // SAFETY: signals a child that this process ends with.
            unsafe { libc::kill(launcher as libc::pid_t, signal) };
        };
        loop {
            let mut polled = libc::pollfd {
                fd: self.descriptor(),
                events: libc::POLLIN,
                revents: 0,
            };
            // SAFETY: a live array of one.
            unsafe { libc::poll(&raw mut polled, 1, -1) };
            if self.is_asked() {
                signal(libc::SIGTSTP);
                stop_here();
                signal(libc::SIGCONT);
            }
        }
    }

    fn is_asked(&self) -> bool {
        let mut asked = 0_u64;
        // SAFETY: reads 8 bytes into a live variable.
        let read = unsafe { libc::read(self.descriptor(), (&raw mut asked).cast(), 8) };
        read == 8
    }
}

impl Drop for Suspension {
    fn drop(&mut self) {
        if ASKED.swap(-1, Ordering::Relaxed) >= 0 {
            set_action(libc::SIG_DFL);
        }
    }
}

/// Stops this process as SIGTSTP does without us: not where nobody would be there to have it go on.
fn stop_here() {
    set_action(libc::SIG_DFL);
    // SAFETY: signals this thread, which does not block the signal; it is stopped here.
    unsafe { libc::raise(libc::SIGTSTP) };
    set_action(on_suspend as *const () as usize);
}

fn set_action(handler: usize) {
    // SAFETY: a live structure of the right type; the handler does only what handlers may.
    unsafe {
        let mut action: libc::sigaction = core::mem::zeroed();
        action.sa_sigaction = handler;
        action.sa_flags = libc::SA_RESTART;
        libc::sigaction(libc::SIGTSTP, &action, core::ptr::null_mut());
    }
}
