//! How far each process of a run has come, seen from outside: the newest message of the topic that it sends on.

use crate::process::NAMES;
use anyhow::Result;
use messages::{
    CommAction, Display, DriverAction, HumanBelief, LidarFrame, Message, Observation, RobotBelief,
    topic,
};
use runtime::{Input, InputOptions, Launcher, Position};

/// Steps that are remembered as left out: more than any sender is ahead of another.
const MOST_MISSING: usize = 1024;

/// What is known of one topic.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TopicHead {
    /// Newest position spoken of, and when.
    pub newest: Option<(Position, u64)>,
    /// Steps of an episode that were left out, since the run began.
    pub left_out: u64,
    /// Messages sent later than a step after the world sensed what they go back to.
    pub late: u64,
    /// Longest time between two messages since [`Heads::forget_gaps`], in ns.
    pub longest_ns: u64,
}

struct Track<M: Message> {
    input: Input<M>,
    head: TopicHead,
    /// Steps that were left out so far: the last words of one sender may be read after the first of the next.
    missing: Vec<Position>,
    step_ns: u64,
}

/// A track of whichever message a domain's world sends.
trait FollowTopic {
    fn update(&mut self) -> Result<()>;
    fn head(&self) -> TopicHead;
    fn forget_gap(&mut self);
}

impl<M: Message> FollowTopic for Track<M> {
    fn update(&mut self) -> Result<()> {
        Self::update(self)
    }

    fn head(&self) -> TopicHead {
        self.head
    }

    fn forget_gap(&mut self) {
        self.head.longest_ns = 0;
    }
}

impl<M: Message> Track<M> {
    fn new(launcher: &Launcher, topic: &'static str, step_ns: u64) -> Result<Self> {
        Ok(Self {
            input: launcher.input_with(topic, InputOptions::recorder())?,
            head: TopicHead::default(),
            missing: Vec::new(),
            step_ns,
        })
    }

    fn update(&mut self) -> Result<()> {
        while let Some(message) = self.input.next()? {
            let Some(header) = message.header() else {
                continue;
            };
            let position = (header.episode, header.step);
            if let Some((last, sent_ns)) = self.head.newest {
                if position <= last {
                    // Late, or repeated by one that took over from a dead process.
                    if let Some(at) = self.missing.iter().position(|missing| *missing == position) {
                        self.missing.swap_remove(at);
                        self.head.left_out -= 1;
                    }
                    continue;
                }
                if position.0 == last.0 {
                    self.head.left_out += u64::from(position.1 - last.1 - 1);
                    let between = (last.1 + 1..position.1).map(|step| (position.0, step));
                    self.missing.extend(between);
                    // What is older does not come any more.
                    let old = self.missing.len().saturating_sub(MOST_MISSING);
                    self.missing.drain(..old);
                }
                let gap = header.sent_ns.saturating_sub(sent_ns);
                self.head.longest_ns = self.head.longest_ns.max(gap);
            }
            if header.sent_ns.saturating_sub(header.cause_ns) > self.step_ns {
                self.head.late += 1;
            }
            self.head.newest = Some((position, header.sent_ns));
        }
        Ok(())
    }
}

/// The heads of all processes but the recorder, which sends nothing.
pub struct Heads {
    world: Box<dyn FollowTopic>,
    driver: Track<DriverAction>,
    belief: Track<RobotBelief>,
    human: Track<HumanBelief>,
    planner: Track<CommAction>,
    renderer: Track<Display>,
}

impl Heads {
    /// Listens without being woken; call [`Heads::update`] some times a second. `step_ns`: how long a step lasts in
    /// real time.
    ///
    /// # Errors
    /// When a port cannot be made.
    pub fn new(launcher: &Launcher, step_ns: u64, is_gridworld: bool) -> Result<Self> {
        let world: Box<dyn FollowTopic> = if is_gridworld {
            let track = Track::<Observation>::new(launcher, topic::OBSERVATION, step_ns)?;
            Box::new(track)
        } else {
            let track = Track::<LidarFrame>::new(launcher, topic::LIDAR, step_ns)?;
            Box::new(track)
        };
        Ok(Self {
            world,
            driver: Track::new(launcher, topic::DRIVER_ACTION, step_ns)?,
            belief: Track::new(launcher, topic::ROBOT_BELIEF, step_ns)?,
            human: Track::new(launcher, topic::HUMAN_BELIEF, step_ns)?,
            planner: Track::new(launcher, topic::COMM_ACTION, step_ns)?,
            renderer: Track::new(launcher, topic::DISPLAY, step_ns)?,
        })
    }

    /// Takes in what came since the last call.
    ///
    /// # Errors
    /// When a port fails.
    pub fn update(&mut self) -> Result<()> {
        self.world.update()?;
        self.driver.update()?;
        self.belief.update()?;
        self.human.update()?;
        self.planner.update()?;
        self.renderer.update()
    }

    /// The head of a process, by its place; the recorder's is the world's.
    pub fn of(&self, place: usize) -> TopicHead {
        match NAMES[place] {
            "driver" => self.driver.head,
            "belief" => self.belief.head,
            "human" => self.human.head,
            "planner" => self.planner.head,
            "renderer" => self.renderer.head,
            _ => self.world.head(),
        }
    }

    /// Newest position of a process.
    pub fn newest(&self, place: usize) -> Option<Position> {
        self.of(place).newest.map(|(position, _)| position)
    }

    /// Measures the longest time between two messages anew.
    pub fn forget_gaps(&mut self) {
        self.world.forget_gap();
        for head in [
            &mut self.driver.head,
            &mut self.belief.head,
            &mut self.human.head,
            &mut self.planner.head,
            &mut self.renderer.head,
        ] {
            head.longest_ns = 0;
        }
    }
}
