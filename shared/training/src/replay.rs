//! The replay buffer: whole rounds, the oldest forgotten first, from which sequences within one round are drawn.

use domains::{ActionSpace, Layout, Mask};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;

/// A round as it was lived: `steps + 1` observations, with what led to each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Episode {
    /// x^visual, one observation after the other.
    pub visual: Vec<f32>,
    /// x^verbal: all that could truly be said.
    pub verbal: Vec<f32>,
    /// a_{t−1}, an action after the other; zeros before the first.
    pub action: Vec<f32>,
    /// r_t; the first is 0.
    pub reward: Vec<f32>,
    /// What the expert would do at each observation, whoever acted; zeros where that is nothing.
    pub expert: Vec<f32>,
    /// What an expert would do who sees no more than whoever acted; zeros where there is none.
    pub peer: Vec<f32>,
    /// What whoever acted perceived of each observation. A model that perceives less than that must not learn from what they did:
    /// the action would tell it what it cannot know.
    pub perceived: Vec<Mask>,
    /// Whether the last state has no future (and not merely no more time).
    pub terminal: bool,
}

impl Episode {
    /// Observations.
    pub fn len(&self) -> usize {
        self.reward.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.reward.is_empty()
    }

    /// Forgets everything and keeps the memory.
    pub fn clear(&mut self) {
        for numbers in self.numbers_mut() {
            numbers.clear();
        }
        self.perceived.clear();
        self.terminal = false;
    }

    /// x^visual of observation `t`.
    pub fn visual(&self, t: usize) -> &[f32] {
        self.part(&self.visual, t)
    }

    /// x^verbal of observation `t`.
    pub fn verbal(&self, t: usize) -> &[f32] {
        self.part(&self.verbal, t)
    }

    /// What was done before observation `t`.
    pub fn action(&self, t: usize) -> &[f32] {
        self.part(&self.action, t)
    }

    /// What the expert would do at observation `t`.
    pub fn expert(&self, t: usize) -> &[f32] {
        self.part(&self.expert, t)
    }

    /// What an expert would do at observation `t` who sees no more than whoever acted.
    pub fn peer(&self, t: usize) -> &[f32] {
        self.part(&self.peer, t)
    }

    fn part<'a>(&self, numbers: &'a [f32], t: usize) -> &'a [f32] {
        let width = numbers.len() / self.len().max(1);
        &numbers[t * width..(t + 1) * width]
    }

    fn numbers(&self) -> [&Vec<f32>; 6] {
        [
            &self.reward,
            &self.action,
            &self.expert,
            &self.peer,
            &self.visual,
            &self.verbal,
        ]
    }

    fn numbers_mut(&mut self) -> [&mut Vec<f32>; 6] {
        [
            &mut self.reward,
            &mut self.action,
            &mut self.expert,
            &mut self.peer,
            &mut self.visual,
            &mut self.verbal,
        ]
    }
}

/// The newest rounds, up to a number of observations.
#[derive(Clone, Debug)]
pub struct Replay {
    episodes: VecDeque<Episode>,
    /// Observations before each round.
    before: Vec<usize>,
    capacity: usize,
    held: usize,
    /// Numbers of an observation, in the order of [`Episode::numbers`].
    widths: [usize; 6],
    actions: ActionSpace,
}

impl Replay {
    /// An empty buffer of `capacity` observations of a domain.
    pub fn new(capacity: usize, layout: &Layout) -> Self {
        let actions = layout.actions.rows();
        Self {
            episodes: VecDeque::new(),
            before: Vec::new(),
            capacity,
            held: 0,
            widths: [1, actions, actions, actions, layout.visual, layout.verbal],
            actions: layout.actions,
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
        self.count();
    }

    fn count(&mut self) {
        self.before.clear();
        let mut before = 0;
        for episode in &self.episodes {
            self.before.push(before);
            before += episode.len();
        }
    }

    /// A random sequence of `length` observations within one round, each as likely: the round, and the first observation. None
    /// if 10,000 draws meet no such sequence.
    pub fn draw(&self, length: usize, rng: &mut ChaCha8Rng) -> Option<(&Episode, usize)> {
        let latest = self.held.checked_sub(length)?;
        (0..10_000).find_map(|_| {
            let at = rng.random_range(0..=latest);
            let round = self.before.partition_point(|before| *before <= at) - 1;
            let (episode, start) = (&self.episodes[round], at - self.before[round]);
            (start + length <= episode.len()).then_some((episode, start))
        })
    }

    /// Everything as bytes, little-endian: per round its length, whether it is terminal, rewards, actions, the experts' actions,
    /// observations, what was perceived of each.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(4 * self.held * self.widths.iter().sum::<usize>());
        for episode in &self.episodes {
            out.extend_from_slice(&(episode.len() as u32).to_le_bytes());
            out.push(u8::from(episode.terminal));
            for x in episode.numbers().into_iter().flatten() {
                out.extend_from_slice(&x.to_le_bytes());
            }
            for mask in &episode.perceived {
                out.extend_from_slice(&mask.visual.to_le_bytes());
                out.extend_from_slice(&mask.verbal.to_le_bytes());
            }
        }
        out
    }

    /// Takes the rounds in `bytes`, as [`Replay::to_bytes`] wrote them; none if they are something else, or rounds that could not
    /// have been lived: actions that there are not, numbers that are not finite.
    pub fn read_bytes(&mut self, bytes: &[u8]) -> Option<()> {
        self.episodes.clear();
        self.held = 0;
        let mut rest = bytes;
        let mut take = |n: usize| -> Option<&[u8]> {
            let (taken, left) = rest.split_at_checked(n)?;
            rest = left;
            Some(taken)
        };
        while let Some(head) = take(5) {
            let length = u32::from_le_bytes([head[0], head[1], head[2], head[3]]) as usize;
            if length < 2 || length > bytes.len() {
                return None;
            }
            let mut episode = Episode {
                terminal: head[4] == 1,
                ..Episode::default()
            };
            for (numbers, width) in episode.numbers_mut().into_iter().zip(self.widths) {
                let (read, _) = take(4 * length * width)?.as_chunks::<4>();
                numbers.extend(read.iter().map(|n| f32::from_le_bytes(*n)));
            }
            let (masks, _) = take(MASK_BYTES * length)?.as_chunks::<MASK_BYTES>();
            episode.perceived.extend(masks.iter().map(mask));
            if !is_possible(&episode, self.actions) {
                return None;
            }
            self.held += length;
            self.episodes.push_back(episode);
        }
        self.count();
        rest.is_empty().then_some(())
    }
}

/// Bytes of a mask in a checkpoint.
const MASK_BYTES: usize = 12;

fn mask(bytes: &[u8; MASK_BYTES]) -> Mask {
    let [a, b, c, d, e, f, g, h, i, j, k, l] = *bytes;
    Mask {
        visual: u64::from_le_bytes([a, b, c, d, e, f, g, h]),
        verbal: u32::from_le_bytes([i, j, k, l]),
    }
}

fn is_possible(episode: &Episode, actions: ActionSpace) -> bool {
    let mut numbers = episode.numbers().into_iter().flatten();
    if !numbers.all(|x| x.is_finite()) {
        return false;
    }
    let ActionSpace::Discrete(n) = actions else {
        return true;
    };
    let ones = |action: &[f32]| action.iter().filter(|x| **x == 1.0).count();
    let zeros = |action: &[f32]| action.iter().filter(|x| **x == 0.0).count();
    let is_choice = |action: &[f32]| ones(action) == 1 && zeros(action) == n - 1;
    let is_none = |action: &[f32]| zeros(action) == n;
    is_none(episode.action(0))
        && (1..episode.len()).all(|t| is_choice(episode.action(t)))
        && (0..episode.len()).all(|t| is_choice(episode.expert(t)) || is_none(episode.expert(t)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use domains::highway::modalities::layout;
    use rand::SeedableRng;

    fn episode(length: usize, first: f32) -> Episode {
        let numbers = |width: usize| (0..length * width).map(|i| first + i as f32).collect();
        let layout = layout();
        Episode {
            visual: numbers(layout.visual),
            verbal: numbers(layout.verbal),
            action: numbers(2),
            reward: numbers(1),
            expert: numbers(2),
            peer: numbers(2),
            perceived: vec![layout.sensed; length],
            terminal: length.is_multiple_of(2),
        }
    }

    #[test]
    fn the_newest_rounds_are_held_and_survive_the_trip() {
        let mut replay = Replay::new(12, &layout());
        for n in 0..5 {
            replay.push(episode(4, n as f32));
        }
        assert_eq!((replay.episodes().len(), replay.observations()), (3, 12));
        assert_eq!(replay.episodes()[0], episode(4, 2.0));
        let bytes = replay.to_bytes();
        let mut back = Replay::new(12, &layout());
        assert_eq!(back.read_bytes(&bytes), Some(()));
        assert_eq!(back.episodes(), replay.episodes());
        assert_eq!(back.read_bytes(&bytes[1..]), None);
        assert_eq!(back.read_bytes(&bytes[..bytes.len() - 1]), None);
    }

    #[test]
    fn sequences_stay_in_one_round_and_start_anywhere_in_it() {
        let mut replay = Replay::new(100, &layout());
        for n in 0..4 {
            replay.push(episode(7, 100.0 * n as f32));
        }
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut starts = [0; 7];
        for _ in 0..400 {
            let (episode, start) = replay.draw(4, &mut rng).expect("there are sequences");
            assert!(start + 4 <= episode.len());
            starts[start] += 1;
        }
        assert!(starts[..4].iter().all(|n| *n > 60), "{starts:?}");
        assert!(replay.draw(8, &mut rng).is_none());
    }
}
