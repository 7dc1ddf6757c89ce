//! `mirror up`: starts the process set, watches it to its end, and sums it up.
//!
//! What the end of a process means, whoever caused it:
//!
//! | process | before the run is over |
//! | --- | --- |
//! | world, driver, belief, human, planner, renderer | the run ends: `ended_early` names the process and how it ended |
//! | recorder | the run goes on without: the recording is incomplete and there is no digest |
//! | launcher | everybody ends within a second; the next `up` or `doctor --clean` removes what is left |
//!
//! In each case the exit status is 1, and no process, file or shared memory stays.

mod children;
mod plan;
mod summary;
mod tally;

use crate::cli::UpArguments;
use crate::doctor::SHARED_MEMORY_NEEDED;
use crate::failure::Failure;
use crate::process::NAMES;
use crate::screen::Screen;
use anyhow::{Context, Result, anyhow};
use children::Children;
use plan::Plan;
use runtime::instance::{default_root, shared_memory_free};
use runtime::{InstanceLock, Launcher, LauncherWake, now_ns, text_of};
use std::process::ExitCode;
use summary::{Ending, Summary};
use tally::Tally;

const MS: u64 = 1_000_000;
/// How long processes may take to read their models and make their ports.
const READY_NS: u64 = 60_000 * MS;
/// How often the status line and the counts are brought up to date.
const LOOK_NS: u64 = 50 * MS;
/// After the word to stop, a process has this long: a recorder may still be writing.
const STOP_NS: u64 = 20_000 * MS;
/// After SIGTERM.
const TERM_NS: u64 = 2_000 * MS;
/// Place of the world in launch order.
const WORLD: usize = 0;
/// Place of the recorder.
const RECORDER: usize = NAMES.len() - 1;

/// Runs `mirror up`.
pub fn up(arguments: &UpArguments) -> Result<ExitCode, Failure> {
    let mut plan = Plan::resolve(arguments).map_err(Failure::refused)?;
    let free = shared_memory_free();
    if free < SHARED_MEMORY_NEEDED {
        let (free, needed) = (free >> 20, SHARED_MEMORY_NEEDED >> 20);
        return Err(Failure::refused(anyhow!(
            "/dev/shm has {free} MiB free, a set of processes needs {needed}"
        )));
    }
    let lock = InstanceLock::acquire(&default_root(), &plan.instance).map_err(Failure::refused)?;
    let run_id = now_ns() ^ u64::from(std::process::id()) << 40;
    let mut launcher = Launcher::open(lock, run_id, plan.clock)?;
    plan.learn(launcher.arguments())?;
    let screen = Screen::new();
    screen.status(format!("starting {} processes", NAMES.len()));
    let mut tally = Tally::new(&launcher, plan.scene.scene.step_s())?;
    let mut children = Children::start(&plan, &launcher, &screen)?;
    let run = Run {
        plan: &plan,
        launcher: &mut launcher,
        children: &mut children,
        screen: &screen,
        tally: &mut tally,
    };
    let ending = run.complete();
    if ending.is_err() {
        children.end();
    }
    screen.finish();
    let ending = ending?;
    tally.close();
    let summary = Summary::new(&plan, &tally, ending);
    screen.line(&summary.text());
    if let Some(path) = &plan.summary {
        summary.save(path)?;
    }
    Ok(if summary.is_success() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

/// A run from its start to the end of its last process.
struct Run<'a> {
    plan: &'a Plan,
    launcher: &'a mut Launcher,
    children: &'a mut Children,
    screen: &'a Screen,
    tally: &'a mut Tally,
}

impl Run<'_> {
    fn complete(mut self) -> Result<Ending> {
        let mut ending = Ending::default();
        self.wait_ready()?;
        self.launcher.start()?;
        let started = now_ns();
        self.watch(&mut ending, started)?;
        ending.wall_seconds = (now_ns() - started) as f64 * 1e-9;
        self.stop(&mut ending)?;
        self.children.drain_output();
        self.tally.update()?;
        let result = self.plan.recorder_result(self.launcher.arguments());
        if let Ok(text) = std::fs::read_to_string(&result) {
            ending.recording = Some(serde_json::from_str(&text).context("the recorder's result")?);
        }
        self.launcher.clean()?;
        Ok(ending)
    }

    fn wait_ready(&mut self) -> Result<()> {
        let ready =
            self.launcher
                .wait_ready(&NAMES, &self.children.descriptors(), now_ns() + READY_NS);
        ready.context("the process set did not start")
    }

    /// Until the world has finished, or something ends the run before.
    fn watch(&mut self, ending: &mut Ending, started: u64) -> Result<()> {
        let mut next_status = 0;
        loop {
            match self
                .launcher
                .wait(&self.children.descriptors(), Some(now_ns() + LOOK_NS))?
            {
                LauncherWake::Report => {
                    if self.take_reports(ending)? {
                        return Ok(());
                    }
                }
                LauncherWake::Child(index) => {
                    let how = self.children.reap(index)?;
                    self.screen.warn(&format!("mirror: {} {how}", NAMES[index]));
                    ending.deaths.insert(NAMES[index].to_owned(), how.clone());
                    self.launcher.clean()?;
                    if index != RECORDER {
                        ending
                            .ended_early
                            .get_or_insert(format!("{} {how}", NAMES[index]));
                        return Ok(());
                    }
                }
                LauncherWake::Stop => {
                    ending.ended_early = Some("interrupted".to_owned());
                    return Ok(());
                }
                LauncherWake::Deadline => {}
            }
            if now_ns() >= next_status {
                next_status = now_ns() + LOOK_NS;
                self.tally.update()?;
                self.show_status(started);
            }
        }
    }

    /// Keeps every process's newest report; true if the world has finished.
    fn take_reports(&mut self, ending: &mut Ending) -> Result<bool> {
        let mut over = false;
        while let Some(report) = self.launcher.next_report()? {
            let index = report.index as usize;
            if report.header.run_id != self.launcher.arguments().run_id || index >= NAMES.len() {
                continue;
            }
            let text = text_of(&report.text);
            match report.state {
                3 if index == WORLD => over = true,
                4 => {
                    let how = format!("failed: {text}");
                    if index != RECORDER {
                        ending
                            .ended_early
                            .get_or_insert(format!("{} {how}", NAMES[index]));
                    }
                    ending.deaths.insert(NAMES[index].to_owned(), how);
                }
                _ if !text.is_empty() => self.screen.warn(&format!("{}: {text}", NAMES[index])),
                _ => {}
            }
            ending.reports[index] = Some(report);
        }
        Ok(over)
    }

    /// Asks everybody to end, then tells them, then makes them.
    fn stop(&mut self, ending: &mut Ending) -> Result<()> {
        self.screen.status("stopping".to_owned());
        self.launcher.stop()?;
        let mut deadline = now_ns() + STOP_NS;
        let mut signals = [libc::SIGTERM, libc::SIGKILL].into_iter();
        while !self.children.all_ended() {
            let ended = self.children.wait(LOOK_NS)?;
            self.take_reports(ending)?;
            self.tally.update()?;
            if let Some(index) = ended {
                let how = self.children.reap(index)?;
                if ending.reports[index].is_none_or(|report| report.state != 3) {
                    ending.deaths.entry(NAMES[index].to_owned()).or_insert(how);
                }
            } else if now_ns() >= deadline
                && let Some(signal) = signals.next()
            {
                self.children.signal(signal);
                deadline = now_ns() + TERM_NS;
            }
        }
        Ok(())
    }

    fn show_status(&self, started: u64) {
        if !self.screen.has_status() {
            return;
        }
        let (steps, episodes) = (self.tally.steps(), &self.tally.episodes);
        let step = episodes.last().map_or(0, |episode| episode.steps);
        let speed = steps as f64 * 1e9 / (now_ns() - started).max(1) as f64;
        let collisions = episodes
            .iter()
            .filter(|episode| episode.hit.is_some())
            .count();
        let said: u64 = episodes.iter().map(|episode| episode.verbal_items).sum();
        let shown: usize = episodes.iter().map(|episode| episode.shown.len()).sum();
        self.screen.status(format!(
            "episode {}/{} · step {step} · {speed:.0} steps/s · {shown} highlights · {said} utterances · {collisions} collisions",
            episodes.len(),
            self.plan.episodes,
        ));
    }
}
