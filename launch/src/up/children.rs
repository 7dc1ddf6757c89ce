//! The processes of a run, as operating-system processes: started, watched, ended.

use super::activity::GroupActivity;
use super::ended::{Cause, Ended, how_it_ended};
use super::phase::Phase;
use super::plan::RunPlan;
use crate::guard;
use crate::own;
use crate::process::NAMES;
use crate::screen::Screen;
use anyhow::{Context, Result};
use runtime::{Launcher, RunArguments, now_ns, process_descriptor};
use std::cell::Cell;
use std::io::{BufRead, BufReader, Read};
use std::os::fd::{AsRawFd, OwnedFd, RawFd};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child as OsChild, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

/// A living process.
pub struct Child {
    /// Place in [`NAMES`]: what it does.
    pub place: usize,
    /// Its number in messages: no two processes of a run have the same.
    pub index: u32,
    /// What it is doing.
    pub phase: Phase,
    /// When it was last heard of, or in lockstep seen to compute.
    pub heard_ns: u64,
    /// When it was last heard of itself.
    pub answered_ns: u64,
    /// What it did when it was last looked at, since it has not answered.
    pub activity: Option<GroupActivity>,
    /// Whether it was said that it computes for so long.
    pub was_waited_for: bool,
    /// What it said of its failure, or the launcher of why it is ended.
    pub why: Option<String>,
    child: OsChild,
    /// Our own executable; else a guard with somebody else's program behind it.
    is_ours: bool,
    /// Whether the launcher ended it.
    was_signalled: Cell<bool>,
    descriptor: OwnedFd,
    /// Shows what it writes to its standard error; for our own executable, which closes that when it ends.
    errors: Option<JoinHandle<()>>,
    last_words: Arc<Mutex<String>>,
}

impl Child {
    /// Process id.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// It was heard of.
    pub fn answers(&mut self) {
        let now = now_ns();
        (self.heard_ns, self.answered_ns, self.activity) = (now, now, None);
    }

    /// Sends a signal to it and to what it has started.
    pub fn signal(&self, signal: libc::c_int) {
        self.was_signalled.set(true);
        self.send(signal);
    }

    /// Stops it with SIGSTOP, or has it go on with SIGCONT, and with it what it has started.
    fn suspend(&self, signal: libc::c_int) {
        self.send(signal);
        if self.is_ours {
            return;
        }
        // Somebody else's program may have children in other process groups.
        for pid in guard::descendants(self.child.id()) {
            // SAFETY: signals a descendant of our child.
            unsafe { libc::kill(pid as libc::pid_t, signal) };
        }
    }

    /// Sends a signal to its process group.
    fn send(&self, signal: libc::c_int) {
        let group = self.child.id() as libc::pid_t;
        // SAFETY: signals the group of a child that was not waited for yet, so its id is still its own.
        unsafe { libc::kill(-group, signal) };
    }
}

/// All living processes of a run. Dropped, it leaves none alive.
pub struct Children {
    living: Vec<Child>,
    next: u32,
    readers: Vec<JoinHandle<()>>,
}

impl Children {
    /// Nobody yet.
    pub fn new() -> Self {
        Self {
            living: Vec::new(),
            next: 0,
            readers: Vec::new(),
        }
    }

    /// Starts every process once, in launch order.
    ///
    /// # Errors
    /// When one cannot be started.
    pub fn start_all(
        &mut self,
        plan: &RunPlan,
        launcher: &Launcher,
        screen: &Screen,
    ) -> Result<()> {
        for place in 0..NAMES.len() {
            self.start(plan, launcher, screen, place, false)?;
        }
        Ok(())
    }

    /// Starts a process, from this thread: its life is tied to it. Returns its number.
    ///
    /// # Errors
    /// When it cannot be started.
    pub fn start(
        &mut self,
        plan: &RunPlan,
        launcher: &Launcher,
        screen: &Screen,
        place: usize,
        standby: bool,
    ) -> Result<u32> {
        let name = NAMES[place];
        let index = self.next;
        let arguments = RunArguments {
            index,
            standby,
            ..plan.arguments(launcher.arguments(), place)?
        };
        // Somebody else's program may leave a child behind that keeps the pipe open: it is not waited for.
        let is_ours = !plan.exec.contains_key(name);
        if !is_ours {
            guard::adopt_orphans()?;
        }
        let mut child = command(plan, name, &arguments)?
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // Ctrl-C reaches the launcher alone, which ends the others in order.
            .process_group(0)
            .spawn()
            .with_context(|| format!("starting {name}"))?;
        if let Some(out) = child.stdout.take() {
            let screen = screen.clone();
            let reader = forward(out, move |line| screen.line(line));
            self.readers.extend(is_ours.then_some(reader));
        }
        let last_words = Arc::new(Mutex::new(String::new()));
        let mut errors = None;
        if let Some(err) = child.stderr.take() {
            let (screen, last_words) = (screen.clone(), last_words.clone());
            let reader = forward(err, move |line| {
                screen.warn(&format!("{name}: {line}"));
                if let Ok(mut words) = last_words.lock() {
                    line.trim_start_matches("mirror: ").clone_into(&mut words);
                }
            });
            errors = is_ours.then_some(reader);
        }
        let descriptor = match process_descriptor(child.id()) {
            Ok(descriptor) => descriptor,
            Err(error) => {
                let _ = child.kill();
                let _ = child.wait();
                return Err(error).with_context(|| format!("watching {name}"));
            }
        };
        self.next += 1;
        let now = now_ns();
        self.living.push(Child {
            place,
            index,
            phase: Phase::Starting,
            heard_ns: now,
            answered_ns: now,
            activity: None,
            was_waited_for: false,
            why: None,
            child,
            is_ours,
            was_signalled: Cell::new(false),
            descriptor,
            errors,
            last_words,
        });
        Ok(index)
    }

    /// The living.
    pub fn living(&self) -> &[Child] {
        &self.living
    }

    /// As [`Children::living`].
    pub fn living_mut(&mut self) -> &mut [Child] {
        &mut self.living
    }

    /// The living process of that number.
    pub fn get(&self, index: u32) -> Option<&Child> {
        self.living.iter().find(|child| child.index == index)
    }

    /// As [`Children::get`].
    pub fn get_mut(&mut self, index: u32) -> Option<&mut Child> {
        self.living.iter_mut().find(|child| child.index == index)
    }

    /// Who does the part of a place now.
    pub fn active(&self, place: usize) -> Option<&Child> {
        self.living
            .iter()
            .find(|child| child.place == place && child.phase == Phase::Active)
    }

    /// All living ones are active: the run has started.
    pub fn all_active(&mut self) {
        for child in &mut self.living {
            child.phase = Phase::Active;
            child.answers();
        }
    }

    /// What to poll, in the order of [`Children::living`].
    pub fn descriptors(&self) -> Vec<RawFd> {
        self.living
            .iter()
            .map(|child| child.descriptor.as_raw_fd())
            .collect()
    }

    /// Waits until one ends, at most so long; its place in [`Children::living`].
    ///
    /// # Errors
    /// When the operating system cannot tell.
    pub fn wait(&self, timeout_ns: u64) -> Result<Option<usize>> {
        let mut polled: Vec<_> = self
            .descriptors()
            .into_iter()
            .map(|fd| libc::pollfd {
                fd,
                events: libc::POLLIN,
                revents: 0,
            })
            .collect();
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

    /// Takes note that the process at this place in [`Children::living`] has ended, and says how.
    ///
    /// # Errors
    /// When the operating system does not say.
    pub fn reap(&mut self, at: usize) -> Result<Ended> {
        let mut ended = self.living.remove(at);
        let name = NAMES[ended.place];
        // Until it is waited for, its group is its own. A guard that was killed leaves a program behind.
        ended.send(libc::SIGKILL);
        let status = ended
            .child
            .wait()
            .with_context(|| format!("waiting for {name}"))?;
        if !ended.is_ours {
            self.end_strays();
        }
        let mut how = how_it_ended(status);
        // One that ends as soon as it has begun may have had no time to report.
        if let Some(errors) = ended.errors.take() {
            let _ = errors.join();
        }
        if ended.why.is_none()
            && status.code().is_some_and(|code| code != 0)
            && let Ok(words) = ended.last_words.lock()
            && !words.is_empty()
        {
            ended.why = Some(words.clone());
        }
        if let Some(why) = ended.why {
            how += &format!(" ({why})");
        }
        let cause = Cause::of(status, ended.is_ours, ended.was_signalled.get());
        Ok(Ended {
            place: ended.place,
            index: ended.index,
            phase: ended.phase,
            how,
            cause,
            is_ours: ended.is_ours,
            signal: status.signal(),
            well: status.success(),
        })
    }

    /// Ends those that are still there, giving them a second to say why they had to, and shows what they printed.
    pub fn end(&mut self) {
        self.signal(libc::SIGTERM);
        for _ in 0..20 {
            if self.living.is_empty() {
                break;
            }
            if let Ok(Some(at)) = self.wait(50_000_000) {
                let _ = self.reap(at);
            }
        }
        self.signal(libc::SIGKILL);
        while !self.living.is_empty() {
            let _ = self.reap(0);
        }
        self.drain_output();
    }

    /// Sends a signal to those that are still there.
    pub fn signal(&self, signal: libc::c_int) {
        for child in &self.living {
            child.signal(signal);
        }
    }

    /// Ends what somebody else's programs started and nobody guards any more: this process has become its parent.
    fn end_strays(&self) {
        let known: Vec<u32> = self.living.iter().map(Child::pid).collect();
        guard::end_strays(&known);
    }

    /// Suspends everybody with SIGSTOP, or has everybody go on with SIGCONT.
    pub fn suspend(&self, signal: libc::c_int) {
        for child in &self.living {
            child.suspend(signal);
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
        while !self.living.is_empty() {
            let _ = self.reap(0);
        }
    }
}

/// Our own executable, or the program that stands in for it.
fn command(plan: &RunPlan, name: &str, arguments: &RunArguments) -> Result<Command> {
    let file = arguments
        .write()
        .with_context(|| format!("arguments of {name}"))?;
    Ok(match plan.exec.get(name) {
        Some(replacement) => {
            let mut command = own::command();
            command
                .arg("exec-guard")
                .arg(std::process::id().to_string())
                .args(["--", name, replacement])
                .arg(file);
            command
        }
        None => {
            let mut command = own::command();
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
