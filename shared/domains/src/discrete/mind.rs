//! Simulated people: what they perceive, what they know, what they do.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{Scene, Sight, Words, WordsError};
use crate::Mask;
use crate::highway::FileError;
use crate::{bomb_defusal, driving, search_rescue};

/// A simulated person. They take in everything that they perceive or are told and never forget it within a round.
///
/// A step is `look` (what they perceive by themselves), `perceive` (that and what was communicated), then `act`. For imagined
/// futures the same person is cloned, given other random numbers by `reseed`, and shown imagined observations.
pub trait Mind: Send {
    /// Starts a round with an empty memory; random numbers come from (seed, episode).
    fn reset(&mut self, seed: u64, episode: u32);

    /// Takes other random numbers and keeps the memory.
    fn reseed(&mut self, seed: u64, episode: u32, stream: u64);

    /// The true perceptual parameters.
    fn sight(&self) -> &Sight;

    /// What they perceive by themselves of an observation's visual modality.
    fn look(&mut self, visual: &[f32]) -> Mask;

    /// Takes in an observation: of `visual` what no mask governs and the regions in `perceived`, of `verbal` the utterances in
    /// it. Nothing else of the slices is read.
    fn perceive(&mut self, visual: &[f32], verbal: &[f32], perceived: Mask);

    /// Probabilities of the actions, given what they now know; `out` has as many places as there are actions.
    fn probabilities(&mut self, out: &mut [f32]);

    /// Draws an action from [`probabilities`](Mind::probabilities) and does it.
    fn act(&mut self) -> usize;

    /// Tells them what they did, in place of [`act`](Mind::act): where the real person's action is known.
    fn acted(&mut self, action: usize);

    /// As [`acted`](Mind::acted), for a model of the person, which may have taken them to know, or to want, what they would not have
    /// done this by: that is dropped.
    fn observed(&mut self, action: usize) {
        self.acted(action);
    }

    /// How many numbers hold their memory.
    fn memory_len(&self) -> usize;

    /// Writes their memory, [`memory_len`](Mind::memory_len) numbers: all that they know, but for random numbers to come.
    fn write_memory(&self, out: &mut [f32]);

    /// Takes the memory of somebody else, as they wrote it.
    fn read_memory(&mut self, memory: &[f32]);
}

/// Who acts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Acting {
    /// One of the simulated people that ship, from 1 on.
    Shipped(u32),
    /// The simulated person of a file.
    File(PathBuf),
}

/// A simulated person could not be made.
#[derive(Debug, Error)]
pub enum PersonError {
    /// Their file is missing or wrong.
    #[error(transparent)]
    File(#[from] FileError),
    /// The words do not fit the domain.
    #[error(transparent)]
    Words(#[from] WordsError),
}

/// A simulated person of any of the gridworlds: a plain value. Clones share the words' vectors and allocate nothing.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant)] // boxes would make clones allocate
pub enum SimulatedPerson {
    /// Drives.
    Driving(driving::SimulatedDriver),
    /// Searches.
    SearchRescue(search_rescue::Searcher),
    /// Defuses.
    BombDefusal(bomb_defusal::Defuser),
}

/// Calls the same method on whoever it is.
macro_rules! each {
    ($value:expr, $person:ident => $call:expr) => {
        match $value {
            SimulatedPerson::Driving($person) => $call,
            SimulatedPerson::SearchRescue($person) => $call,
            SimulatedPerson::BombDefusal($person) => $call,
        }
    };
}

impl SimulatedPerson {
    /// How many people ship for each domain.
    pub const COUNT: u32 = super::file::PEOPLE;

    /// One of the people that ship with the project, 1 to 10, in a scene and its setting; `words` as the world's.
    ///
    /// # Errors
    /// When there is none of that number, or the words do not fit the domain.
    pub fn builtin(scene: &Scene, id: u32, words: &Words) -> Result<Self, PersonError> {
        words.expect(scene.sentences().len())?;
        Ok(match scene {
            Scene::Driving(scene) => {
                let person = driving::Person::builtin(id)?;
                Self::Driving(driving::SimulatedDriver::new(&person, scene))
            }
            Scene::SearchRescue(scene) => {
                let person = search_rescue::Person::builtin(id)?;
                Self::SearchRescue(search_rescue::Searcher::new(&person, scene, words)?)
            }
            Scene::BombDefusal(scene) => {
                let person = bomb_defusal::Person::builtin(id)?;
                Self::BombDefusal(bomb_defusal::Defuser::new(&person, scene, words)?)
            }
        })
    }

    /// Whoever `acting` names, in a scene and its setting; `words` as the world's.
    ///
    /// # Errors
    /// Names the person that there is not, or the file and the place in it.
    pub fn of(scene: &Scene, acting: &Acting, words: &Words) -> Result<Self, PersonError> {
        match acting {
            Acting::Shipped(id) => Self::builtin(scene, *id, words),
            Acting::File(file) => Self::load(scene, file, words),
        }
    }

    /// A person of a file of the caller's.
    ///
    /// # Errors
    /// When the file cannot be read, is no person's of this domain, or the words do not fit the domain.
    pub fn load(scene: &Scene, file: &Path, words: &Words) -> Result<Self, PersonError> {
        words.expect(scene.sentences().len())?;
        Ok(match scene {
            Scene::Driving(scene) => {
                let person = driving::Person::load(file)?;
                Self::Driving(driving::SimulatedDriver::new(&person, scene))
            }
            Scene::SearchRescue(scene) => {
                let person = search_rescue::Person::load(file)?;
                Self::SearchRescue(search_rescue::Searcher::new(&person, scene, words)?)
            }
            Scene::BombDefusal(scene) => {
                let person = bomb_defusal::Person::load(file)?;
                Self::BombDefusal(bomb_defusal::Defuser::new(&person, scene, words)?)
            }
        })
    }
}

impl Mind for SimulatedPerson {
    fn reset(&mut self, seed: u64, episode: u32) {
        each!(self, person => person.reset(seed, episode))
    }

    fn reseed(&mut self, seed: u64, episode: u32, stream: u64) {
        each!(self, person => person.reseed(seed, episode, stream))
    }

    fn sight(&self) -> &Sight {
        each!(self, person => person.sight())
    }

    fn look(&mut self, visual: &[f32]) -> Mask {
        each!(self, person => person.look(visual))
    }

    fn perceive(&mut self, visual: &[f32], verbal: &[f32], perceived: Mask) {
        each!(self, person => person.perceive(visual, verbal, perceived))
    }

    fn probabilities(&mut self, out: &mut [f32]) {
        each!(self, person => person.probabilities(out))
    }

    fn act(&mut self) -> usize {
        each!(self, person => person.act())
    }

    fn acted(&mut self, action: usize) {
        each!(self, person => person.acted(action))
    }

    fn observed(&mut self, action: usize) {
        each!(self, person => person.observed(action))
    }

    fn memory_len(&self) -> usize {
        each!(self, person => person.memory_len())
    }

    fn write_memory(&self, out: &mut [f32]) {
        each!(self, person => person.write_memory(out))
    }

    fn read_memory(&mut self, memory: &[f32]) {
        each!(self, person => person.read_memory(memory))
    }
}
