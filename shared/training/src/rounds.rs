//! Demonstrations: rounds that a person played without an assistant, with what the robot sensed, what the person truly
//! perceived of it (for the models that are told: BC and SQIL), and what they did. `mirror demos` records them, `mirror train
//! human` learns from them.

use domains::discrete::Setting;
use domains::{ActionSpace, Layout, Mask};
use models::file::{COMMAND, DOMAIN, HEARD, HOLDS};
use models::policy::largest;
use nn::checkpoint::{Checkpoint, CheckpointError, Extra};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::path::Path;
use thiserror::Error;

/// Metadata value that tells a file of demonstrations.
const DEMONSTRATIONS: &str = "demonstrations";
/// Metadata key of the setting.
const SETTING: &str = "mirror.setting";
/// Metadata key of the number of rounds.
const ROUNDS: &str = "mirror.rounds";
/// Tensor of what limits the person's sight.
const LIMITS: &str = "limits";

/// One round of n steps.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Round {
    /// x^visual before each action, n × layout.visual.
    pub visual: Vec<f32>,
    /// x^verbal before each action, n × layout.verbal; empty where nobody could be heard.
    pub verbal: Vec<f32>,
    /// What the person perceived of it; empty where that is not known.
    pub perceived: Vec<Mask>,
    /// What they did, n × the numbers of an action; of a choice, zeros with a one.
    pub action: Vec<f32>,
    /// What it gave.
    pub reward: Vec<f32>,
    /// Whether nothing can follow the last step: always in the gridworlds, whose rounds are played to their end; on the
    /// highway, after a collision.
    pub ended: bool,
}

impl Round {
    /// Steps.
    pub fn len(&self) -> usize {
        self.reward.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.reward.is_empty()
    }

    /// x^visual of step `t`.
    pub fn visual(&self, t: usize) -> &[f32] {
        part(&self.visual, self.len(), t)
    }

    /// x^verbal of step `t`; nothing where nobody could be heard.
    pub fn verbal(&self, t: usize) -> &[f32] {
        part(&self.verbal, self.len(), t)
    }

    /// What was done at step `t`.
    pub fn action(&self, t: usize) -> &[f32] {
        part(&self.action, self.len(), t)
    }

    /// Which choice was made at step `t`.
    pub fn choice(&self, t: usize) -> usize {
        largest(self.action(t))
    }

    /// Adds a step of which the mask is known.
    pub fn push(
        &mut self,
        [visual, verbal]: [&[f32]; 2],
        perceived: Mask,
        action: &[f32],
        reward: f32,
    ) {
        self.visual.extend_from_slice(visual);
        self.verbal.extend_from_slice(verbal);
        self.perceived.push(perceived);
        self.action.extend_from_slice(action);
        self.reward.push(reward);
    }

    /// What somebody of these limits, who hears nobody, perceived: where perception is no matter of chance.
    pub fn perceive_within(&mut self, layout: &Layout, limits: &[f32]) {
        let seen = |t| Mask {
            visual: layout.perception.seen(limits, self.visual(t), None),
            verbal: 0,
        };
        self.perceived = (0..self.len()).map(seen).collect();
    }
}

/// Probability that an item is told in a round in place of being seen.
const TOLD: f32 = 0.35;

impl Round {
    /// The same round of somebody who is told some items, drawn for the round, wherever they saw them: they know as much, and so they
    /// did the same. None where what was perceived is not known, nobody could be heard, or nothing was changed.
    ///
    /// Without it, a policy that learns from rounds in which nobody speaks does not know what words mean.
    pub fn told_what_was_seen(&self, layout: &Layout, rng: &mut ChaCha8Rng) -> Option<Self> {
        if self.perceived.len() != self.len() || self.verbal.is_empty() {
            return None;
        }
        let items: Vec<(usize, u64)> = layout
            .told_regions
            .iter()
            .copied()
            .enumerate()
            .filter(|(_, regions)| *regions != 0 && rng.random::<f32>() < TOLD)
            .collect();
        let mut changed = false;
        let told = self.perceived.iter().map(|before| {
            let mut mask = *before;
            for (utterance, regions) in &items {
                if before.visual & regions != 0 {
                    mask.visual &= !regions;
                    mask.verbal |= 1 << utterance;
                }
            }
            changed |= mask != *before;
            mask
        });
        let perceived = told.collect();
        changed.then(|| Self {
            perceived,
            ..self.clone()
        })
    }
}

/// The `t`-th of `n` equal parts.
fn part(numbers: &[f32], n: usize, t: usize) -> &[f32] {
    let width = numbers.len() / n.max(1);
    &numbers[t * width..(t + 1) * width]
}

/// A choice as a column.
pub(crate) fn one_hot(choice: usize, actions: usize) -> impl Iterator<Item = f32> {
    (0..actions).map(move |action| f32::from(u8::from(action == choice)))
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
    /// What an action is.
    pub actions: ActionSpace,
    /// Utterances that the person hears without an assistant, a bit each.
    pub heard: u32,
    /// What limits the person's sight, where it is known: for the models that are told.
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
            actions: layout.actions,
            heard,
            limits: None,
            rounds: Vec::new(),
            source: String::new(),
        }
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

    /// Writes the rounds as a safetensors file: `length` (u64, steps per round), `ended` (u8 per round), `visual`, `action`
    /// (numbers, or u8 per choice) and `reward` per step and, where that is known, `limits`. Where somebody could be heard, also
    /// `verbal` and `perceived` (u64 per step: regions, and from bit 32 on utterances); elsewhere what was perceived follows from
    /// the limits.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), CheckpointError> {
        let lengths: Vec<u64> = self.rounds.iter().map(|r| r.len() as u64).collect();
        let ended: Vec<u8> = self.rounds.iter().map(|r| u8::from(r.ended)).collect();
        let floats = |of: fn(&Round) -> &Vec<f32>| -> Vec<f32> {
            self.rounds.iter().flat_map(|r| of(r).clone()).collect()
        };
        let (visual, verbal) = (floats(|r| &r.visual), floats(|r| &r.verbal));
        let (action, reward) = (floats(|r| &r.action), floats(|r| &r.reward));
        let choices: Vec<u8> = match self.actions {
            ActionSpace::Continuous(_) => Vec::new(),
            ActionSpace::Discrete(n) => action.chunks(n).map(|a| largest(a) as u8).collect(),
        };
        let perceived: Vec<u64> = self
            .rounds
            .iter()
            .flat_map(|r| &r.perceived)
            .map(|mask| mask.visual | u64::from(mask.verbal) << 32)
            .collect();
        let metadata = BTreeMap::from([
            (HOLDS.to_owned(), DEMONSTRATIONS.to_owned()),
            (COMMAND.to_owned(), self.source.clone()),
            (DOMAIN.to_owned(), self.domain.to_owned()),
            (SETTING.to_owned(), self.setting.name().to_owned()),
            (HEARD.to_owned(), self.heard.to_string()),
            (ROUNDS.to_owned(), self.rounds.len().to_string()),
        ]);
        let mut extras = vec![
            ("length", Extra::U64(&lengths)),
            ("ended", Extra::U8(&ended)),
            ("visual", Extra::F32(&visual)),
            ("reward", Extra::F32(&reward)),
        ];
        extras.push(match self.actions {
            ActionSpace::Continuous(_) => ("action", Extra::F32(&action)),
            ActionSpace::Discrete(_) => ("action", Extra::U8(&choices)),
        });
        if !verbal.is_empty() || visual.is_empty() {
            extras.push(("verbal", Extra::F32(&verbal)));
            extras.push(("perceived", Extra::U64(&perceived)));
        }
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
        let holds = file.metadata_value(HOLDS)?;
        if holds != DEMONSTRATIONS {
            return Err(bad(format!("holds {holds}, expected {DEMONSTRATIONS}")));
        }
        let domain = file.metadata_value(DOMAIN)?;
        if domain != layout.domain {
            let expected = layout.domain;
            return Err(bad(format!("rounds of {domain}, expected {expected}")));
        }
        let has = |tensor: &str| file.names().any(|name| name == tensor);
        if has("collided") {
            let again = "rounds of an earlier version; record them anew with `mirror demos`";
            return Err(bad(again.to_owned()));
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
        let number = |key: &str| -> Result<u64, RoundsError> {
            let text = file.metadata_value(key)?;
            text.parse()
                .map_err(|_| bad(format!("metadata \"{key}\" is {text}, no number")))
        };
        let heard = number(HEARD)?;
        let heard = u32::try_from(heard).map_err(|_| {
            bad(format!(
                "metadata \"{HEARD}\" is {heard}, no set of utterances"
            ))
        })?;
        let count = number(ROUNDS)? as usize;
        let lengths = file.u64s("length", count)?;
        let total = lengths.iter().try_fold(0_u64, |sum, n| sum.checked_add(*n));
        let reward = file.f32s("reward")?;
        let steps = reward.len();
        if total != Some(steps as u64) {
            return Err(bad(format!(
                "rounds' lengths do not add up to {steps} steps"
            )));
        }
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
            Ok(numbers)
        };
        let reward = numbers("reward", 1)?;
        let visual = numbers("visual", layout.visual)?;
        let rows = layout.actions.rows();
        let action = match layout.actions {
            ActionSpace::Continuous(_) => numbers("action", rows)?,
            ActionSpace::Discrete(_) => {
                let choices = file.u8s("action")?;
                if choices.len() != steps {
                    let found = choices.len();
                    return Err(bad(format!("{steps} steps have {found} actions")));
                }
                let beyond = choices.iter().position(|a| usize::from(*a) >= rows);
                if let Some(step) = beyond {
                    let found = choices[step];
                    return Err(bad(format!(
                        "action {found} at step {step}, there are {rows}"
                    )));
                }
                let choices = choices.iter();
                choices
                    .flat_map(|a| one_hot(usize::from(*a), rows))
                    .collect()
            }
        };
        let limits = match has(LIMITS) {
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
        let ended = match has("ended") {
            // Tables of one's own do not say: their rounds are played to the end.
            false => vec![1; count],
            true => file.u8s("ended")?.to_vec(),
        };
        if ended.len() != count {
            return Err(bad(format!("{count} rounds have {} ends", ended.len())));
        }
        let spoken = heard != 0 || has("verbal");
        let (verbal, perceived) = match spoken {
            false => (Vec::new(), Vec::new()),
            true => (
                numbers("verbal", layout.verbal)?,
                file.u64s("perceived", steps)?,
            ),
        };
        let mut next = 0;
        let rounds = lengths.iter().zip(ended).map(|(&length, ended)| {
            let range = next..next + length as usize;
            next = range.end;
            let part = |x: &[f32], width: usize| x[range.start * width..range.end * width].to_vec();
            let mut round = Round {
                visual: part(&visual, layout.visual),
                action: part(&action, rows),
                reward: part(&reward, 1),
                ended: ended != 0,
                ..Round::default()
            };
            if spoken {
                round.verbal = part(&verbal, layout.verbal);
                let masks = perceived[range.clone()].iter().map(|bits| Mask {
                    visual: *bits & u64::from(u32::MAX),
                    verbal: (bits >> 32) as u32,
                });
                round.perceived = masks.collect();
            } else if let (Some(limits), 0) = (&limits, layout.perception.noise_rows()) {
                round.perceive_within(layout, limits);
            }
            round
        });
        let rounds = rounds.collect();
        Ok(Self {
            setting,
            heard,
            limits,
            rounds,
            source: file.metadata().get(COMMAND).cloned().unwrap_or_default(),
            ..Self::new(layout, setting, heard)
        })
    }
}
