//! A run from its start to the end of its last process.

use super::activity::GroupActivity;
use super::children::Children;
use super::control_socket::ControlSocket;
use super::ended::{Cause, Ended};
use super::heads::Heads;
use super::pages::Pages;
use super::phase::Phase;
use super::plan::RunPlan;
use super::starting::{self, READY_NS};
use super::summary::RunEnding;
use super::supervise::{Supervisor, ask_ns, handover_after_death, next_handover, patience_ns};
use super::swap::{Finished, Swap};
use super::tally::Tally;
use crate::process::NAMES;
use crate::screen::Screen;
use crate::suspend::Suspension;
use anyhow::{Context, Result};
use messages::{ProcessState, Report};
use recorder::result::RecorderResult;
use runtime::{ClockMode, Launcher, LauncherWake, now_ns, text_of};

pub(super) const MS: u64 = 1_000_000;
/// How often the status line and the counts are brought up to date …
pub(super) const LOOK_NS: u64 = 50 * MS;
/// … or after so many steps, if that is sooner: a lockstep world waits for a launcher that is twice as many behind.
const LOOK_STEPS: f64 = 320.0;
/// Place of the world in launch order.
const WORLD: usize = 0;
/// Place of the recorder.
pub const RECORDER: usize = NAMES.len() - 1;

/// A run.
pub struct Run<'a> {
    pub(super) plan: RunPlan,
    pub(super) launcher: &'a mut Launcher,
    pub(super) screen: &'a Screen,
    pub(super) children: Children,
    pub(super) tally: Tally,
    pub(super) heads: Heads,
    pub(super) supervisor: Supervisor,
    pub(super) socket: ControlSocket,
    pub(super) suspension: Suspension,
    pub(super) pages: Pages,
    pub(super) swap: Option<Swap>,
    pub(super) ending: RunEnding,
    pub(super) started_ns: u64,
    pub(super) asked_ns: u64,
    pub(super) looked_ns: u64,
    /// Time and steps when the rate was last taken, and the rate in steps a second.
    pub(super) rate: (u64, u64, f64),
    /// The recorder that a lockstep world waits for, by its number.
    pub(super) recorder: Option<u32>,
}

impl<'a> Run<'a> {
    /// Starts the processes.
    ///
    /// # Errors
    /// When one cannot be started.
    pub fn open(
        plan: RunPlan,
        launcher: &'a mut Launcher,
        socket: ControlSocket,
        suspension: Suspension,
        pages: Pages,
        screen: &'a Screen,
    ) -> Result<Self> {
        let (step_s, items) = (plan.scene.step_s(), plan.scene.items());
        let tally = Tally::new(launcher, step_s, items, plan.plans())?;
        let is_gridworld = plan.scene.gridworld().is_some();
        let heads = Heads::new(launcher, plan.scene.step_ns(), is_gridworld)?;
        let supervisor = Supervisor::new(plan.restarts);
        let mut children = Children::new();
        children.start_all(&plan, launcher, screen)?;
        Ok(Self {
            plan,
            launcher,
            screen,
            children,
            tally,
            heads,
            supervisor,
            socket,
            suspension,
            pages,
            swap: None,
            ending: RunEnding::default(),
            started_ns: now_ns(),
            asked_ns: 0,
            looked_ns: now_ns(),
            rate: (now_ns(), 0, 0.0),
            recorder: None,
        })
    }

    /// The run, to its end.
    ///
    /// # Errors
    /// When the set does not start, or the launcher's own means fail; nobody is left alive.
    pub fn complete(&mut self) -> Result<RunEnding> {
        let result = self.start_watch_stop();
        if result.is_err() {
            self.children.end();
        }
        self.pages.close();
        result?;
        self.children.drain_output();
        self.tally.update()?;
        let result = self.plan.recorder_result(self.launcher.arguments());
        self.ending.recording = match std::fs::read_to_string(&result) {
            Ok(text) => Some(serde_json::from_str(&text).context("the recorder's result")?),
            // It died when no other was to follow; what it wrote until then is there.
            Err(_) if self.plan.record.is_some() => Some(RecorderResult {
                file: self.plan.record.clone(),
                error: Some("the last recorder died before it said what it wrote".to_owned()),
                ..RecorderResult::default()
            }),
            Err(_) => None,
        };
        self.launcher.clean()?;
        let mut ending = std::mem::take(&mut self.ending);
        ending.deaths = std::mem::take(&mut self.supervisor.deaths);
        ending.restarts = self.supervisor.restarts;
        ending.hangs = self.supervisor.hangs;
        ending.launcher_lost_wakeups = self.launcher.lost_wakeups();
        Ok(ending)
    }

    /// What is left of a run that is over.
    pub fn close(self) -> (RunPlan, Tally) {
        let mut tally = self.tally;
        tally.close();
        (self.plan, tally)
    }

    fn start_watch_stop(&mut self) -> Result<()> {
        let ready = starting::wait_ready(
            &self.plan,
            self.launcher,
            &mut self.children,
            &mut self.socket,
            &self.suspension,
        );
        ready.context("the process set did not start")?;
        self.pages.open(self.screen);
        self.launcher.start()?;
        self.children.all_active();
        self.tell_progress()?;
        self.started_ns = now_ns();
        // Those who asked while the set was starting.
        self.answer_callers()?;
        let watched = self.watch();
        self.ending.wall_seconds = (now_ns() - self.started_ns) as f64 * 1e-9;
        watched?;
        if let Some(swap) = self.swap.take() {
            let finished = Finished::Failed("the run ended before the border".to_owned());
            self.finish_swap(swap, finished)?;
        }
        self.stop()
    }

    /// Until the world has finished, or something ends the run before.
    fn watch(&mut self) -> Result<()> {
        while self.ending.ended_early.is_none() {
            let mut watched = self.children.descriptors();
            let living = watched.len();
            watched.extend(self.socket.descriptors());
            watched.push(self.suspension.descriptor());
            match self.launcher.wait(&watched, Some(self.next_look_ns()))? {
                LauncherWake::Report => {
                    if self.take_reports()? {
                        return Ok(());
                    }
                }
                LauncherWake::Child(at) if at < living => {
                    if self.bury(at)? {
                        return Ok(());
                    }
                }
                LauncherWake::Child(_) => {
                    self.suspension.heed(|signal| {
                        self.children.suspend(signal);
                        self.pages.signal(signal);
                    });
                    self.answer_callers()?;
                }
                LauncherWake::Stop => self.ending.ended_early = Some("interrupted".to_owned()),
                LauncherWake::Deadline => {}
            }
            self.look()?;
        }
        Ok(())
    }

    fn next_look_ns(&self) -> u64 {
        let look = self.looked_ns + self.look_ns();
        self.supervisor
            .next_due_ns()
            .map_or(look, |due| due.min(look))
    }

    /// How long until the counts are next brought up to date.
    fn look_ns(&self) -> u64 {
        let steps_ns = LOOK_STEPS / self.rate.2.max(1.0) * 1e9;
        LOOK_NS.min(steps_ns as u64)
    }

    /// Tells the world how far the launcher has counted, and which recorder to wait for.
    fn tell_progress(&mut self) -> Result<()> {
        if self.launcher.arguments().clock == ClockMode::RealTime {
            return Ok(());
        }
        if self.plan.exec.contains_key(NAMES[RECORDER]) {
            self.recorder = None;
        } else if let Some(child) = self.children.active(RECORDER) {
            self.recorder = Some(child.index); // of one that has died, until there is another
        }
        let counted = self.heads.newest(WORLD).unwrap_or_default();
        Ok(self.launcher.tell_progress(counted, self.recorder)?)
    }

    /// What is due: restarts, questions to everybody, the next stage of a swap, the status line.
    fn look(&mut self) -> Result<()> {
        let now = now_ns();
        while let Some(place) = self.supervisor.due() {
            self.screen
                .warn(&format!("mirror: starting {} again", NAMES[place]));
            self.children
                .start(&self.plan, self.launcher, self.screen, place, true)?;
        }
        if self.swap.is_some() {
            self.heads.update()?;
            self.with_swap(|swap, around| swap.go_on(around))?;
        }
        if now.saturating_sub(self.looked_ns) < self.look_ns() {
            return Ok(());
        }
        // A launcher that was stopped itself, or had no processor, has heard nobody.
        let i_was_away = now - self.looked_ns > (self.plan.hang_limit_ns / 2).max(2 * LOOK_NS);
        self.looked_ns = now;
        self.tally.update()?;
        self.heads.update()?;
        self.tell_progress()?;
        self.ask_around(now, i_was_away)?;
        let (then, steps, _) = self.rate;
        if now - then > 500 * MS {
            let done = self.tally.steps();
            let rate = done.saturating_sub(steps) as f64 * 1e9 / (now - then) as f64;
            self.rate = (now, done, rate);
        }
        self.pages.look(self.screen);
        self.show_status();
        Ok(())
    }

    /// Asks everybody whether they are there, and kills who hangs.
    fn ask_around(&mut self, now: u64, i_was_away: bool) -> Result<()> {
        if now - self.asked_ns > ask_ns(self.plan.hang_limit_ns) {
            self.asked_ns = now;
            self.launcher.request_reports()?;
        }
        let is_lockstep = self.launcher.arguments().clock == ClockMode::Lockstep;
        for child in self.children.living_mut() {
            let patience_ns = match child.phase {
                Phase::Active | Phase::Standby => {
                    let report = self.ending.reports[child.place].as_ref();
                    let longest_ns = report.map_or(0, |report| report.compute_ns[4]);
                    patience_ns(self.plan.hang_limit_ns, longest_ns)
                }
                Phase::Starting => READY_NS, // busy with its models, it answers nobody
                Phase::Leaving => continue,
            };
            if i_was_away {
                child.answers();
            }
            let silent_ns = now.saturating_sub(child.heard_ns);
            // Everybody waits for a lockstep process that computes.
            if is_lockstep && silent_ns > patience_ns / 2 {
                let activity = GroupActivity::of_group(child.pid());
                let before = child.activity.replace(activity);
                if before.is_some_and(|before| activity.computes_since(&before)) {
                    let computed_ns = now.saturating_sub(child.answered_ns);
                    if computed_ns > patience_ns && !child.was_waited_for {
                        child.was_waited_for = true;
                        self.screen.warn(&format!(
                            "mirror: {} has computed for {:.1} s without an answer; it is waited for",
                            NAMES[child.place],
                            computed_ns as f64 * 1e-9,
                        ));
                    }
                    child.heard_ns = now;
                    continue;
                }
            }
            if silent_ns > patience_ns && child.why.is_none() {
                let seconds = patience_ns as f64 * 1e-9;
                child.why = Some(format!("it had not answered for {seconds:.1} s"));
                child.signal(libc::SIGKILL);
                self.supervisor.hangs += 1;
            }
        }
        Ok(())
    }

    /// Takes in what the processes report; true if the world has finished.
    pub(super) fn take_reports(&mut self) -> Result<bool> {
        let mut over = false;
        while let Some(report) = self.launcher.next_report()? {
            over |= self.take_report(&report)?;
        }
        Ok(over)
    }

    fn take_report(&mut self, report: &Report) -> Result<bool> {
        let Some(child) = self.children.get_mut(report.index) else {
            return Ok(false);
        };
        if report.header.run_id != self.launcher.arguments().run_id {
            return Ok(false);
        }
        let text = text_of(&report.text);
        child.answers();
        if report.state() == Ok(ProcessState::Failed) {
            child.why = Some(text.clone());
        } else if !text.is_empty() {
            self.screen.warn(&format!("{}: {text}", NAMES[child.place]));
        }
        let (place, phase) = (child.place, child.phase);
        if phase == Phase::Active {
            self.ending.reports[place] = Some(*report);
        }
        let swap = self.swap.as_ref();
        if swap.is_some_and(|swap| swap.place() == place) {
            self.heads.update()?;
            self.with_swap(|swap, around| swap.hear(report, around))?;
        } else if phase == Phase::Starting && report.state() == Ok(ProcessState::Ready) {
            self.put_back(report.index, place)?;
        }
        Ok(
            place == WORLD
                && phase == Phase::Active
                && report.state() == Ok(ProcessState::Finished),
        )
    }

    /// A process that was started again goes on where its predecessor stopped.
    fn put_back(&mut self, index: u32, place: usize) -> Result<()> {
        self.tally.update()?;
        self.heads.update()?;
        let handover_step = if place == RECORDER {
            (0, 0) // also what is left of the time when nobody recorded
        } else {
            handover_after_death(self.launcher.arguments().clock, &self.heads, place)
        };
        if let Some(child) = self.children.get_mut(index) {
            child.phase = Phase::Active;
        }
        self.launcher.take_over(index, handover_step)?;
        self.launcher.connect_all()?;
        self.supervisor.is_back(place);
        Ok(())
    }

    /// Takes note that a process has ended; true if the run is over with it.
    fn bury(&mut self, at: usize) -> Result<bool> {
        // Its last words come before its end.
        if self.take_reports()? {
            return Ok(true);
        }
        self.tally.update()?;
        self.heads.update()?;
        let ended = self.children.reap(at)?;
        self.launcher.clean()?;
        let Ended {
            place,
            index,
            phase,
            ref how,
            ..
        } = ended;
        let swaps_here = self.swap.as_ref().is_some_and(|swap| swap.place() == place);
        let was_new = self.swap.as_ref().and_then(Swap::new_index) == Some(index);
        let is_missed = phase != Phase::Leaving && (!was_new || phase == Phase::Active);
        let over = is_missed && place == WORLD && self.episodes_left() == 0;
        if is_missed {
            self.screen.warn(&format!("mirror: {} {how}", NAMES[place]));
            let reason = self.supervisor.bury(&ended, &self.heads);
            if !over {
                self.ending.ended_early = reason.or(self.ending.ended_early.take());
            }
        } else if matches!(ended.cause, Cause::Crash | Cause::Signal) {
            self.supervisor.note(&ended, &self.heads);
        }
        if swaps_here {
            self.with_swap(|swap, around| swap.child_ended(index, how, around))?;
            if self.swap.is_some() {
                self.supervisor.leave(place);
            }
        }
        Ok(over)
    }

    /// Episodes that a new world could still drive.
    fn episodes_left(&self) -> u32 {
        let (episode, _) = next_handover(&self.heads, WORLD);
        self.plan.episodes.saturating_sub(episode)
    }

    fn show_status(&self) {
        if !self.screen.has_status() {
            return;
        }
        let (steps, episodes) = (self.tally.steps(), &self.tally.episodes);
        let step = episodes.last().map_or(0, |episode| episode.steps);
        let speed = steps as f64 * 1e9 / (now_ns() - self.started_ns).max(1) as f64;
        let collisions = episodes
            .iter()
            .filter(|episode| episode.hit.is_some())
            .count();
        let said: u64 = episodes.iter().map(|episode| episode.verbal_items).sum();
        let shown: usize = episodes.iter().map(|episode| episode.shown.len()).sum();
        let mut text = format!(
            "episode {}/{} · step {step} · {speed:.0} steps/s · {shown} highlights · {said} utterances · {collisions} collisions",
            episodes.len(),
            self.plan.episodes,
        );
        if let Some(decisions) = self.tally.decisions() {
            text += &format!(
                " · {} of {} decisions in time",
                decisions.in_time, decisions.steps
            );
        }
        self.screen.status(text);
    }
}
