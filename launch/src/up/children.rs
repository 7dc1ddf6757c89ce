//! The processes of a run, as operating-system processes: started, watched, ended.

use super::plan::Plan;
use crate::process::NAMES;
use crate::screen::Screen;
use anyhow::{Context, Result};
use runtime::{Launcher, RunArguments, process_descriptor};
use std::io::{BufRead, BufReader, Read};
use std::os::fd::{AsRawFd, OwnedFd, RawFd};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread::JoinHandle;

/// A started process.
struct Running {
    child: Child,
    descriptor: OwnedFd,
    ended: Option<ExitStatus>,
}

/// All processes of a run, in launch order. Dropped, it leaves none alive.
pub struct Children {
    running: Vec<Running>,
    readers: Vec<JoinHandle<()>>,
}

impl Children {
    /// Starts them all, in launch order, from this thread: their lives are tied to it.
    ///
    /// # Errors
    /// When one cannot be started; those that were are ended.
    pub fn start(plan: &Plan, launcher: &Launcher, screen: &Screen) -> Result<Self> {
        let mut children = Self {
            running: Vec::new(),
            readers: Vec::new(),
        };
        for (index, name) in NAMES.into_iter().enumerate() {
            let arguments = plan.arguments(launcher.arguments(), index)?;
            let mut child = command(plan, name, &arguments)?
                .stdin(Stdio::null())
                .stdout(Stdio::piped())
                .stderr(Stdio::piped())
                // Ctrl-C reaches the launcher alone, which ends the others in order.
                .process_group(0)
                .spawn()
                .with_context(|| format!("starting {name}"))?;
            let mut readers = Vec::new();
            if let Some(out) = child.stdout.take() {
                let screen = screen.clone();
                readers.push(forward(out, move |line| screen.line(line)));
            }
            if let Some(err) = child.stderr.take() {
                let screen = screen.clone();
                readers.push(forward(err, move |line| {
                    screen.warn(&format!("{name}: {line}"))
                }));
            }
            // Somebody else's program may leave a child behind that keeps the pipe open: it is not waited for.
            if !plan.exec.contains_key(name) {
                children.readers.append(&mut readers);
            }
            let descriptor = match process_descriptor(child.id()) {
                Ok(descriptor) => descriptor,
                Err(error) => {
                    let _ = child.kill();
                    let _ = child.wait();
                    return Err(error).with_context(|| format!("watching {name}"));
                }
            };
            children.running.push(Running {
                child,
                descriptor,
                ended: None,
            });
        }
        Ok(children)
    }

    /// What to poll, in launch order; −1 for those that have ended.
    pub fn descriptors(&self) -> [RawFd; NAMES.len()] {
        let mut descriptors = [-1; NAMES.len()];
        for (descriptor, running) in descriptors.iter_mut().zip(&self.running) {
            if running.ended.is_none() {
                *descriptor = running.descriptor.as_raw_fd();
            }
        }
        descriptors
    }

    /// Waits until one ends, at most so long.
    ///
    /// # Errors
    /// When the operating system cannot tell.
    pub fn wait(&self, timeout_ns: u64) -> Result<Option<usize>> {
        let mut polled = self.descriptors().map(|fd| libc::pollfd {
            fd,
            events: libc::POLLIN,
            revents: 0,
        });
        // SAFETY: a live array of the stated length.
        let ready = unsafe {
            libc::poll(
                polled.as_mut_ptr(),
                polled.len() as libc::nfds_t,
                (timeout_ns / 1_000_000) as i32,
            )
        };
        if ready < 0 {
            let error = std::io::Error::last_os_error();
            return if error.kind() == std::io::ErrorKind::Interrupted {
                Ok(None)
            } else {
                Err(error).context("poll")
            };
        }
        Ok(polled.iter().position(|polled| polled.revents != 0))
    }

    /// Ends those that are still there, giving them a second to say why they had to, and shows what they printed.
    pub fn end(&mut self) {
        self.signal(libc::SIGTERM);
        for _ in 0..20 {
            if self.all_ended() {
                break;
            }
            if let Ok(Some(index)) = self.wait(50_000_000) {
                let _ = self.reap(index);
            }
        }
        self.signal(libc::SIGKILL);
        for index in 0..self.running.len() {
            let _ = self.reap(index);
        }
        self.drain_output();
    }

    /// Takes note that a process has ended, and says how.
    ///
    /// # Errors
    /// When the operating system does not say.
    pub fn reap(&mut self, index: usize) -> Result<String> {
        let running = &mut self.running[index];
        let status = running
            .child
            .wait()
            .with_context(|| format!("waiting for {}", NAMES[index]))?;
        running.ended = Some(status);
        Ok(match (status.code(), status.signal()) {
            (Some(code), _) => format!("ended with status {code}"),
            (None, Some(signal)) => format!("was killed by signal {signal}"),
            (None, None) => "ended".to_owned(),
        })
    }

    /// Whether all have ended.
    pub fn all_ended(&self) -> bool {
        self.running.iter().all(|running| running.ended.is_some())
    }

    /// Sends a signal to those that are still there.
    pub fn signal(&self, signal: libc::c_int) {
        for running in self
            .running
            .iter()
            .filter(|running| running.ended.is_none())
        {
            // SAFETY: signals a child that was not reaped yet, so its id is still its own.
            unsafe { libc::kill(running.child.id() as libc::pid_t, signal) };
        }
    }

    /// Waits until everything that the processes printed has been shown; only when all have ended.
    pub fn drain_output(&mut self) {
        for reader in self.readers.drain(..) {
            let _ = reader.join();
        }
    }
}

impl Drop for Children {
    fn drop(&mut self) {
        self.signal(libc::SIGKILL);
        for running in self
            .running
            .iter_mut()
            .filter(|running| running.ended.is_none())
        {
            let _ = running.child.wait();
        }
    }
}

/// Our own executable, or the program that stands in for it.
fn command(plan: &Plan, name: &str, arguments: &RunArguments) -> Result<Command> {
    let file = arguments
        .write()
        .with_context(|| format!("arguments of {name}"))?;
    Ok(match plan.exec.get(name) {
        Some(replacement) => {
            let mut command = Command::new("/bin/sh");
            command
                .arg("-c")
                .arg(format!("exec {replacement} \"$@\""))
                .arg(name)
                .arg(file);
            command
        }
        None => {
            let mut command =
                Command::new(std::env::current_exe().context("finding our own executable")?);
            command.arg("process").arg(file);
            command
        }
    })
}

/// Hands every line that comes to `show`, from a thread of its own.
fn forward(
    source: impl Read + Send + 'static,
    show: impl Fn(&str) + Send + 'static,
) -> JoinHandle<()> {
    std::thread::spawn(move || {
        for line in BufReader::new(source).lines().map_while(Result::ok) {
            show(&line);
        }
    })
}
