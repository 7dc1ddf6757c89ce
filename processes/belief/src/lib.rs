//! The belief process: follows the world with the robot's self-model, z^R_k ~ q_φ(z_{k−1}, a_{k−1}, x_k), from all that
//! the robot senses. On the highway nothing that is said belongs to it: the robot
//! senses everything itself, and what is said is decoded from its belief.

mod tracker;

pub use tracker::{Readable, Tracker};

use anyhow::{Result, ensure};
use domains::highway::modalities;
use messages::{DriverAction, LidarFrame, Observation, RobotBelief, topic};
use models::SelfModel;
use runtime::{ClockMode, Node, Receive, RunArguments, Stamp, Wake, now_ns, run_process};
use scenario::{Scenario, scene_or_null};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What the process needs besides its place in the run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BeliefOptions {
    /// The self-model's file.
    pub model: PathBuf,
    /// Highway or gridworld; as JSON, the gridworld's scene under `gridworld`.
    #[serde(default, rename = "gridworld", with = "scene_or_null")]
    pub scenario: Scenario,
}

/// Joins the run and follows the world until it ends.
///
/// # Errors
/// If the model's file cannot be used, or the run cannot be joined or is lost; the launcher is told.
pub fn run(arguments: &RunArguments, options: &BeliefOptions) -> Result<()> {
    run_process(arguments, |node| match &options.scenario {
        Scenario::Highway(()) => {
            let model = SelfModel::load(&options.model, modalities::layout())?;
            follow(node, Tracker::<LidarFrame>::new(model))
        }
        Scenario::Gridworld(scene) => {
            let layout = models::words::layout_of(scene)?;
            let model = SelfModel::load(&options.model, layout)?;
            follow(node, Tracker::<Observation>::new(model))
        }
    })
}

/// As [`run`], with a model that is in memory already.
///
/// # Errors
/// As [`run`].
pub fn run_with(arguments: &RunArguments, model: SelfModel) -> Result<()> {
    run_process(arguments, |node| {
        follow(node, Tracker::<LidarFrame>::new(model))
    })
}

fn follow<S: Readable>(node: &mut Node, mut tracker: Tracker<S>) -> Result<()> {
    let lockstep = node.arguments().clock == ClockMode::Lockstep;
    let receive = Receive::in_clock(node.arguments().clock);
    let mut world = node.input::<S>(S::TOPIC, receive)?;
    let mut actions = node.input::<DriverAction>(topic::DRIVER_ACTION, Receive::InOrder)?;
    let beliefs = node.output::<RobotBelief>(topic::ROBOT_BELIEF)?;

    if node.ready()? == Wake::Stop {
        return Ok(());
    }
    while node.wait(&mut [&mut world], None)? != Wake::Stop {
        world.take()?;
        let (Some(sensed), Some(header)) = (world.message(), world.header()) else {
            continue;
        };
        ensure!(
            sensed.measure() == tracker.measure(),
            "{}: domain, visual and verbal numbers are {:?}, the self-model's are {:?}",
            S::TOPIC,
            sensed.measure(),
            tracker.measure()
        );
        let (episode, step) = (header.episode, header.step);
        // Who joins in the middle of an episode begins with what is sensed there.
        if step > 0 && tracker.follows(episode) {
            // In real time a late action is not waited for: the newest there is counts.
            let deadline = if lockstep { None } else { Some(now_ns()) };
            if node.wait_step(&mut [&mut actions], episode, step - 1, deadline)? == Wake::Stop {
                break;
            }
        }
        beliefs.send_with(Stamp::of(header), |out| {
            tracker.observe(sensed, actions.message(), out)
        })?;
        node.end_step();
    }
    Ok(())
}
