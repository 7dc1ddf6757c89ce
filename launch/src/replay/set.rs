//! The four processes of a replay: the replayer in place of world, driver and renderer, and the three that are asked.

use super::resolve::Resolved;
use crate::own;
use crate::screen::Screen;
use crate::suspend::Suspension;
use anyhow::{Context, Result, bail, ensure};
use messages::ProcessState;
use runtime::{Launcher, LauncherWake, now_ns, process_descriptor, text_of};
use std::io::{BufRead, BufReader, Read};
use std::os::fd::{AsRawFd, OwnedFd, RawFd};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Child, Stdio};
use std::thread::JoinHandle;

/// In launch order; a process's place is its index in messages.
const NAMES: [&str; 4] = ["replay", "belief", "human", "planner"];
const MS: u64 = 1_000_000;
/// How long processes may take to read their models and make their ports.
const READY_NS: u64 = 60_000 * MS;
/// How often the status line is brought up to date.
const LOOK_NS: u64 = 100 * MS;
/// After the word to stop, a process has this long.
const STOP_NS: u64 = 5_000 * MS;

/// Started processes. Dropped, it leaves none alive.
pub struct Set {
    children: Vec<(Child, OwnedFd)>,
    readers: Vec<JoinHandle<()>>,
}

impl Set {
    /// Starts them all.
    ///
    /// # Errors
    /// When one cannot be started; those that were are ended.
    pub fn start(
        launcher: &Launcher,
        resolved: &Resolved,
        recording: &Path,
        rows: &Path,
        screen: &Screen,
    ) -> Result<Self> {
        let mut set = Self {
            children: Vec::new(),
            readers: Vec::new(),
        };
        let recording = std::path::absolute(recording).context("the recording's path")?;
        for (index, name) in NAMES.into_iter().enumerate() {
            let plain = launcher.arguments().for_process(name, index as u32);
            let arguments = match name {
                "belief" => plain.with_options(&resolved.belief),
                "human" => plain.with_options(&resolved.human),
                "planner" => plain.with_options(&resolved.planner),
                _ => plain.with_options(&::replay::ReplayOptions {
                    recording: recording.clone(),
                    rows: rows.to_owned(),
                }),
            };
            let arguments = arguments.with_context(|| format!("options of {name}"))?;
            let file = arguments
                .write()
                .with_context(|| format!("arguments of {name}"))?;
            let mut child = own::command()
                .arg("process")
                .arg(file)
                .stdin(Stdio::null())
                .stdout(Stdio::null())
                .stderr(Stdio::piped())
                // Ctrl-C reaches the launcher alone, which ends the others.
                .process_group(0)
                .spawn()
                .with_context(|| format!("starting {name}"))?;
            if let Some(err) = child.stderr.take() {
                let screen = screen.clone();
                set.readers.push(forward(err, move |line| {
                    screen.warn(&format!("{name}: {line}"))
                }));
            }
            match process_descriptor(child.id()) {
                Ok(descriptor) => set.children.push((child, descriptor)),
                Err(error) => {
                    let _ = child.kill();
                    let _ = child.wait();
                    return Err(error).with_context(|| format!("watching {name}"));
                }
            }
        }
        Ok(set)
    }

    fn descriptors(&self) -> [RawFd; NAMES.len()] {
        core::array::from_fn(|index| self.children[index].1.as_raw_fd())
    }

    /// Starts the replay and waits for its end.
    ///
    /// # Errors
    /// When a process fails or ends before the replay does, or the user ends it.
    pub fn play(&mut self, launcher: &mut Launcher, screen: &Screen) -> Result<()> {
        let suspension = Suspension::new()?;
        let descriptors = self.descriptors();
        launcher
            .wait_ready(&NAMES, &descriptors, now_ns() + READY_NS)
            .context("the replay did not start")?;
        launcher.start()?;
        let mut watched = descriptors.to_vec();
        watched.push(suspension.descriptor());
        loop {
            match launcher.wait(&watched, Some(now_ns() + LOOK_NS))? {
                LauncherWake::Report => {
                    while let Some(report) = launcher.next_report()? {
                        if report.header.run_id != launcher.arguments().run_id {
                            continue;
                        }
                        match (report.state(), report.index) {
                            (Ok(ProcessState::Finished), 0) => return Ok(()),
                            (Ok(ProcessState::Failed), _) => bail!(
                                "{} failed: {}",
                                text_of(&report.process),
                                text_of(&report.text)
                            ),
                            (_, 0) => screen.status(format!("replaying · {} steps", report.steps)),
                            _ => {}
                        }
                    }
                }
                LauncherWake::Child(index) if index >= descriptors.len() => {
                    suspension.heed(|signal| self.signal(signal));
                }
                LauncherWake::Child(index) => {
                    let status = self.children[index]
                        .0
                        .wait()
                        .context("waiting for a process")?;
                    bail!("{} ended before the replay did: {status}", NAMES[index]);
                }
                LauncherWake::Stop => bail!("interrupted"),
                LauncherWake::Deadline => {
                    if screen.has_status() {
                        launcher.request_reports()?;
                    }
                }
            }
        }
    }

    fn signal(&self, signal: libc::c_int) {
        for (child, _) in &self.children {
            // SAFETY: signals a child that was not waited for; of one that was, no other can have its number yet.
            unsafe { libc::kill(child.id() as libc::pid_t, signal) };
        }
    }

    /// Asks those that are left to end, and makes them.
    ///
    /// # Errors
    /// When one died of a signal that it was not sent here.
    pub fn end(&mut self, launcher: &mut Launcher, well: bool) -> Result<()> {
        let mut died = Vec::new();
        let asked = well && launcher.stop().is_ok();
        let deadline = now_ns() + if asked { STOP_NS } else { 0 };
        for ((child, descriptor), name) in self.children.iter_mut().zip(NAMES) {
            let left = deadline.saturating_sub(now_ns()) / MS;
            let mut poll = libc::pollfd {
                fd: descriptor.as_raw_fd(),
                events: libc::POLLIN,
                revents: 0,
            };
            // SAFETY: a live array of one.
            let ended = unsafe { libc::poll(&raw mut poll, 1, left as libc::c_int) } > 0;
            if !ended {
                let _ = child.kill();
            }
            let status = child.wait();
            if let Some(status) = status.ok().filter(|s| ended && s.signal().is_some()) {
                died.push(format!("{name}: {status}"));
            }
        }
        for reader in self.readers.drain(..) {
            let _ = reader.join();
        }
        ensure!(died.is_empty(), "died at its end: {}", died.join(", "));
        Ok(())
    }
}

impl Drop for Set {
    fn drop(&mut self) {
        for (child, _) in &mut self.children {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
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
