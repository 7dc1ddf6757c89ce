//! Replacing a process while the set runs: the new one starts beside the old, reads what it reads until it has caught
//! up, and takes over at a step that both agree on, the handover step. The old publishes until the step before, the new
//! from it on.
//!
//! Until the handover step is crossed, whatever goes wrong leaves the old process in charge.

use super::children::Children;
use super::control_socket::{Answer, Caller, Replacement};
use super::heads::Heads;
use super::phase::Phase;
use super::plan::RunPlan;
use super::supervise::{Supervisor, handover_after_death};
use super::swap_report::SwapReport;
use crate::process::NAMES;
use crate::screen::Screen;
use anyhow::{Result, anyhow};
use messages::{ProcessState, Report};
use runtime::{Launcher, NEVER, Position, now_ns};
use std::thread::JoinHandle;

const MS: u64 = 1_000_000;
/// How long the new process may take to read its models and make its ports.
const START_NS: u64 = 60_000 * MS;
/// How long it may take to catch up.
const CATCH_UP_NS: u64 = 30_000 * MS;
/// How long an answer to an agreement may take: longer than any process computes without looking up.
const AGREE_NS: u64 = 5_000 * MS;
/// The handover step lies this far ahead, so that both have heard of it before they come to it.
const AHEAD_NS: u64 = 250 * MS;
/// How long an old process may take to say what it still owes, once the new one has spoken.
const OWED_NS: u64 = 2_000 * MS;
/// Steps after the handover step that are still watched.
const AFTERWARDS: u32 = 4;
/// How long crossing the handover step may take; in lockstep a driver's or a world's episode has to end first.
const CROSS_NS: u64 = 600_000 * MS;
/// Agreements tried before giving up: each looks twice as far ahead.
const MOST_TRIES: u32 = 5;

/// What a swap waits for.
pub(super) enum SwapStage {
    Learning(JoinHandle<Result<RunPlan>>),
    Starting,
    CatchingUp,
    AskingNew,
    AskingOld,
    /// The old one died: the new one is asked to go on where it stopped.
    TakingOver,
    Crossing,
    Settling,
}

/// A swap under way.
pub struct Swap {
    pub(super) place: usize,
    /// What the launcher starts from now on, once the swap is done.
    pub(super) plan: RunPlan,
    pub(super) caller: Option<Caller>,
    pub(super) old: Option<u32>,
    pub(super) new: Option<u32>,
    pub(super) stage: SwapStage,
    pub(super) since_ns: u64,
    pub(super) handover: Position,
    pub(super) before: (u64, u64, u64),
    pub(super) report: SwapReport,
    /// When the caller was last told what is waited for, and of which stage.
    pub(super) told: Option<(u64, u64)>,
}

/// What a swap needs of the run.
pub struct Around<'a> {
    pub launcher: &'a mut Launcher,
    pub children: &'a mut Children,
    pub supervisor: &'a mut Supervisor,
    pub heads: &'a Heads,
    pub screen: &'a Screen,
    /// Messages that were lost so far, by all that was reported.
    pub lost: u64,
    /// Steps a second, lately.
    pub rate: f64,
    /// Steps of an episode, on average.
    pub episode_steps: f64,
}

/// How a swap ended.
pub enum Finished {
    /// The new process is in charge: this is the plan from now on.
    Done(Box<RunPlan>, SwapReport),
    /// The old one still is.
    Failed(String),
}

impl Swap {
    /// Begins: learns if the new human model has to, or starts the new process.
    ///
    /// # Errors
    /// When nothing of that kind can be started.
    pub fn begin(
        plan: &RunPlan,
        asked: &Replacement,
        caller: Caller,
        around: &mut Around,
    ) -> Result<Self, (Caller, anyhow::Error)> {
        let found = NAMES.iter().position(|name| *name == asked.process);
        let Some(place) = found else {
            let names = NAMES.join(", ");
            let error = anyhow!("there is no process {:?}; there are {names}", asked.process);
            return Err((caller, error));
        };
        let changed = match plan.changed(place, asked) {
            Ok(changed) => changed,
            Err(error) => return Err((caller, error)),
        };
        let report = SwapReport {
            process: asked.process.clone(),
            from: plan.kind_of(place),
            to: changed.kind_of(place),
            ..SwapReport::default()
        };
        let mut swap = Self {
            place,
            plan: changed,
            caller: Some(caller),
            old: around.children.active(place).map(|child| child.index),
            new: None,
            stage: SwapStage::Starting,
            since_ns: now_ns(),
            handover: NEVER,
            before: (0, 0, 0),
            report,
            told: None,
        };
        if swap.plan.must_learn() {
            let (mut plan, run) = (swap.plan.clone(), around.launcher.arguments().clone());
            swap.stage = SwapStage::Learning(std::thread::spawn(move || {
                plan.learn(&run)?;
                Ok(plan)
            }));
        } else if let Err(error) = swap.start(around) {
            return match swap.caller.take() {
                Some(caller) => Err((caller, error)),
                None => Ok(swap), // never: it was put there above
            };
        }
        Ok(swap)
    }

    /// The process that is being replaced, by its place.
    pub fn place(&self) -> usize {
        self.place
    }

    /// Number of the new process.
    pub fn new_index(&self) -> Option<u32> {
        self.new
    }

    /// Whether the process that is being replaced has ended.
    pub fn old_is_gone(&self) -> bool {
        self.old.is_none()
    }

    fn start(&mut self, around: &mut Around) -> Result<()> {
        let screen = around.screen;
        let index = around
            .children
            .start(&self.plan, around.launcher, screen, self.place, true)?;
        self.new = Some(index);
        self.enter(SwapStage::Starting);
        Ok(())
    }

    /// Enters a stage; returns how long the last one took, in ms.
    fn enter(&mut self, stage: SwapStage) -> f64 {
        let now = now_ns();
        let took = (now - self.since_ns) as f64 / MS as f64;
        (self.stage, self.since_ns) = (stage, now);
        took
    }

    /// Goes on as far as it can without waiting.
    ///
    /// # Errors
    /// When the launcher's own ports fail.
    pub fn go_on(&mut self, around: &mut Around) -> Result<Option<Finished>> {
        let waited = now_ns().saturating_sub(self.since_ns);
        let failed = |why: &str| Ok(Some(Finished::Failed(why.to_owned())));
        match &mut self.stage {
            SwapStage::Learning(thread) if thread.is_finished() => {
                let learning = std::mem::replace(&mut self.stage, SwapStage::Starting);
                let SwapStage::Learning(thread) = learning else {
                    return Ok(None);
                };
                match thread.join() {
                    Ok(Ok(plan)) => self.plan = plan,
                    Ok(Err(error)) => return failed(&format!("learning: {error:#}")),
                    Err(_) => return failed("learning failed"),
                }
                self.report.learn_ms = self.enter(SwapStage::Starting);
                if let Err(error) = self.start(around) {
                    return failed(&format!("{error:#}"));
                }
            }
            SwapStage::Starting if waited > START_NS => return failed("not ready in time"),
            SwapStage::CatchingUp if waited > CATCH_UP_NS => {
                return failed("did not catch up in time");
            }
            SwapStage::AskingNew | SwapStage::AskingOld | SwapStage::TakingOver
                if waited > AGREE_NS =>
            {
                return failed("no answer to the border in time");
            }
            SwapStage::Crossing => {
                let head = around.heads.of(self.place);
                let crossed = head
                    .newest
                    .is_some_and(|(newest, _)| newest >= self.handover);
                // An old process that is slower may still owe steps before the handover step.
                let owes_nothing = head.left_out <= self.before.0;
                if crossed && (owes_nothing || waited > OWED_NS) {
                    self.report.cross_ms = self.enter(SwapStage::Settling);
                    self.retire_old(around)?;
                } else if !crossed && waited > CROSS_NS {
                    return failed("the border was not reached in time");
                }
            }
            SwapStage::Settling => {
                let (episode, step) = self.handover;
                let settled = around.heads.newest(self.place) >= Some((episode, step + AFTERWARDS));
                let old_is_gone = self
                    .old
                    .is_none_or(|old| around.children.get(old).is_none());
                // Without a step for so long, the run has ended or stands still for another reason.
                if (settled && old_is_gone && waited > 300 * MS) || waited > 5_000 * MS {
                    return Ok(Some(self.done(around)));
                }
            }
            _ => {}
        }
        self.tell_waiting(around);
        Ok(None)
    }

    /// Takes in what a process said; only of the new one and the old one.
    ///
    /// # Errors
    /// When the launcher's own ports fail.
    pub fn hear(&mut self, report: &Report, around: &mut Around) -> Result<Option<Finished>> {
        let index = Some(report.index);
        let about = (report.header.episode, report.header.step);
        let state = report.state();
        if matches!(
            state,
            Ok(ProcessState::HandoverAgreed | ProcessState::TooLate)
        ) && about != self.handover
        {
            return Ok(None); // an answer to an earlier proposal
        }
        match (&self.stage, state) {
            (SwapStage::Starting, Ok(ProcessState::Ready)) if index == self.new => {
                self.report.start_ms = self.enter(SwapStage::CatchingUp);
                if self.old.is_none() {
                    self.take_over_at_once(around)?;
                } else {
                    self.set_phase(around, Phase::Standby);
                    around.launcher.start_process(report.index)?;
                    around.launcher.connect_all()?;
                    if self.waits_for_episode() {
                        self.report.catch_up_ms = self.enter(SwapStage::CatchingUp);
                        self.agree(around)?;
                    }
                }
            }
            (SwapStage::CatchingUp, Ok(ProcessState::CaughtUp)) if index == self.new => {
                self.report.catch_up_ms = self.enter(SwapStage::CatchingUp);
                self.agree(around)?;
            }
            (SwapStage::AskingNew, Ok(ProcessState::HandoverAgreed)) if index == self.new => {
                self.ask_old(around)?;
            }
            (SwapStage::AskingOld, Ok(ProcessState::HandoverAgreed)) if index == self.old => {
                self.report.agree_ms += self.enter(SwapStage::Crossing);
                self.report.handover = Some(self.handover);
            }
            (SwapStage::Crossing, Ok(ProcessState::Retired))
                if index == self.old && self.place == WORLD && self.new.is_some() =>
            {
                if let Some(new) = self.new {
                    around.launcher.take_over(new, self.handover)?;
                }
            }
            (SwapStage::TakingOver, Ok(ProcessState::HandoverAgreed)) if index == self.new => {
                self.report.handover = Some(self.handover);
                self.report.agree_ms += self.enter(SwapStage::Crossing);
                around.supervisor.is_back(self.place);
            }
            (SwapStage::TakingOver, Ok(ProcessState::TooLate)) if index == self.new => {
                // It has passed over what its dead predecessor left unsaid, and cannot go back: another one can.
                self.report.tries += 1;
                if self.report.tries >= MOST_TRIES {
                    return Ok(Some(Finished::Failed(
                        "the old one died, and no new one could go on".to_owned(),
                    )));
                }
                self.send_away(around);
                if let Err(error) = self.start(around) {
                    return Ok(Some(Finished::Failed(format!("{error:#}"))));
                }
            }
            (
                SwapStage::AskingNew | SwapStage::AskingOld | SwapStage::Crossing,
                Ok(ProcessState::TooLate),
            ) if index == self.new || index == self.old => {
                if self.report.tries >= MOST_TRIES {
                    return Ok(Some(Finished::Failed(
                        "every border had passed before both had heard of it".to_owned(),
                    )));
                }
                if let Some(new) = self.new.filter(|_| index == self.old) {
                    around.launcher.take_over(new, NEVER)?;
                }
                self.agree(around)?;
            }
            _ => {}
        }
        Ok(None)
    }

    /// Takes note that one of the two has ended. Returns whether the swap goes on, and how it ended if not.
    ///
    /// # Errors
    /// When the launcher's own ports fail.
    pub fn child_ended(
        &mut self,
        index: u32,
        how: &str,
        around: &mut Around,
    ) -> Result<Option<Finished>> {
        if self.new == Some(index) {
            self.new = None;
            return Ok(Some(Finished::Failed(format!(
                "the new {} {how}",
                self.report.process
            ))));
        }
        if self.old == Some(index) {
            self.old = None;
            if matches!(self.stage, SwapStage::Settling) {
                return Ok(None);
            }
            self.report.old_died = true;
            if !matches!(self.stage, SwapStage::Learning(_) | SwapStage::Starting) {
                self.take_over_at_once(around)?;
            }
        }
        Ok(None)
    }

    /// Ends it: tells who asked, and, if it failed, keeps the old process active and ends the new one.
    ///
    /// # Errors
    /// When the launcher's own ports fail.
    pub fn end(mut self, finished: &Finished, around: &mut Around) -> Result<()> {
        let answer = match finished {
            Finished::Done(_, report) => match serde_json::to_value(report) {
                Ok(value) => Answer::Done(value),
                Err(error) => Answer::Refused(error.to_string()),
            },
            Finished::Failed(why) => {
                if let Some(old) = self.old
                    && matches!(self.stage, SwapStage::AskingOld | SwapStage::Crossing)
                {
                    around.launcher.hand_over(old, NEVER)?;
                }
                self.send_away(around);
                Answer::Refused(format!("{} stays as it is: {why}", self.report.process))
            }
        };
        if let Some(caller) = self.caller.take() {
            caller.tell(&answer);
        }
        Ok(())
    }

    fn done(&self, around: &Around) -> Finished {
        let head = around.heads.of(self.place);
        let mut report = self.report.clone();
        report.ticks_without_answer = head.left_out.saturating_sub(self.before.0);
        report.late_answers = head.late.saturating_sub(self.before.1);
        report.lost_messages = around.lost.saturating_sub(self.before.2);
        report.longest_gap_ms = head.longest_ns as f64 / MS as f64;
        Finished::Done(Box::new(self.plan.clone()), report)
    }

    /// Worlds and drivers change between two episodes; they have nothing to catch up on.
    pub(super) fn waits_for_episode(&self) -> bool {
        matches!(NAMES[self.place], "world" | "driver")
    }

    /// Chooses a handover step and proposes it to the new process.
    fn agree(&mut self, around: &mut Around) -> Result<()> {
        self.report.tries += 1;
        let (episode, step) = around.heads.newest(self.place).unwrap_or_default();
        let ahead = around.rate * (AHEAD_NS as f64 * 1e-9);
        let later = self.report.tries - 1;
        // Where episodes are short, several may begin in that time.
        let episodes = ((ahead / around.episode_steps.max(1.0)) as u32) << later;
        self.handover = if self.waits_for_episode() {
            (episode + 1 + episodes, 0)
        } else if episodes > 0 {
            (episode + episodes, 0)
        } else {
            (episode, step + ((ahead.ceil() as u32 + 2) << later))
        };
        if self.report.tries == 1 {
            let head = around.heads.of(self.place);
            self.before = (head.left_out, head.late, around.lost);
        }
        self.report.agree_ms += self.enter(SwapStage::AskingNew);
        match self.new {
            // A world acts by itself: it is told when the old one has stopped.
            Some(_) if self.place == WORLD => self.ask_old(around),
            Some(new) => Ok(around.launcher.take_over(new, self.handover)?),
            None => Ok(()),
        }
    }

    fn ask_old(&mut self, around: &mut Around) -> Result<()> {
        self.report.agree_ms += self.enter(SwapStage::AskingOld);
        match self.old {
            Some(old) => Ok(around.launcher.hand_over(old, self.handover)?),
            None => self.take_over_at_once(around),
        }
    }

    /// Ends the new process.
    fn send_away(&mut self, around: &mut Around) {
        let new = self.new.take();
        if let Some(child) = new.and_then(|new| around.children.get_mut(new)) {
            child.phase = Phase::Leaving;
            child.signal(libc::SIGKILL);
        }
    }

    /// The old process is gone: the new one goes on where it stopped.
    fn take_over_at_once(&mut self, around: &mut Around) -> Result<()> {
        let clock = around.launcher.arguments().clock;
        self.handover = handover_after_death(clock, around.heads, self.place);
        self.enter(SwapStage::TakingOver);
        if let Some(new) = self.new {
            self.set_phase(around, Phase::Active);
            around.launcher.take_over(new, self.handover)?;
            around.launcher.connect_all()?;
        }
        Ok(())
    }

    fn retire_old(&mut self, around: &mut Around) -> Result<()> {
        self.set_phase(around, Phase::Active);
        if let Some(child) = self.old.and_then(|old| around.children.get_mut(old)) {
            child.phase = Phase::Leaving;
            around.launcher.stop_process(child.index)?;
        }
        Ok(())
    }

    fn set_phase(&self, around: &mut Around, phase: Phase) {
        if let Some(child) = self.new.and_then(|new| around.children.get_mut(new)) {
            child.phase = phase;
        }
    }
}

/// Place of the world in launch order.
pub(super) const WORLD: usize = 0;
