//! How much somebody perceives in a round that is lived for learning: everything that could happen to a person with an assistant.

use domains::highway::modalities::{self, MAX_SIGHT_M};
use domains::highway::speech::sector_of;
use domains::highway::{AZIMUTHS, SECTORS};
use domains::{Layout, Mask};
use nn::noise;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// A perception, drawn anew for each round.
#[derive(Clone, Debug)]
pub struct Sighted {
    layout: Arc<Layout>,
    /// Limits of sight, in the order of the domain's [`domains::Perception`]; infinite where everything is sensed.
    pub limits: Vec<f32>,
    chance: Vec<f32>,
    /// Probability that an item is communicated in a step.
    told: f32,
    limited: bool,
}

/// Probabilities, one of them drawn for each round of a gridworld, that an item is communicated in a step. On the highway speech is
/// rare, and sequences are told it as they are drawn.
const TOLD: [f32; 3] = [0.0, 0.05, 0.2];

impl Sighted {
    /// Somebody who perceives as the robot does.
    pub fn new(layout: &Arc<Layout>) -> Self {
        let perception = layout.perception;
        Self {
            layout: Arc::clone(layout),
            limits: vec![f32::INFINITY; perception.limits()],
            chance: vec![0.0; perception.noise_rows()],
            told: 0.0,
            limited: false,
        }
    }

    /// Another round, in which sight is limited or not.
    pub fn draw(&mut self, limited: bool, rng: &mut ChaCha8Rng) {
        self.limited = limited;
        if !limited {
            self.limits.fill(f32::INFINITY);
            return;
        }
        if self.layout.domain == modalities::NAME {
            self.limits.copy_from_slice(&limits_m(rng));
            return;
        }
        // Half of these people see nothing or nearly nothing.
        let share = rng.random_range(-0.5_f32..1.0).max(0.0);
        self.told = TOLD[rng.random_range(0..TOLD.len())];
        for limit in &mut self.limits {
            let own = (share * rng.random_range(0.5..1.5)).clamp(0.0, 1.0);
            *limit = own * self.layout.perception.largest();
        }
    }

    /// What is perceived of `visual`, the whole modality.
    pub fn perceive(&mut self, visual: &[f32], rng: &mut ChaCha8Rng) -> Mask {
        if !self.limited {
            return self.layout.sensed;
        }
        let chance = (!self.chance.is_empty()).then(|| {
            noise::fill(&mut self.chance, rng.random(), 0);
            &self.chance[..]
        });
        let seen = Mask {
            visual: self.layout.perception.seen(&self.limits, visual, chance),
            verbal: 0,
        };
        match self.told > 0.0 {
            true => seen | subset(self.layout.everything(), self.told, rng),
            false => seen,
        }
    }
}

/// Limits of sight on the highway: a distance per sector, from almost nothing to beyond the LIDAR's range; a quarter of the people see
/// nothing.
fn limits_m(rng: &mut ChaCha8Rng) -> [f32; AZIMUTHS] {
    let most = match rng.random_range(0..4) {
        0 => 1.0,
        1 => MAX_SIGHT_M / 2.0,
        _ => MAX_SIGHT_M,
    };
    let sectors: [f32; SECTORS] = core::array::from_fn(|_| rng.random_range(0.5..most));
    core::array::from_fn(|azimuth| sectors[sector_of(azimuth)])
}

/// Each item with the same probability.
pub(crate) fn subset(of: Mask, probability: f32, rng: &mut ChaCha8Rng) -> Mask {
    let mut draw = |bits: u64| {
        (0..64)
            .filter(|bit| bits >> bit & 1 == 1)
            .fold(0, |kept, bit| {
                kept | u64::from(rng.random::<f32>() < probability) << bit
            })
    };
    Mask {
        visual: draw(of.visual),
        verbal: draw(of.verbal.into()) as u32,
    }
}
