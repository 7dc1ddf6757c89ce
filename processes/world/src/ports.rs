//! The world's ports, and the translation between the domain's types and its messages.

use anyhow::Result;
use domains::highway::traffic::CarState;
use domains::highway::{self, End, World};
use messages::{
    CommAction, DriverAction, HumanBelief, LidarFrame, MAX_OBJECTS, ObjectPose, Outcome, Scene,
    TERMS, topic,
};
use runtime::{
    ClockMode, Input, InputOptions, Node, NodeError, Output, Receive, Stamp, Wake, now_ns,
};

/// How often the world looks for messages that do not wake it.
const LOOK_NS: u64 = 200_000;
/// Steps that the human model may be behind; a port's buffer holds four times as many.
const MOST_BEHIND: u32 = 16;

/// Ports of the world process.
pub struct Ports {
    lidar: Output<LidarFrame>,
    scene: Output<Scene>,
    outcome: Output<Outcome>,
    /// The driver's actions.
    pub action: Input<DriverAction>,
    /// Of these, only an episode's last one is awaited.
    human: Input<HumanBelief>,
    /// Newest step that a human model spoke of. One that hands over may still be at earlier steps when its successor has
    /// spoken, so the message that came last does not tell.
    human_at: Option<(u32, u32)>,
    decision: Input<CommAction>,
    /// Squared distance and index of every car present; only used where more are present than a message holds.
    by_distance: Vec<(f64, usize)>,
}

impl Ports {
    /// Makes them.
    pub fn new(node: &Node) -> Result<Self> {
        let receive = match node.arguments().clock {
            ClockMode::Lockstep => Receive::InOrder,
            ClockMode::RealTime => Receive::Newest,
        };
        // Looked at once a step; without a bell, nobody has to ring it a thousand times a second.
        let asleep = InputOptions {
            wakes: false,
            ..InputOptions::new(Receive::Newest)
        };
        Ok(Self {
            lidar: node.output(topic::LIDAR)?,
            scene: node.output(topic::SCENE)?,
            outcome: node.output(topic::OUTCOME)?,
            action: node.input(topic::DRIVER_ACTION, receive)?,
            human: node.input_with(
                topic::HUMAN_BELIEF,
                InputOptions {
                    receive: Receive::InOrder,
                    ..asleep
                },
            )?,
            human_at: None,
            decision: node.input_with(topic::COMM_ACTION, asleep)?,
            by_distance: Vec::with_capacity(1024),
        })
    }

    /// Passes over the beliefs and decisions that came since the last step. Waits for a human model that has fallen far
    /// behind: without a planner nobody else waits for it, and its inputs would overflow.
    pub fn keep_together(&mut self, node: &mut Node, episode: u32, step: u32) -> Result<Wake> {
        self.decision.take()?;
        match step.checked_sub(MOST_BEHIND) {
            Some(oldest) => self.await_human(node, (episode, oldest)),
            None => {
                self.hear_human()?;
                Ok(Wake::Message)
            }
        }
    }

    fn hear_human(&mut self) -> Result<()> {
        while self.human.take()? {
            let heard = self.human.header().map(|h| (h.episode, h.step));
            self.human_at = self.human_at.max(heard);
        }
        Ok(())
    }

    fn await_human(&mut self, node: &mut Node, position: (u32, u32)) -> Result<Wake> {
        self.hear_human()?;
        while self.human_at < Some(position) {
            let looked = node.wait(&mut [&mut self.human], Some(now_ns() + LOOK_NS))?;
            if looked == Wake::Stop {
                return Ok(Wake::Stop);
            }
            self.hear_human()?;
        }
        Ok(Wake::Message)
    }

    /// Waits for the human model's belief of the last step and the planner's decision after it.
    pub fn await_last(&mut self, node: &mut Node, episode: u32, step: u32) -> Result<Wake> {
        let decision = &mut self.decision;
        match look_until(|deadline| node.wait_step(&mut [decision], episode, step, Some(deadline)))?
        {
            Wake::Stop => Ok(Wake::Stop),
            _ => self.await_human(node, (episode, step - 1)),
        }
    }

    /// The action that the driver sent last.
    pub fn action(&self) -> [f32; 2] {
        self.action
            .message()
            .map_or([0.0; 2], |action| [action.throttle, action.steer])
    }

    /// The newest action of this episode, and the step that it was decided at.
    pub fn newest_action(&mut self, episode: u32) -> Result<Option<(u32, [f32; 2])>> {
        self.action.take()?;
        let header = self
            .action
            .header()
            .filter(|header| header.episode == episode);
        Ok(header
            .map(|header| header.step)
            .map(|step| (step, self.action())))
    }

    /// Sends what is true and what is sensed at a step; the frame last, because it is what sets everybody to work.
    pub fn publish(
        &mut self,
        world: &World,
        outcome: &highway::Outcome,
        episode: u32,
        step: u32,
    ) -> Result<()> {
        let stamp = Stamp::sensed(episode, step);
        self.outcome
            .send_with(stamp, |message| write_outcome(outcome, message))?;
        let by_distance = &mut self.by_distance;
        self.scene
            .send_with(stamp, |message| write_scene(world, by_distance, message))?;
        if outcome.end == End::Running {
            self.lidar.send_with(stamp, |message| {
                let sensed = world.observation();
                message.range = sensed.range;
                message.object = sensed.object;
                message.speed_mps = sensed.speed_mps;
                message.ego = sensed.ego;
                message.moving = u32::from(sensed.moving);
            })?;
        }
        Ok(())
    }
}

/// Waits for inputs without a bell by looking every [`LOOK_NS`].
fn look_until(mut look: impl FnMut(u64) -> Result<Wake, NodeError>) -> Result<Wake> {
    loop {
        match look(now_ns() + LOOK_NS)? {
            Wake::Deadline => {}
            wake => return Ok(wake),
        }
    }
}

fn write_outcome(outcome: &highway::Outcome, message: &mut Outcome) {
    *message = Outcome {
        header: message.header,
        reward: outcome.reward,
        speed: outcome.speed,
        brake: outcome.brake,
        steer: outcome.steer,
        change: outcome.change,
        center: outcome.center,
        proximity: outcome.proximity,
        road: outcome.road,
        collision: outcome.collision,
        terms: [0.0; TERMS],
        collided: u32::from(outcome.collided),
        end: outcome.end as u32,
        other: outcome.other,
    };
}

fn write_scene(world: &World, by_distance: &mut Vec<(f64, usize)>, message: &mut Scene) {
    let ego = world.ego();
    message.ego = ObjectPose {
        x_m: ego.pose.x_m,
        y_m: ego.pose.y_m,
        heading_rad: ego.pose.heading_rad as f32,
        speed_mps: ego.speed_mps as f32,
        length_m: ego.length_m as f32,
        width_m: ego.width_m as f32,
        id: -1,
        kind: 0,
    };
    by_distance.clear();
    for (index, car) in world
        .objects()
        .iter()
        .enumerate()
        .filter(|(_, car)| car.present)
    {
        let squared = (car.x_m - ego.pose.x_m).powi(2) + (car.y_m - ego.pose.y_m).powi(2);
        by_distance.push((squared, index));
    }
    if by_distance.len() > MAX_OBJECTS {
        by_distance.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        message.left_out = (by_distance.len() - MAX_OBJECTS) as u32;
        by_distance.truncate(MAX_OBJECTS);
        by_distance.sort_unstable_by_key(|(_, index)| world.objects()[*index].id);
    }
    message.count = by_distance.len() as u32;
    for (object, (_, index)) in message.objects.iter_mut().zip(by_distance.iter()) {
        *object = pose_of(&world.objects()[*index]);
    }
}

fn pose_of(car: &CarState) -> ObjectPose {
    ObjectPose {
        x_m: car.x_m,
        y_m: car.y_m,
        heading_rad: car.sin.atan2(car.cos) as f32,
        speed_mps: car.speed_mps as f32,
        length_m: 2.0 * car.half_length_m as f32,
        width_m: 2.0 * car.half_width_m as f32,
        id: car.id,
        kind: u32::from(car.tall),
    }
}
