//! The highway's world in the process set.

use crate::truth::Truth;
use anyhow::Result;
use domains::highway::traffic::CarState;
use domains::highway::{self, End, World};
use messages::{
    DriverAction, EpisodeEnd, LidarFrame, MAX_OBJECTS, ObjectKind, ObjectPose, Outcome, Scene,
    TERMS, topic,
};
use runtime::{Node, Output, Stamp};

/// The highway.
pub struct Highway {
    world: World,
    outcome: highway::Outcome,
    /// The action that holds where none comes in time.
    held: [f32; 2],
    scene: Output<Scene>,
    /// Where everybody is after every tick; only where a person is at the wheel.
    motion: Option<Output<Scene>>,
    is_given_up: bool,
    /// Squared distance and index of every car present; only used where more are present than a message holds.
    by_distance: Vec<(f64, usize)>,
}

impl Highway {
    /// A world with a port for what is true, and one for what a person at the wheel sees move.
    ///
    /// # Errors
    /// When a port cannot be made.
    pub fn new(node: &Node, world: World, has_cockpit: bool) -> Result<Self> {
        Ok(Self {
            world,
            outcome: highway::Outcome::default(),
            held: [0.0; 2],
            scene: node.output(topic::SCENE)?,
            motion: match has_cockpit {
                true => Some(node.output(topic::MOTION)?),
                false => None,
            },
            is_given_up: false,
            by_distance: Vec::with_capacity(1024),
        })
    }
}

impl Truth for Highway {
    type Sensed = LidarFrame;

    fn step_ns(&self) -> u64 {
        let scene = self.world.scene();
        (1e9 * scene.step_s() / scene.clock.rate) as u64
    }

    fn reset(&mut self, seed: u64, episode: u32) {
        self.world.reset(seed, episode);
        (self.outcome, self.held) = (highway::Outcome::default(), [0.0; 2]);
        self.is_given_up = false;
    }

    fn step(&mut self, _: u32, action: Option<&DriverAction>) {
        if let Some(action) = action {
            self.held = [action.throttle, action.steer];
        }
        self.outcome = self.world.step(self.held);
    }

    fn ticks(&self) -> u32 {
        self.world.scene().clock.ticks_per_step
    }

    fn tick(&mut self, _: u32, action: Option<&DriverAction>) -> bool {
        if let Some(action) = action {
            self.held = [action.throttle, action.steer];
        }
        let is_last = self.world.tick(self.held);
        if is_last {
            self.outcome = self.world.finish_step();
        }
        is_last
    }

    fn show_motion(&mut self, stamp: Stamp) -> Result<()> {
        let Self {
            world,
            by_distance,
            motion,
            ..
        } = self;
        if let Some(motion) = motion {
            motion.send_with(stamp, |out| write_scene(world, by_distance, out))?;
        }
        Ok(())
    }

    fn give_up(&mut self) {
        (self.outcome, self.is_given_up) = (highway::Outcome::default(), true);
    }

    fn is_running(&self) -> bool {
        self.outcome.end == End::Running && !self.is_given_up
    }

    fn tell(&self, out: &mut Outcome) {
        write_outcome(&self.outcome, out);
        if self.is_given_up {
            out.end = EpisodeEnd::Voided.wire();
        }
    }

    fn sense(&mut self, out: &mut LidarFrame) {
        let sensed = self.world.observation();
        out.range = sensed.range;
        out.object = sensed.object;
        out.speed_mps = sensed.speed_mps;
        out.ego = sensed.ego;
        out.moving = u32::from(sensed.moving);
    }

    fn show(&mut self, stamp: Stamp) -> Result<()> {
        let Self {
            world, by_distance, ..
        } = self;
        self.scene
            .send_with(stamp, |out| write_scene(world, by_distance, out))?;
        self.show_motion(stamp)
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
        end: end_of(outcome.end).wire(),
        other: outcome.other,
    };
}

fn end_of(end: End) -> EpisodeEnd {
    match end {
        End::Running => EpisodeEnd::Running,
        End::Goal => EpisodeEnd::Goal,
        End::Collision => EpisodeEnd::Collision,
        End::OutOfTime => EpisodeEnd::OutOfTime,
    }
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
        id: ObjectPose::EGO,
        kind: ObjectKind::Car.wire(),
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
        kind: match car.tall {
            false => ObjectKind::Car.wire(),
            true => ObjectKind::Other.wire(),
        },
    }
}
