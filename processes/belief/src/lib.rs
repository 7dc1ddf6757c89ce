//! The belief process: follows the world with the robot's self-model, z^R_k ~ q_φ(z_{k−1}, a_{k−1}, x_k), from all that
//! the LIDAR senses and nothing that is said (DESIGN §11).

mod tracker;

pub use tracker::Tracker;

use anyhow::Result;
use messages::{DriverAction, LidarFrame, RobotBelief, topic};
use models::SelfModel;
use runtime::{ClockMode, Node, Receive, RunArguments, Stamp, Wake, now_ns};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What the process needs besides its place in the run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Options {
    /// The self-model's file.
    pub model: PathBuf,
}

/// Joins the run and follows the world until it ends.
///
/// # Errors
/// If the model's file cannot be used, or the run cannot be joined or is lost; the launcher is told.
pub fn run(arguments: &RunArguments, options: &Options) -> Result<()> {
    join(arguments, |node| {
        follow(node, models::checkpoint::load_self_model(&options.model)?)
    })
}

/// As [`run`], with a model that is in memory already.
///
/// # Errors
/// As [`run`].
pub fn run_with(arguments: &RunArguments, model: SelfModel) -> Result<()> {
    join(arguments, |node| follow(node, model))
}

fn join(arguments: &RunArguments, work: impl FnOnce(&mut Node) -> Result<()>) -> Result<()> {
    let mut node = Node::join(arguments)?;
    let result = work(&mut node);
    match &result {
        Ok(()) => node.finish()?,
        Err(error) => node.fail(&format!("{error:#}"))?,
    }
    result
}

fn follow(node: &mut Node, model: SelfModel) -> Result<()> {
    let lockstep = node.arguments().clock == ClockMode::Lockstep;
    let receive = if lockstep {
        Receive::InOrder
    } else {
        Receive::Newest
    };
    let mut lidar = node.input::<LidarFrame>(topic::LIDAR, receive)?;
    let mut actions = node.input::<DriverAction>(topic::DRIVER_ACTION, Receive::InOrder)?;
    let beliefs = node.output::<RobotBelief>(topic::ROBOT_BELIEF)?;
    let mut tracker = Tracker::new(model);

    if node.ready()? == Wake::Stop {
        return Ok(());
    }
    while node.wait(&mut [&mut lidar], None)? != Wake::Stop {
        lidar.take()?;
        let Some(frame) = lidar.message() else {
            continue;
        };
        let (episode, step) = (frame.header.episode, frame.header.step);
        // Who joins in the middle of an episode begins with what is sensed there.
        if step > 0 && tracker.follows(episode) {
            // In real time a late action is not waited for: the newest there is counts.
            let deadline = if lockstep { None } else { Some(now_ns()) };
            if node.wait_step(&mut [&mut actions], episode, step - 1, deadline)? == Wake::Stop {
                break;
            }
        }
        let previous = actions
            .message()
            .map_or([0.0; 2], |a| [a.throttle, a.steer]);
        beliefs.send_with(Stamp::of(&frame.header), |out| {
            tracker.observe(frame, previous, out)
        })?;
        node.end_step();
    }
    Ok(())
}
