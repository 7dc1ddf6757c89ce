//! The replay buffer: a ring of steps, from which sequences within one episode are drawn.

use domains::highway::modalities::VISUAL;
use domains::highway::{BEAMS, LIDAR_RANGE_M, SECTORS};
use models::utterances::{Said, UtteranceTable};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// One step as it was lived.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// x^visual_t: nearness and ego values.
    pub visual: [f32; VISUAL],
    /// What could truly be said of each sector.
    pub said: [u8; SECTORS],
    /// Range of each sector's nearest car over 40 m.
    pub said_range: [f32; SECTORS],
    /// a_{t−1}; zeros at an episode's first step.
    pub action: [f32; 2],
    /// What the expert would do at t.
    pub expert: [f32; 2],
    /// r_t.
    pub reward: f32,
    /// 1 at an episode's first step.
    pub first: u8,
    /// 1 where the episode ended in a state without future (a collision, not the clock).
    pub terminal: u8,
}

impl Step {
    /// Whether something is going on: a car within 20 m, an expert who brakes or steers, or an end. Most of a drive is
    /// empty road; what has to be learned happens in a few seconds of it.
    pub fn is_eventful(&self) -> bool {
        let beams = &self.visual[..BEAMS];
        self.terminal == 1
            || self.expert[0] < -0.2
            || self.expert[1].abs() > 0.2
            || beams.iter().any(|nearness| *nearness > 0.5)
    }

    fn is_finite(&self) -> bool {
        let numbers = self.visual.iter().chain(&self.said_range);
        let mut numbers = numbers.chain(&self.action).chain(&self.expert);
        numbers.all(|x| x.is_finite()) && self.reward.is_finite()
    }

    /// Bytes of a step in a checkpoint.
    pub const BYTES: usize = 4 * (VISUAL + SECTORS + 2 + 2 + 1) + SECTORS + 2;

    /// The verbal modality's 120 numbers.
    pub fn write_verbal(&self, table: &UtteranceTable, out: &mut [f32]) {
        for sector in 0..SECTORS {
            let said = match self.said[sector] {
                0 => Said::Nothing,
                1 => Said::Slow,
                _ => Said::Fast,
            };
            table.encode(sector, said, self.said_range[sector] * LIDAR_RANGE_M, out);
        }
    }

    fn write(&self, out: &mut Vec<u8>) {
        let mut floats = |values: &[f32]| {
            for value in values {
                out.extend_from_slice(&value.to_le_bytes());
            }
        };
        floats(&self.visual);
        floats(&self.said_range);
        floats(&self.action);
        floats(&self.expert);
        floats(&[self.reward]);
        out.extend_from_slice(&self.said);
        out.extend_from_slice(&[self.first, self.terminal]);
    }

    fn read(bytes: &[u8]) -> Self {
        let float = |i: usize| {
            let at = 4 * i;
            f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
        };
        let mut next = 0;
        let mut take = || {
            next += 1;
            float(next - 1)
        };
        let visual = core::array::from_fn(|_| take());
        let said_range = core::array::from_fn(|_| take());
        let action = core::array::from_fn(|_| take());
        let expert = core::array::from_fn(|_| take());
        let reward = take();
        let tail = &bytes[Self::BYTES - SECTORS - 2..];
        Self {
            visual,
            said: core::array::from_fn(|i| tail[i]),
            said_range,
            action,
            expert,
            reward,
            first: tail[SECTORS],
            terminal: tail[SECTORS + 1],
        }
    }
}

/// A ring of the newest steps.
#[derive(Clone, Debug)]
pub struct Replay {
    steps: Vec<Step>,
    eventful: Vec<bool>,
    capacity: usize,
    /// Where the next step goes once the ring is full.
    head: usize,
}

impl Replay {
    /// An empty ring of `capacity` steps.
    pub fn new(capacity: usize) -> Self {
        Self {
            steps: Vec::new(),
            eventful: Vec::new(),
            capacity,
            head: 0,
        }
    }

    /// Steps held.
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// Whether nothing is held.
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// Adds a step, in the order of time.
    pub fn push(&mut self, step: Step) {
        if self.steps.len() < self.capacity {
            self.eventful.push(step.is_eventful());
            self.steps.push(step);
        } else {
            self.eventful[self.head] = step.is_eventful();
            self.steps[self.head] = step;
            self.head = (self.head + 1) % self.capacity;
        }
    }

    /// The `i`-th oldest step.
    pub fn get(&self, i: usize) -> &Step {
        &self.steps[(self.head + i) % self.steps.len()]
    }

    /// Whether `length` steps from `start` lie in one episode.
    pub fn is_sequence(&self, start: usize, length: usize) -> bool {
        start + length <= self.len() && (1..length).all(|t| self.get(start + t).first == 0)
    }

    /// A random start of a sequence within one episode; none if there is no such sequence among 10,000 draws.
    pub fn draw(&self, length: usize, rng: &mut ChaCha8Rng) -> Option<usize> {
        if self.len() < length {
            return None;
        }
        (0..10_000)
            .map(|_| rng.random_range(0..=self.len() - length))
            .find(|&start| self.is_sequence(start, length))
    }

    /// Like [`Self::draw`], but of a sequence in which something is going on, if 100 draws meet one.
    pub fn draw_eventful(&self, length: usize, rng: &mut ChaCha8Rng) -> Option<usize> {
        let n = self.steps.len();
        let mut start = None;
        for _ in 0..100 {
            let drawn = self.draw(length, rng)?;
            start = Some(drawn);
            if (0..length).any(|t| self.eventful[(self.head + drawn + t) % n]) {
                break;
            }
        }
        start
    }

    /// All steps, oldest first.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(self.len() * Step::BYTES);
        for i in 0..self.len() {
            self.get(i).write(&mut out);
        }
        out
    }

    /// The inverse of [`Self::to_bytes`]; none if the length is no whole number of steps or above the capacity, or one of the
    /// numbers is not finite.
    pub fn from_bytes(bytes: &[u8], capacity: usize) -> Option<Self> {
        if !bytes.len().is_multiple_of(Step::BYTES) || bytes.len() / Step::BYTES > capacity {
            return None;
        }
        let steps: Vec<Step> = bytes.chunks_exact(Step::BYTES).map(Step::read).collect();
        if !steps.iter().all(Step::is_finite) {
            return None;
        }
        Some(Self {
            eventful: steps.iter().map(Step::is_eventful).collect(),
            steps,
            capacity,
            head: 0,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    fn step(n: f32, first: u8) -> Step {
        Step {
            visual: core::array::from_fn(|i| n + i as f32),
            said: [0, 1, 2, 0, 1, 2],
            said_range: [0.5; SECTORS],
            action: [n, -n],
            expert: [0.1, 0.2],
            reward: n,
            first,
            terminal: 1 - first,
        }
    }

    #[test]
    fn bytes_round_trip_in_order() {
        let mut replay = Replay::new(5);
        for n in 0..8 {
            replay.push(step(n as f32, u8::from(n % 3 == 0)));
        }
        let back = Replay::from_bytes(&replay.to_bytes(), 5).expect("same bytes");
        assert_eq!(back.len(), 5);
        for i in 0..5 {
            assert_eq!(back.get(i), replay.get(i));
            assert_eq!(back.get(i).reward, (i + 3) as f32);
        }
        assert!(Replay::from_bytes(&[0; Step::BYTES + 1], 5).is_none());
    }

    #[test]
    fn sequences_stay_in_one_episode() {
        let mut replay = Replay::new(100);
        for n in 0..100 {
            replay.push(step(n as f32, u8::from(n % 7 == 0)));
        }
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..200 {
            let start = replay.draw(4, &mut rng).expect("there are sequences");
            let episode = |i: usize| (replay.get(i).reward as usize) / 7;
            assert_eq!(episode(start), episode(start + 3));
        }
        assert!(replay.draw(8, &mut rng).is_none());
    }
}
