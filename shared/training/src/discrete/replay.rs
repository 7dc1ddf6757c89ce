//! The gridworlds' replay buffer: whole rounds, the oldest forgotten first.

use std::collections::VecDeque;

/// A round as it was lived: `steps + 1` observations, with what led to each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Episode {
    /// x^visual, one observation after the other.
    pub visual: Vec<f32>,
    /// x^verbal.
    pub verbal: Vec<f32>,
    /// a_{t−1}; the first is [`NO_ACTION`].
    pub action: Vec<u8>,
    /// r_t; the first is 0.
    pub reward: Vec<f32>,
    /// What the expert would do at each observation, whoever acted; [`NO_ACTION`] at the last.
    pub expert: Vec<u8>,
    /// Whether the last state has no future (and not merely no more time).
    pub terminal: bool,
}

/// Nothing was done before the first observation.
pub const NO_ACTION: u8 = u8::MAX;

impl Episode {
    /// Observations.
    pub fn len(&self) -> usize {
        self.action.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.action.is_empty()
    }

    /// Forgets everything and keeps the memory.
    pub fn clear(&mut self) {
        self.visual.clear();
        self.verbal.clear();
        self.action.clear();
        self.reward.clear();
        self.expert.clear();
        self.terminal = false;
    }
}

/// The newest rounds, up to a number of observations.
#[derive(Clone, Debug)]
pub struct Replay {
    episodes: VecDeque<Episode>,
    capacity: usize,
    held: usize,
    visual: usize,
    verbal: usize,
}

impl Replay {
    /// An empty buffer of `capacity` observations of these sizes.
    pub fn new(capacity: usize, visual: usize, verbal: usize) -> Self {
        Self {
            episodes: VecDeque::new(),
            capacity,
            held: 0,
            visual,
            verbal,
        }
    }

    /// Rounds.
    pub fn episodes(&self) -> &VecDeque<Episode> {
        &self.episodes
    }

    /// Observations of all rounds.
    pub fn observations(&self) -> usize {
        self.held
    }

    /// Adds a round; a round of fewer than two observations teaches nothing and is left out.
    pub fn push(&mut self, episode: Episode) {
        if episode.len() < 2 {
            return;
        }
        self.held += episode.len();
        self.episodes.push_back(episode);
        while self.held > self.capacity && self.episodes.len() > 1 {
            if let Some(oldest) = self.episodes.pop_front() {
                self.held -= oldest.len();
            }
        }
    }

    /// Whether every round could have been lived in a world of so many actions: nothing is done before the first observation,
    /// then one of the actions each time; all numbers are finite.
    pub fn is_sound(&self, actions: usize) -> bool {
        let is_action = |action: &u8| usize::from(*action) < actions;
        self.episodes.iter().all(|episode| {
            let (first, later) = (episode.action.first(), episode.action.iter().skip(1));
            let mut experts = episode.expert.iter();
            let numbers = [&episode.reward, &episode.visual, &episode.verbal];
            first == Some(&NO_ACTION)
                && later.into_iter().all(is_action)
                && experts.all(|expert| *expert == NO_ACTION || is_action(expert))
                && numbers.into_iter().flatten().all(|x| x.is_finite())
        })
    }

    /// Everything as bytes, little-endian: per round its length, whether it is terminal, actions, the expert's actions,
    /// rewards, observations.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Vec::new();
        for episode in &self.episodes {
            out.extend_from_slice(&(episode.len() as u32).to_le_bytes());
            out.push(u8::from(episode.terminal));
            out.extend_from_slice(&episode.action);
            out.extend_from_slice(&episode.expert);
            for numbers in [&episode.reward, &episode.visual, &episode.verbal] {
                for x in numbers {
                    out.extend_from_slice(&x.to_le_bytes());
                }
            }
        }
        out
    }

    /// The rounds in `bytes`, as [`Replay::to_bytes`] wrote them; none if they are something else.
    pub fn read_bytes(&mut self, bytes: &[u8]) -> Option<()> {
        self.episodes.clear();
        self.held = 0;
        let mut rest = bytes;
        let mut take = |n: usize| -> Option<&[u8]> {
            let (taken, left) = rest.split_at_checked(n)?;
            rest = left;
            Some(taken)
        };
        let floats = |bytes: &[u8]| -> Vec<f32> {
            let (numbers, _) = bytes.as_chunks::<4>();
            numbers.iter().map(|n| f32::from_le_bytes(*n)).collect()
        };
        while let Some(head) = take(5) {
            let length = u32::from_le_bytes([head[0], head[1], head[2], head[3]]) as usize;
            let terminal = head[4] == 1;
            if length < 2 || length > bytes.len() {
                return None;
            }
            let action = take(length)?.to_vec();
            let expert = take(length)?.to_vec();
            let reward = floats(take(4 * length)?);
            let visual = floats(take(4 * length * self.visual)?);
            let verbal = floats(take(4 * length * self.verbal)?);
            self.held += length;
            self.episodes.push_back(Episode {
                visual,
                verbal,
                action,
                reward,
                expert,
                terminal,
            });
        }
        rest.is_empty().then_some(())
    }
}
