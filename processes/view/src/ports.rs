//! The topics that the live view follows.

use anyhow::Result;
use messages::{
    Cockpit, CommAction, Display, DriverAction, HumanBelief, LidarFrame, Message, Observation,
    Outcome, Picture, Report, RobotBelief, Scene, topic,
};
use recorder::topics::Recorded;
use runtime::{Input, Observer};

/// Receiving sides that wake nobody and are waited for by nobody.
pub struct Ports {
    outcome: Input<Outcome>,
    scene: Input<Scene>,
    picture: Input<Picture>,
    lidar: Input<LidarFrame>,
    observation: Input<Observation>,
    robot: Input<RobotBelief>,
    human: Input<HumanBelief>,
    decision: Input<CommAction>,
    display: Input<Display>,
    action: Input<DriverAction>,
    cockpit: Input<Cockpit>,
    report: Input<Report>,
}

impl Ports {
    /// Makes them.
    ///
    /// # Errors
    /// When a topic carries another version of its message.
    pub fn new(observer: &Observer) -> Result<Self> {
        Ok(Self {
            outcome: observer.input(topic::OUTCOME)?,
            scene: observer.input(topic::SCENE)?,
            picture: observer.input(topic::PICTURE)?,
            lidar: observer.input(topic::LIDAR)?,
            observation: observer.input(topic::OBSERVATION)?,
            robot: observer.input(topic::ROBOT_BELIEF)?,
            human: observer.input(topic::HUMAN_BELIEF)?,
            decision: observer.input(topic::COMM_ACTION)?,
            display: observer.input(topic::DISPLAY)?,
            action: observer.input(topic::DRIVER_ACTION)?,
            cockpit: observer.input(topic::COCKPIT)?,
            report: observer.input(topic::REPORT)?,
        })
    }

    /// Hands over what waits, the world's first.
    ///
    /// # Errors
    /// When a port fails.
    pub fn drain(&mut self, mut take: impl FnMut(&Recorded)) -> Result<()> {
        empty(&mut self.outcome, &mut take)?;
        empty(&mut self.scene, &mut take)?;
        empty(&mut self.picture, &mut take)?;
        empty(&mut self.lidar, &mut take)?;
        empty(&mut self.observation, &mut take)?;
        empty(&mut self.robot, &mut take)?;
        empty(&mut self.human, &mut take)?;
        empty(&mut self.decision, &mut take)?;
        empty(&mut self.display, &mut take)?;
        empty(&mut self.action, &mut take)?;
        empty(&mut self.cockpit, &mut take)?;
        empty(&mut self.report, &mut take)
    }
}

fn empty<M: Message>(input: &mut Input<M>, take: &mut impl FnMut(&Recorded)) -> Result<()>
where
    for<'a> Recorded: From<&'a M>,
{
    while input.take()? {
        if let Some(message) = input.message() {
            take(&message.into());
        }
    }
    Ok(())
}
