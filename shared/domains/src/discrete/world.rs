//! A world of any of the gridworlds.

use super::{Discrete, Outcome, Scene, Setting, Words, WordsError};
use crate::Layout;
use crate::{bomb_defusal, driving, search_rescue};

/// A world of any of the gridworlds: a plain value. Clones share layout and scene and allocate nothing.
#[derive(Clone, Debug)]
pub enum World {
    /// Gridworld driving.
    Driving(driving::World),
    /// Search and rescue.
    SearchRescue(search_rescue::World),
    /// Bomb defusal.
    BombDefusal(bomb_defusal::World),
}

/// Calls the same method on whichever world it is.
macro_rules! each {
    ($value:expr, $world:ident => $call:expr) => {
        match $value {
            World::Driving($world) => $call,
            World::SearchRescue($world) => $call,
            World::BombDefusal($world) => $call,
        }
    };
}

impl World {
    /// The scene's world. `words` has a vector for each of [`Scene::sentences`] (none for driving, whose words are symbols).
    ///
    /// # Errors
    /// If there are more or fewer vectors than sentences.
    pub fn new(scene: &Scene, words: &Words) -> Result<Self, WordsError> {
        words.expect(scene.sentences().len())?;
        Ok(match scene {
            Scene::Driving(scene) => Self::Driving(driving::World::new(scene)),
            Scene::SearchRescue(scene) => {
                Self::SearchRescue(search_rescue::World::new(scene, words)?)
            }
            Scene::BombDefusal(scene) => Self::BombDefusal(bomb_defusal::World::new(scene, words)?),
        })
    }
}

impl Discrete for World {
    fn layout(&self) -> &Layout {
        each!(self, world => world.layout())
    }

    fn scenarios(&self) -> u32 {
        each!(self, world => world.scenarios())
    }

    fn setting(&self) -> Setting {
        each!(self, world => world.setting())
    }

    fn reset(&mut self, seed: u64, episode: u32, scenario: u32) {
        each!(self, world => world.reset(seed, episode, scenario))
    }

    fn step(&mut self, action: usize) -> Outcome {
        each!(self, world => world.step(action))
    }

    fn end(&self) -> super::End {
        each!(self, world => world.end())
    }

    fn steps(&self) -> u32 {
        each!(self, world => world.steps())
    }

    fn scenario(&self) -> u32 {
        each!(self, world => world.scenario())
    }

    fn observe(&self, visual: &mut [f32], verbal: &mut [f32]) {
        each!(self, world => world.observe(visual, verbal))
    }

    fn legal(&self, action: usize) -> bool {
        each!(self, world => world.legal(action))
    }

    fn expert(&self) -> usize {
        each!(self, world => world.expert())
    }

    fn render(&self, out: &mut String) {
        each!(self, world => world.render(out))
    }
}
