//! Who acts in a gridworld: a simulated person.

use crate::person::ActingPerson;
use anyhow::Result;
use domains::Mask;
use domains::discrete::{Acting, Discrete, Mind, Scene, SimulatedPerson, World};
use messages::{Display, DriverAction, Observation};
use serde::{Deserialize, Serialize};

/// A place in a gridworld.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GridworldSeat {
    /// The scene: how far people see.
    pub scene: Scene,
    /// Who acts.
    pub person: Acting,
}

impl GridworldSeat {
    /// The simulated person.
    ///
    /// # Errors
    /// Names the person that there is not, or the file and the place in it.
    pub fn simulated(&self) -> Result<SimulatedPerson> {
        let words = models::words::shipped(self.scene.domain())?;
        Ok(SimulatedPerson::of(&self.scene, &self.person, &words)?)
    }
}

/// A simulated person, and what they are shown and told.
pub struct GridworldPlayer {
    person: SimulatedPerson,
    seed: u64,
    told: Mask,
    measure: [u32; 3],
}

impl GridworldPlayer {
    /// A person who knows nothing yet.
    ///
    /// # Errors
    /// As [`GridworldSeat::simulated`].
    pub fn new(seat: &GridworldSeat, seed: u64) -> Result<Self> {
        let domain = seat.scene.domain();
        let world = World::new(&seat.scene, &models::words::shipped(domain)?)?;
        let layout = world.layout();
        Ok(Self {
            person: seat.simulated()?,
            seed,
            told: Mask::NONE,
            measure: [domain.number(), layout.visual as u32, layout.verbal as u32],
        })
    }
}

impl ActingPerson for GridworldPlayer {
    type Sensed = Observation;

    fn measure(&self) -> [u32; 3] {
        self.measure
    }

    fn reset(&mut self, episode: u32) {
        self.told = Mask::NONE;
        self.person.reset(self.seed, episode);
    }

    fn see(&mut self, display: &Display) {
        self.told.visual = display.highlighted.into();
        self.told.verbal |= display.said();
    }

    fn act(&mut self, sensed: &Observation, out: &mut DriverAction) {
        let (visual, verbal) = (sensed.visual(), sensed.verbal());
        let seen = self.person.look(visual);
        self.person.perceive(visual, verbal, seen | self.told);
        out.choice = self.person.act() as u32;
        out.is_choice = 1;
        self.told.verbal = 0;
    }
}
