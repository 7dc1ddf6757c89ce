//! A gridworld in the process set.

use crate::truth::Truth;
use anyhow::{Result, ensure};
use domains::discrete::{self, Discrete, End, Scene, World};
use messages::{
    DriverAction, EpisodeEnd, Observation, Outcome, PICTURE_BYTES, Picture, VERBAL_NUMBERS,
    VISUAL_NUMBERS, topic,
};
use runtime::{Node, Output, Stamp};

/// Driving, search and rescue, or bomb defusal.
pub struct Gridworld {
    world: World,
    outcome: discrete::Outcome,
    step_ns: u64,
    is_given_up: bool,
    picture: Output<Picture>,
    text: String,
}

impl Gridworld {
    /// The scene's world, with the words that ship, and a port for what is true.
    ///
    /// # Errors
    /// When the words do not fit the scene, its modalities no message, or the port cannot be made.
    pub fn new(node: &Node, scene: &Scene) -> Result<Self> {
        let world = World::new(scene, &models::words::shipped(scene.domain())?)?;
        let layout = world.layout();
        ensure!(
            layout.visual <= VISUAL_NUMBERS && layout.verbal <= VERBAL_NUMBERS,
            "{}: {} visual and {} verbal numbers are more than a message holds",
            scene.name(),
            layout.visual,
            layout.verbal
        );
        Ok(Self {
            world,
            outcome: discrete::Outcome::default(),
            step_ns: scene.step_ns(),
            is_given_up: false,
            picture: node.output(topic::PICTURE)?,
            text: String::with_capacity(2 * PICTURE_BYTES),
        })
    }
}

impl Truth for Gridworld {
    type Sensed = Observation;

    fn step_ns(&self) -> u64 {
        self.step_ns
    }

    fn reset(&mut self, seed: u64, episode: u32) {
        self.world.reset(seed, episode, episode); // scenarios take turns
        self.outcome = discrete::Outcome::default();
        self.is_given_up = false;
    }

    fn step(&mut self, step: u32, action: Option<&DriverAction>) {
        // A choice is made once: where it does not come in time nothing is done, which no number of an action stands for.
        let nothing = self.world.layout().actions.rows();
        let chosen = action.filter(|action| action.header.step == step);
        let choice = chosen.and_then(DriverAction::discrete);
        let choice = choice.map_or(nothing, |choice| choice as usize);
        self.outcome = self.world.step(choice);
    }

    fn give_up(&mut self) {
        (self.outcome, self.is_given_up) = (discrete::Outcome::default(), true);
    }

    fn is_running(&self) -> bool {
        self.outcome.end.is_running() && !self.is_given_up
    }

    fn tell(&self, out: &mut Outcome) {
        out.reward = self.outcome.reward;
        out.terms = self.outcome.terms;
        out.collided = u32::from(self.outcome.collided);
        out.end = match self.is_given_up {
            true => EpisodeEnd::Voided.wire(),
            false => end_of(self.outcome.end).wire(),
        };
        out.other = Outcome::NOTHING_TOUCHED;
    }

    fn sense(&mut self, out: &mut Observation) {
        let layout = self.world.layout();
        let (visual, verbal) = (layout.visual, layout.verbal);
        let legal = |bits, action| bits | u32::from(self.world.legal(action)) << action;
        out.legal = (0..layout.actions.rows()).fold(0, legal);
        out.domain = layout.number;
        (out.visual_len, out.verbal_len) = (visual as u32, verbal as u32);
        self.world
            .observe(&mut out.visual[..visual], &mut out.verbal[..verbal]);
    }

    fn show(&mut self, stamp: Stamp) -> Result<()> {
        self.text.clear();
        self.world.render(&mut self.text);
        let mut length = self.text.len().min(PICTURE_BYTES - 1); // a zero follows
        while !self.text.is_char_boundary(length) {
            length -= 1;
        }
        let text = &self.text.as_bytes()[..length];
        Ok(self
            .picture
            .send_with(stamp, |out| out.text[..length].copy_from_slice(text))?)
    }
}

fn end_of(end: End) -> EpisodeEnd {
    match end {
        End::Running => EpisodeEnd::Running,
        End::Success => EpisodeEnd::Goal,
        End::Collision => EpisodeEnd::Collision,
        End::OutOfTime => EpisodeEnd::OutOfTime,
    }
}
