//! The planner process: decides at step k what to communicate at k + 1, by imagining the robot's world and the person
//! in it together.

mod planner_state;
mod remote;

pub use planner_state::PlannerState;
pub use remote::{PendingAnswers, RemotePeople};

use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use messages::{
    CommAction, DecisionReason, Display, DriverAction, Header, HumanBelief, RobotBelief, topic,
};
use models::SelfModel;
use planning::{PeopleError, Settings};
use runtime::{ClockMode, Node, Receive, RunArguments, Stamp, Wake, now_ns, run_process};
use scenario::{Scenario, scene_or_null};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How to decide what to communicate.
// What follows is what `mirror up --help` says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum PlannerMethod {
    /// Race what could be said or shown, now or later, through the same imagined futures
    Race,
    /// Imagine many futures and keep what helps most (cross-entropy method)
    Ce,
    /// Bring the person's belief as near to the robot's as it will go, with no regard to reward (MIRROR-KL)
    Kl,
    /// Never communicate
    None,
}

impl PlannerMethod {
    /// Its name on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Race => "race",
            Self::Ce => "ce",
            Self::Kl => "kl",
            Self::None => "none",
        }
    }

    /// The planning library's name for it; `none` plans nothing and is treated as `race` where a planner is made all
    /// the same.
    fn chooser(self) -> planning::Method {
        match self {
            Self::Kl => planning::Method::Kl,
            Self::Ce => planning::Method::Ce,
            Self::Race | Self::None => planning::Method::Race,
        }
    }
}

/// What the process needs besides its place in the run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannerOptions {
    /// How to decide.
    pub method: PlannerMethod,
    /// The self-model's file, the same that the belief process uses; `none` needs no model.
    #[serde(default)]
    pub model: Option<PathBuf>,
    /// Settings of the planners.
    #[serde(default)]
    pub settings: Settings,
    /// Seed of the run.
    pub seed: u64,
    /// Seconds of a control step.
    pub step_s: f32,
    /// Seconds that a control step takes where the world does not wait; as many as are simulated if nothing is said.
    #[serde(default)]
    pub real_step_s: Option<f32>,
    /// In real time, how long the human model may take for an answer, in milliseconds.
    #[serde(default = "default_patience_ms")]
    pub patience_ms: u64,
    /// Highway or gridworld; as JSON, the gridworld's scene under `gridworld`.
    #[serde(default, rename = "gridworld", with = "scene_or_null")]
    pub scenario: Scenario,
}

/// Ten times what an answer to half of the default samples takes.
fn default_patience_ms() -> u64 {
    50
}

impl PlannerOptions {
    fn check(&self) -> Result<()> {
        if let Some(problem) = self.settings.problem() {
            bail!("planner settings: {problem}");
        }
        for (name, step_s) in [
            ("step_s", self.step_s),
            ("real_step_s", self.real_step_s.unwrap_or(self.step_s)),
        ] {
            if !(step_s > 0.0 && step_s.is_finite()) {
                bail!("planner options: {name} must be positive, not {step_s}");
            }
        }
        Ok(())
    }
}

/// Joins the run and decides until it ends.
///
/// # Errors
/// If the model's file or the settings cannot be used, or the run cannot be joined or is lost.
pub fn run(arguments: &RunArguments, options: &PlannerOptions) -> Result<()> {
    options.check()?;
    run_process(arguments, |node| match options.method {
        PlannerMethod::None => say_nothing(node),
        PlannerMethod::Race | PlannerMethod::Ce | PlannerMethod::Kl => {
            let path = options
                .model
                .as_ref()
                .context("planner options: methods `race`, `ce` and `kl` need a model")?;
            let state = match &options.scenario {
                Scenario::Highway(()) => {
                    let layout = domains::highway::modalities::layout();
                    PlannerState::highway(options, SelfModel::load(path, layout)?)
                }
                Scenario::Gridworld(scene) => {
                    let layout = models::words::layout_of(scene)?;
                    PlannerState::gridworld(options, Arc::new(SelfModel::load(path, layout)?))
                }
            };
            decide(node, options, state)
        }
    })
}

/// As [`run`], with a model of the highway that is in memory already.
///
/// # Errors
/// As [`run`].
pub fn run_with(
    arguments: &RunArguments,
    options: &PlannerOptions,
    model: &SelfModel,
) -> Result<()> {
    options.check()?;
    run_process(arguments, |node| {
        decide(node, options, PlannerState::highway(options, model.clone()))
    })
}

/// Sends empty decisions.
fn say_nothing(node: &mut Node) -> Result<()> {
    let receive = Receive::in_clock(node.arguments().clock);
    let mut robot = node
        .input::<RobotBelief>(topic::ROBOT_BELIEF, receive)?
        .once_in(node.arguments().clock);
    let decisions = node.output::<CommAction>(topic::COMM_ACTION)?;
    node.needs_no_catching_up();
    if node.ready()? == Wake::Stop {
        return Ok(());
    }
    while node.wait(&mut [&mut robot], None)? != Wake::Stop {
        if !robot.take()? {
            continue;
        }
        let Some(header) = robot.header() else {
            continue;
        };
        decisions.send_with(Stamp::of(header).next(), |out| {
            out.reason = DecisionReason::NoPlanner.wire()
        })?;
        node.end_step();
    }
    Ok(())
}

/// Sends planned decisions.
fn decide(node: &mut Node, options: &PlannerOptions, mut state: PlannerState) -> Result<()> {
    let lockstep = node.arguments().clock == ClockMode::Lockstep;
    let receive = Receive::in_clock(node.arguments().clock);
    let mut robot = node
        .input::<RobotBelief>(topic::ROBOT_BELIEF, receive)?
        .once_in(node.arguments().clock);
    let mut human = node.input::<HumanBelief>(topic::HUMAN_BELIEF, receive)?;
    let mut driver = node.input::<DriverAction>(topic::DRIVER_ACTION, receive)?;
    let mut displays = node.input::<Display>(topic::DISPLAY, receive)?;
    let mut client = node.request_client()?;
    let decisions = node.output::<CommAction>(topic::COMM_ACTION)?;
    let mut pending = PendingAnswers::new(options.settings.most_rows(), state.actions());
    let patience_ns = (!lockstep).then_some(options.patience_ms * 1_000_000);
    node.needs_no_catching_up();

    if node.ready()? == Wake::Stop {
        return Ok(());
    }
    while node.wait(&mut [&mut robot, client.source()], None)? != Wake::Stop {
        // What comes between two plans answers somebody else's questions, or an older plan's.
        client.pass_over()?;
        if !robot.take()? {
            continue;
        }
        let Some(belief) = robot.message() else {
            continue;
        };
        let stamp = Stamp::of(&belief.header);
        let decided = stamp.next();
        if !node.is_active(decided.episode, decided.step) {
            node.pass(decided.episode, decided.step);
            node.end_step();
            continue;
        }
        if belief.latent as usize != state.latent() {
            bail!(
                "belief/robot has {} dimensions, the planner's self-model {}",
                belief.latent,
                state.latent()
            );
        }
        let deadline_ns = patience_ns.map(|patience| now_ns() + patience);
        match node.wait_step(
            &mut [&mut human, &mut driver, &mut displays],
            stamp.episode,
            stamp.step,
            deadline_ns,
        )? {
            Wake::Stop => break,
            // The episode ended with this step: nobody acted any more.
            Wake::Passed => continue,
            Wake::Message | Wake::Deadline => {}
        }
        // In real time the wait may have ended without one of them.
        let is_of_step = |header: Option<&Header>| {
            header.is_some_and(|h| (h.episode, h.step) >= (stamp.episode, stamp.step))
        };
        let acted = driver
            .message()
            .filter(|a| (a.header.episode, a.header.step) == (stamp.episode, stamp.step));
        let speech_ready_s = displays.message().map_or(0.0, |d| d.speech_ready_s);
        let until = (!lockstep).then(|| {
            let at_ns = belief.header.cause_ns + state.budget_ns();
            Instant::now() + Duration::from_nanos(at_ns.saturating_sub(now_ns()))
        });
        let decision = loop {
            if !is_of_step(human.header()) {
                break Err(PeopleError::NoBelief);
            }
            let mut people = RemotePeople {
                node,
                client: &mut client,
                stamp,
                patience_ns,
                hears: state.hears(),
                pending: &mut pending,
                successor: lockstep.then_some(&mut human),
            };
            match state.plan(belief, acted, speech_ready_s, until, &mut people) {
                Err(PeopleError::Replaced) => {
                    client.give_up();
                    human.take()?;
                }
                decision => break decision,
            }
        };
        let late = !lockstep && now_ns() > belief.header.cause_ns + state.step_ns();
        match decision {
            Ok(()) => decisions.send_with(stamp.next(), |out| state.write(late, out))?,
            Err(PeopleError::Stopped) => break,
            Err(error @ PeopleError::Unreachable(_)) => return Err(error.into()),
            Err(
                PeopleError::Silent(_)
                | PeopleError::NoBelief
                | PeopleError::Incomparable
                | PeopleError::Replaced,
            ) => {
                client.give_up();
                decisions.send_with(stamp.next(), |out| {
                    out.reason = DecisionReason::HumanSilent.wire()
                })?;
            }
        }
        node.count_missed(u64::from(late));
        node.end_step();
    }
    Ok(())
}
