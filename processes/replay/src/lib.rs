//! The replay process: plays world, driver and renderer from a recording, in lockstep, and compares what belief, human
//! model and planner say to it with what they said then.
//!
//! At step k it sends what was sensed, the recorded display and action, and waits for z^R_k, z^H_k and the decision for
//! k + 1. The person and the world are as recorded: every decision is asked for in the situation of that time, whatever
//! was decided for the step before.
//!
//! Where frame or display of a step is missing in the recording, the step is passed over; where the action is, the one
//! before it is held, as a world in real time would. What follows in that episode is marked: the recorded beliefs knew
//! what the recording does not.

mod drive;
mod row;

pub use drive::{
    Digest, Drive, DriveError, HumanSaid, MissingSteps, Part, RecordedStep, Seen, digest_of,
};
pub use row::{ReplayedDecision, Row, load as load_rows};

use anyhow::{Context, Result, bail};
use messages::{
    CommAction, Display, DriverAction, HumanBelief, LidarFrame, Message, Observation, Outcome,
    RobotBelief, topic,
};
use runtime::{Input, Node, Output, Receive, RunArguments, Stamp, Wake, run_process};
use serde::{Deserialize, Serialize};
use std::ops::Bound::{Excluded, Included};
use std::path::PathBuf;

/// What the process needs besides its place in the run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReplayOptions {
    /// The recording.
    pub recording: PathBuf,
    /// Where to write a [`Row`] per step.
    pub rows: PathBuf,
}

/// Joins the run and replays the recording to its end.
///
/// # Errors
/// When the recording cannot be replayed, the run cannot be joined or a port fails; the launcher is told.
pub fn run(arguments: &RunArguments, options: &ReplayOptions) -> Result<()> {
    run_process(arguments, |node| replay(node, options))
}

struct ReplayPorts {
    lidar: Output<LidarFrame>,
    observation: Output<Observation>,
    outcome: Output<Outcome>,
    display: Output<Display>,
    action: Output<DriverAction>,
    robot: Input<RobotBelief>,
    human: Input<HumanBelief>,
    decision: Input<CommAction>,
}

impl ReplayPorts {
    fn new(node: &Node) -> Result<Self> {
        Ok(Self {
            lidar: node.output(topic::LIDAR)?,
            observation: node.output(topic::OBSERVATION)?,
            outcome: node.output(topic::OUTCOME)?,
            display: node.output(topic::DISPLAY)?,
            action: node.output(topic::DRIVER_ACTION)?,
            robot: node.input(topic::ROBOT_BELIEF, Receive::InOrder)?,
            human: node.input(topic::HUMAN_BELIEF, Receive::InOrder)?,
            decision: node.input(topic::COMM_ACTION, Receive::InOrder)?,
        })
    }
}

fn replay(node: &mut Node, options: &ReplayOptions) -> Result<()> {
    let drive = Drive::read(&options.recording)?;
    let mut ports = ReplayPorts::new(node)?;
    if node.ready()? == Wake::Stop {
        return Ok(());
    }
    let mut player = Replayer::new(&drive);
    for at in drive.steps.keys() {
        if player.play(node, &mut ports, *at)? == Wake::Stop {
            break;
        }
    }
    row::save(&options.rows, &player.rows).context("the replay's rows")
}

/// Where a replay stands.
struct Replayer<'a> {
    drive: &'a Drive,
    rows: Vec<Row>,
    /// The step played last.
    last: Option<(u32, u32)>,
    /// What the person did last.
    held: DriverAction,
    /// Whether something before this step in its episode is missing in the recording.
    after_gap: bool,
}

impl<'a> Replayer<'a> {
    fn new(drive: &'a Drive) -> Self {
        Self {
            drive,
            rows: Vec::with_capacity(drive.steps.len()),
            last: None,
            held: DriverAction::ZERO,
            after_gap: false,
        }
    }

    /// Plays a step if it has what that needs, and takes down what is said to it.
    fn play(&mut self, node: &mut Node, ports: &mut ReplayPorts, at: (u32, u32)) -> Result<Wake> {
        let (episode, step) = at;
        let recorded = &self.drive.steps[&at];
        let action = recorded.action;
        if self.last.is_none_or(|(played, _)| played != episode) {
            (self.held, self.after_gap) = (DriverAction::ZERO, false);
        }
        let (Some(seen), Some(display)) = (&recorded.seen, &recorded.display) else {
            self.held = action.unwrap_or(self.held);
            return Ok(Wake::Message);
        };
        let is_last = || {
            let mut later = self
                .drive
                .steps
                .range((Excluded((episode, step)), Included((episode, u32::MAX))));
            !later.any(|(_, step)| step.is_whole())
        };
        if action.is_none() && is_last() {
            return Ok(Wake::Message); // the recording was cut in this step
        }
        let stamp = Stamp::of(match seen {
            Seen::Lidar(frame) => &frame.header,
            Seen::Grid(observation) => &observation.header,
        });
        if step > 0 && self.last != Some((episode, step - 1)) {
            self.after_gap = true;
            let before = Stamp {
                step: step - 1,
                ..stamp
            };
            act(ports, before, self.held)?;
        }
        self.after_gap |= action.is_none();
        self.held = action.unwrap_or(self.held);
        if let Some(outcome) = &recorded.outcome {
            ports.outcome.send_with(stamp, |out| *out = *outcome)?;
        }
        match seen {
            Seen::Lidar(frame) => ports.lidar.send_with(stamp, |out| *out = **frame)?,
            Seen::Grid(seen) => ports.observation.send_with(stamp, |out| *out = **seen)?,
        }
        ports.display.send_with(stamp, |out| *out = **display)?;
        act(ports, stamp, self.held)?;
        let ReplayPorts {
            robot,
            human,
            decision,
            ..
        } = ports;
        let mut wake = node.wait_step(&mut [robot, human], episode, step, None)?;
        if wake == Wake::Message {
            wake = node.wait_step(&mut [decision], episode, step + 1, None)?;
        }
        match wake {
            Wake::Stop => return Ok(Wake::Stop),
            Wake::Message => {}
            other => bail!("episode {episode} step {step}: somebody gave no answer ({other:?})"),
        }
        self.take_down(ports, at);
        self.last = Some(at);
        node.end_step();
        Ok(Wake::Message)
    }

    fn take_down(&mut self, ports: &ReplayPorts, (episode, step): (u32, u32)) {
        let (Some(robot), Some(human), Some(now)) = (
            ports.robot.message(),
            ports.human.message(),
            ports.decision.message(),
        ) else {
            return;
        };
        let recorded = &self.drive.steps[&(episode, step)];
        let next = self.drive.steps.get(&(episode, step + 1));
        let then = next.and_then(|next| next.decision.as_ref());
        // What the human model says about the last action comes with its next belief.
        if step > 0
            && self.last == Some((episode, step - 1))
            && let Some(before) = self.rows.last_mut()
        {
            before.log_likelihood_now = Some(human.log_likelihood);
            before.log_likelihood_then = recorded.human.map(|human| human.log_likelihood);
        }
        self.rows.push(Row {
            episode,
            step,
            after_gap: self.after_gap,
            robot_same: recorded.robot.map(|then| then == digest_of(robot)),
            human_same: recorded.human.map(|then| then.digest == digest_of(human)),
            decision_same: then.map(|then| digest_of(then) == digest_of(now)),
            then: then.map(ReplayedDecision::from),
            now: ReplayedDecision::from(now),
            log_likelihood_then: None,
            log_likelihood_now: None,
        });
    }
}

fn act(ports: &ReplayPorts, stamp: Stamp, action: DriverAction) -> Result<()> {
    Ok(ports.action.send_with(stamp, |out| *out = action)?)
}
