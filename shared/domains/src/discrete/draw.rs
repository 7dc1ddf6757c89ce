//! Chance: a simulated person's random numbers, and drawing an action from its probabilities.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::random;

/// A simulated person's random numbers. Who they are is mixed in: two people of the same parameters are not the same person.
#[derive(Clone, Debug)]
pub(crate) struct Chance {
    /// For what they do.
    pub acts: ChaCha8Rng,
    /// For what they notice.
    pub eyes: ChaCha8Rng,
    stream: u64,
}

impl Chance {
    /// Of person `id` of a domain, whose people's streams begin at `stream`.
    pub fn new(stream: u64, id: u32) -> Self {
        let stream = stream ^ u64::from(id) << 8;
        Self {
            acts: random(0, 0, stream),
            eyes: random(0, 0, stream ^ 1),
            stream,
        }
    }

    /// Begins anew from (seed, episode, stream).
    pub fn reseed(&mut self, seed: u64, episode: u32, stream: u64) {
        let stream = self.stream ^ stream << 40;
        self.acts = random(seed, episode, stream);
        self.eyes = random(seed, episode, stream ^ 1);
    }
}

/// An index drawn with probability proportional to its weight; the last of positive weight where rounding leaves none.
pub(crate) fn draw(weights: &[f32], random: &mut ChaCha8Rng) -> usize {
    let total: f32 = weights.iter().sum();
    let mut left = random.random::<f32>() * total;
    let mut last = 0;
    for (index, weight) in weights.iter().enumerate() {
        if *weight <= 0.0 {
            continue;
        }
        last = index;
        if left < *weight {
            break;
        }
        left -= weight;
    }
    last
}
