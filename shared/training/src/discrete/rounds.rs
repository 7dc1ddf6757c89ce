//! Rounds that a person played in a gridworld without an assistant: what could be sensed, what the person truly perceived of
//! it (for the models that are told: BC and SQIL), and what they did.

use domains::discrete::{Discrete, Mind, Setting, World};
use domains::{Layout, Mask};
use models::file::HEARD;
use nn::checkpoint::{Checkpoint, CheckpointError, Extra};
use std::collections::BTreeMap;
use std::path::Path;
use thiserror::Error;

/// Metadata value that tells a file of demonstrations.
const DEMONSTRATIONS: &str = "demonstrations";
/// Metadata key of the setting.
const SETTING: &str = "mirror.setting";
/// Tensor of what limits the person's sight.
const LIMITS: &str = "limits";

/// One round of n steps.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Round {
    /// x^visual before each action, n × layout.visual.
    pub visual: Vec<f32>,
    /// x^verbal before each action.
    pub verbal: Vec<f32>,
    /// What the person perceived of it.
    pub perceived: Vec<Mask>,
    /// What they did.
    pub action: Vec<u8>,
    /// What it gave.
    pub reward: Vec<f32>,
}

impl Round {
    /// Steps.
    pub fn len(&self) -> usize {
        self.action.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.action.is_empty()
    }
}

/// Rounds of one person.
#[derive(Clone, Debug, PartialEq)]
pub struct Rounds {
    /// Where.
    pub domain: &'static str,
    /// Which setting it was in.
    pub setting: Setting,
    /// Numbers of each observation's modalities.
    pub sizes: [usize; 2],
    /// Utterances that the person hears without an assistant, a bit each.
    pub heard: u32,
    /// What limits the person's sight , where it is known: for the models that are told.
    pub limits: Option<Vec<f32>>,
    /// Rounds.
    pub rounds: Vec<Round>,
    /// Who played and how: the command that made the file.
    pub source: String,
}

/// A file of rounds could not be used.
#[derive(Debug, Error)]
pub enum RoundsError {
    /// It could not be read or written, or lacks a tensor.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// Its contents do not fit together, or not the domain.
    #[error("{file}: {reason}")]
    Contents {
        /// The file.
        file: String,
        /// What is wrong.
        reason: String,
    },
}

impl Rounds {
    /// No rounds of a domain yet.
    pub fn new(layout: &Layout, setting: Setting, heard: u32) -> Self {
        Self {
            domain: layout.domain,
            setting,
            sizes: [layout.visual, layout.verbal],
            heard,
            limits: None,
            rounds: Vec::new(),
            source: String::new(),
        }
    }

    /// Lets a person play rounds `first`, `first + 1`, … of `seed` without an assistant; scenarios take turns.
    pub fn record(
        world: &mut World,
        person: &mut dyn Mind,
        seed: u64,
        first: u32,
        rounds: u32,
    ) -> Self {
        let layout = world.layout().clone();
        let mut all = Self::new(&layout, world.setting(), person.sight().heard);
        all.limits = Some(person.sight().limits.to_vec());
        let (mut visual, mut verbal) = (vec![0.0; layout.visual], vec![0.0; layout.verbal]);
        for episode in first..first + rounds {
            world.reset(seed, episode, episode);
            person.reset(seed, episode);
            let mut round = Round::default();
            while world.end().is_running() {
                world.observe(&mut visual, &mut verbal);
                let perceived = person.look(&visual);
                person.perceive(&visual, &verbal, perceived);
                let action = person.act();
                round.visual.extend_from_slice(&visual);
                round.verbal.extend_from_slice(&verbal);
                round.perceived.push(perceived);
                round.action.push(action as u8);
                round.reward.push(world.step(action).reward);
            }
            all.rounds.push(round);
        }
        all
    }

    /// The rounds of a part of these, with all else as it is.
    pub fn part(&self, range: std::ops::Range<usize>) -> Self {
        let end = range.end.min(self.rounds.len());
        Self {
            rounds: self.rounds[range.start.min(end)..end].to_vec(),
            source: self.source.clone(),
            limits: self.limits.clone(),
            ..*self
        }
    }

    /// Steps of all rounds.
    pub fn steps(&self) -> usize {
        self.rounds.iter().map(Round::len).sum()
    }

    /// Writes the rounds as a safetensors file: `length` (u64 per round), `visual` and `verbal` (f32), `perceived` (u64 per
    /// step: visual bits, then verbal bits from bit 32), `action` (u8), `reward` (f32) and, where they are known, `limits` (f32).
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), CheckpointError> {
        let lengths: Vec<u64> = self.rounds.iter().map(|r| r.len() as u64).collect();
        let floats = |of: fn(&Round) -> &Vec<f32>| -> Vec<f32> {
            self.rounds.iter().flat_map(|r| of(r).clone()).collect()
        };
        let (visual, verbal) = (floats(|r| &r.visual), floats(|r| &r.verbal));
        let reward = floats(|r| &r.reward);
        let action: Vec<u8> = self.rounds.iter().flat_map(|r| r.action.clone()).collect();
        let perceived: Vec<u64> = self
            .rounds
            .iter()
            .flat_map(|r| &r.perceived)
            .map(|mask| mask.visual | u64::from(mask.verbal) << 32)
            .collect();
        let metadata = BTreeMap::from([
            (models::file::HOLDS.to_owned(), DEMONSTRATIONS.to_owned()),
            (models::file::COMMAND.to_owned(), self.source.clone()),
            (models::file::DOMAIN.to_owned(), self.domain.to_owned()),
            (SETTING.to_owned(), self.setting.name().to_owned()),
            (HEARD.to_owned(), self.heard.to_string()),
            ("mirror.rounds".to_owned(), self.rounds.len().to_string()),
        ]);
        let mut extras = vec![
            ("length", Extra::U64(&lengths)),
            ("visual", Extra::F32(&visual)),
            ("verbal", Extra::F32(&verbal)),
            ("perceived", Extra::U64(&perceived)),
            ("action", Extra::U8(&action)),
            ("reward", Extra::F32(&reward)),
        ];
        if let Some(limits) = &self.limits {
            extras.push((LIMITS, Extra::F32(limits)));
        }
        nn::checkpoint::save(path, &[], &extras, &metadata)
    }

    /// Reads a file of rounds of the domain that `layout` is of.
    ///
    /// # Errors
    /// If it is missing, damaged, holds something else, or its parts do not fit together.
    pub fn load(path: &Path, layout: &Layout) -> Result<Self, RoundsError> {
        Self::from_checkpoint(&nn::checkpoint::load(path)?, layout)
    }

    fn from_checkpoint(file: &Checkpoint, layout: &Layout) -> Result<Self, RoundsError> {
        let bad = |reason: String| RoundsError::Contents {
            file: file.file().to_owned(),
            reason,
        };
        let holds = file.metadata_value(models::file::HOLDS)?;
        if holds != DEMONSTRATIONS {
            return Err(bad(format!("holds {holds}, expected {DEMONSTRATIONS}")));
        }
        let domain = file.metadata_value(models::file::DOMAIN)?;
        if domain != layout.domain {
            let expected = layout.domain;
            return Err(bad(format!("rounds of {domain}, expected {expected}")));
        }
        let setting = file.metadata_value(SETTING)?;
        let setting = [Setting::Original, Setting::Transfer]
            .into_iter()
            .find(|known| known.name() == setting)
            .ok_or_else(|| {
                bad(format!(
                    "metadata \"{SETTING}\" is {setting}, neither original nor transfer"
                ))
            })?;
        let heard = file.metadata_value(HEARD)?;
        let heard = heard
            .parse()
            .map_err(|_| bad(format!("metadata \"{HEARD}\" is {heard}, no number")))?;
        let count = file.metadata_value("mirror.rounds")?;
        let count: usize = count
            .parse()
            .map_err(|_| bad(format!("metadata \"mirror.rounds\" is {count}, no number")))?;
        let lengths = file.u64s("length", count)?;
        let action = file.u8s("action")?;
        let steps = action.len();
        let total = lengths.iter().try_fold(0_u64, |sum, n| sum.checked_add(*n));
        if total != Some(steps as u64) {
            return Err(bad(format!(
                "rounds' lengths do not add up to {steps} actions"
            )));
        }
        let perceived = file.u64s("perceived", steps)?;
        let numbers = |name: &str, width: usize| -> Result<Vec<f32>, RoundsError> {
            let numbers = file.f32s(name)?;
            if numbers.len() != steps * width {
                return Err(bad(format!(
                    "tensor \"{name}\" holds {} numbers, {steps} steps need {}",
                    numbers.len(),
                    steps * width
                )));
            }
            if let Some(i) = numbers.iter().position(|x| !x.is_finite()) {
                let (value, step) = (numbers[i], i / width);
                return Err(bad(format!(
                    "tensor \"{name}\" holds {value} at step {step}"
                )));
            }
            Ok(numbers.to_vec())
        };
        let visual = numbers("visual", layout.visual)?;
        let verbal = numbers("verbal", layout.verbal)?;
        let reward = numbers("reward", 1)?;
        if let Some(step) = action
            .iter()
            .position(|a| usize::from(*a) >= layout.actions.rows())
        {
            let (found, actions) = (action[step], layout.actions.rows());
            return Err(bad(format!(
                "action {found} at step {step}, there are {actions}"
            )));
        }
        let limits = match file.names().any(|name| name == LIMITS) {
            false => None,
            true => Some(file.f32s(LIMITS)?),
        };
        if let Some(limits) = &limits {
            let expected = layout.perception.limits();
            if limits.len() != expected || limits.iter().any(|limit| limit.is_nan() || *limit < 0.0)
            {
                let reason = format!(
                    "tensor \"{LIMITS}\" is {limits:?}, not {expected} limits of at least 0"
                );
                return Err(bad(reason));
            }
        }
        let mut next = 0;
        let rounds = lengths
            .iter()
            .map(|&length| {
                let range = next..next + length as usize;
                next = range.end;
                let part =
                    |x: &[f32], width: usize| x[range.start * width..range.end * width].to_vec();
                Round {
                    visual: part(&visual, layout.visual),
                    verbal: part(&verbal, layout.verbal),
                    perceived: perceived[range.clone()]
                        .iter()
                        .map(|bits| Mask {
                            visual: *bits & u64::from(u32::MAX),
                            verbal: (bits >> 32) as u32,
                        })
                        .collect(),
                    action: action[range.clone()].to_vec(),
                    reward: part(&reward, 1),
                }
            })
            .collect();
        Ok(Self {
            domain: layout.domain,
            setting,
            sizes: [layout.visual, layout.verbal],
            heard,
            limits,
            rounds,
            source: file
                .metadata()
                .get(models::file::COMMAND)
                .cloned()
                .unwrap_or_default(),
        })
    }
}
