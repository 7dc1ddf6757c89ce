//! Demonstrations: rounds that a person drove without communication, with what the robot sensed and what the person did.
//! `mirror demos` records them, `mirror train human` learns from them.

use crate::rollout::step_of;
use domains::highway::modalities::{NAME as HIGHWAY, VISUAL};
use domains::highway::{
    AZIMUTHS, Cockpit, Observation, Scene, Shown, SimulatedDriver, World, episode,
};
use models::file::{COMMAND, DOMAIN, HOLDS};
use nn::checkpoint::{Checkpoint, CheckpointError, Extra};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use thiserror::Error;

/// Metadata value that tells a file of demonstrations.
pub const DEMONSTRATIONS: &str = "demonstrations";
/// Longest round that a file may hold, in steps.
const LONGEST: u64 = 1_000_000;

/// One moment of a round.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// x^visual_t as the robot senses it, unmasked.
    pub visual: [f32; VISUAL],
    /// a_t: what the person then did.
    pub action: [f32; 2],
}

impl Moment {
    /// What was sensed, and what the person did then.
    pub fn new(observation: &Observation, action: [f32; 2]) -> Self {
        Self {
            visual: step_of(observation).visual,
            action,
        }
    }
}

/// One round.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Round {
    /// Moments in the order of time.
    pub steps: Vec<Moment>,
    /// Whether it ended in a collision.
    pub collided: bool,
}

/// Rounds of one person.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Demonstrations {
    /// Rounds.
    pub rounds: Vec<Round>,
    /// Who drove and how: the command that made the file.
    pub source: String,
    /// What the person could see of each azimuth, in metres, where that is known: for the models that have to be told.
    pub visible_m: Option<[f32; AZIMUTHS]>,
}

/// A file of demonstrations could not be used.
#[derive(Debug, Error)]
pub enum DemonstrationsError {
    /// It could not be read or written, or lacks a tensor.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// Its contents do not fit together.
    #[error("{file}: {reason}")]
    Contents {
        /// The file.
        file: String,
        /// What is wrong.
        reason: String,
    },
}

/// Rounds of a simulated driver, without communication: episodes `first`, `first + 1`, … of `seed`.
pub fn record(
    world: &mut World,
    driver: &mut SimulatedDriver,
    seed: u64,
    first: u32,
    rounds: usize,
) -> Demonstrations {
    let mut trace = Vec::new();
    let rounds = (0..rounds as u32)
        .map(|round| {
            world.reset(seed, first + round);
            driver.reset(seed, first + round);
            trace.clear();
            let ended = episode::run(world, driver, |_, _| Shown::default(), Some(&mut trace));
            Round {
                steps: trace
                    .iter()
                    .map(|step| Moment::new(&step.observation, step.action))
                    .collect(),
                collided: ended.collided,
            }
        })
        .collect();
    Demonstrations {
        rounds,
        source: String::new(),
        visible_m: Some(*driver.visible_m()),
    }
}

/// [`record`] in a scene of its own.
///
/// # Errors
/// If the scene's road cannot be built.
pub fn record_in(
    scene: Arc<Scene>,
    person: &domains::highway::Person,
    seed: u64,
    first: u32,
    rounds: usize,
) -> Result<Demonstrations, domains::highway::road::RoadError> {
    let mut world = World::new(scene.clone())?;
    let cockpit = Cockpit::new(&scene, world.road(), scene.ego.start_s_m);
    let mut driver = SimulatedDriver::new(person, &scene.fog(), cockpit);
    Ok(record(&mut world, &mut driver, seed, first, rounds))
}

impl Demonstrations {
    /// Writes the rounds as a safetensors file: `length` (u64, steps per round), `collided` (u8 per round), `visual`
    /// (113 numbers per step), `action` (2 per step) and, where that is known, `visible_m` (36 numbers).
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), CheckpointError> {
        let lengths: Vec<u64> = self.rounds.iter().map(|r| r.steps.len() as u64).collect();
        let collided: Vec<u8> = self.rounds.iter().map(|r| u8::from(r.collided)).collect();
        let moments = || self.rounds.iter().flat_map(|r| &r.steps);
        let visual: Vec<f32> = moments().flat_map(|m| m.visual).collect();
        let action: Vec<f32> = moments().flat_map(|m| m.action).collect();
        let metadata = BTreeMap::from([
            (HOLDS.to_owned(), DEMONSTRATIONS.to_owned()),
            (COMMAND.to_owned(), self.source.to_owned()),
            (DOMAIN.to_owned(), HIGHWAY.to_owned()),
            ("mirror.rounds".to_owned(), self.rounds.len().to_string()),
        ]);
        let mut extras = vec![
            ("length", Extra::U64(&lengths)),
            ("collided", Extra::U8(&collided)),
            ("visual", Extra::F32(&visual)),
            ("action", Extra::F32(&action)),
        ];
        if let Some(visible_m) = &self.visible_m {
            extras.push(("visible_m", Extra::F32(visible_m)));
        }
        nn::checkpoint::save(path, &[], &extras, &metadata)
    }

    /// Reads a file of rounds.
    ///
    /// # Errors
    /// If it is missing, damaged, holds something else, or its parts do not fit together.
    pub fn load(path: &Path) -> Result<Self, DemonstrationsError> {
        Self::from_checkpoint(&nn::checkpoint::load(path)?)
    }

    /// The rounds in a checkpoint.
    ///
    /// # Errors
    /// See [`Self::load`].
    pub fn from_checkpoint(checkpoint: &Checkpoint) -> Result<Self, DemonstrationsError> {
        let bad = |reason: String| DemonstrationsError::Contents {
            file: checkpoint.file().to_owned(),
            reason,
        };
        let holds = checkpoint.metadata_value(HOLDS)?;
        if holds != DEMONSTRATIONS {
            return Err(bad(format!("holds {holds}, expected {DEMONSTRATIONS}")));
        }
        let domain = checkpoint.metadata().get(DOMAIN);
        if let Some(domain) = domain.filter(|domain| *domain != HIGHWAY) {
            return Err(bad(format!("rounds of {domain}, expected {HIGHWAY}")));
        }
        let collided = checkpoint.u8s("collided")?;
        let lengths = checkpoint.u64s("length", collided.len())?;
        let visual = checkpoint.f32s("visual")?;
        let action = checkpoint.f32s("action")?;
        if let Some(round) = lengths.iter().position(|n| *n > LONGEST) {
            return Err(bad(format!(
                "round {round} claims {} steps, at most {LONGEST} are possible",
                lengths[round]
            )));
        }
        let steps = lengths.iter().sum::<u64>() as usize;
        if visual.len() != steps * VISUAL || action.len() != steps * 2 {
            return Err(bad(format!(
                "rounds of {steps} steps in all need {} visual numbers and {} of actions, found {} and {}",
                steps * VISUAL,
                steps * 2,
                visual.len(),
                action.len()
            )));
        }
        for (name, numbers, width) in [("visual", &visual, VISUAL), ("action", &action, 2)] {
            if let Some(i) = numbers.iter().position(|x| !x.is_finite()) {
                return Err(bad(format!(
                    "tensor \"{name}\" holds {} at step {}",
                    numbers[i],
                    i / width
                )));
            }
        }
        let visible_m = match checkpoint.names().any(|name| name == "visible_m") {
            false => None,
            true => {
                let limits = checkpoint.f32s("visible_m")?;
                if limits.len() != AZIMUTHS || !limits.iter().all(|limit| *limit >= 0.0) {
                    return Err(bad(format!(
                        "tensor \"visible_m\" is not {AZIMUTHS} distances of at least 0"
                    )));
                }
                Some(core::array::from_fn(|azimuth| limits[azimuth]))
            }
        };
        let mut next = 0;
        let rounds = lengths
            .iter()
            .zip(collided)
            .map(|(&length, &collided)| {
                let range = next..next + length as usize;
                next = range.end;
                Round {
                    steps: range
                        .map(|i| Moment {
                            visual: core::array::from_fn(|v| visual[i * VISUAL + v]),
                            action: [action[2 * i], action[2 * i + 1]],
                        })
                        .collect(),
                    collided: collided != 0,
                }
            })
            .collect();
        Ok(Self {
            rounds,
            source: checkpoint
                .metadata()
                .get(COMMAND)
                .cloned()
                .unwrap_or_default(),
            visible_m,
        })
    }
}
