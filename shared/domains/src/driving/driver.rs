//! A simulated driver: remembers every car that they saw or were told of, and plans by the cross-entropy method for the reward
//! that was learned for them (paper, Appendix, "Simulated Humans Agents").

use rand::RngExt;

use super::person::{MAX_HORIZON, MAX_SAMPLES};
use super::{
    CARS, Car, FEATURES, Person, RANGE_CELLS, STAY, SWITCH, Scene, advance, features, visible,
};
use crate::Mask;
use crate::discrete::{Chance, Limits, Mind, Setting, Sight, draw};

/// Stream of random numbers of drivers.
const STREAM: u64 = 0x6472_7672;
/// Probability of a lane change in the first iteration's sequences.
const FIRST_PROBABILITY: f32 = 0.3;
/// Share of the elites' frequencies in the next probabilities.
const SMOOTHING: f32 = 0.8;

/// What a driver knows of a car.
#[derive(Clone, Copy, Debug, Default)]
struct Known {
    car: Car,
    /// Whether the position is from this step.
    fresh: bool,
}

/// A simulated driver.
#[derive(Clone, Debug)]
pub struct SimulatedDriver {
    weights: [f32; FEATURES],
    slip: f32,
    horizon: usize,
    samples: usize,
    iterations: u32,
    elites: usize,
    discount: f32,
    sight: Sight,
    chance: Chance,
    lane: usize,
    known: [Option<Known>; CARS],
}

impl SimulatedDriver {
    /// A driver in a scene's setting, at the start of a round.
    pub fn new(person: &Person, scene: &Scene) -> Self {
        let (ahead, behind) = match scene.setting {
            Setting::Original => (RANGE_CELLS, RANGE_CELLS),
            Setting::Transfer => (scene.fog.ahead_cells as f32, scene.fog.behind_cells as f32),
        };
        let planning = &person.planning;
        let samples = (planning.samples as usize).clamp(2, MAX_SAMPLES);
        Self {
            weights: person.weights.array(),
            slip: person.slip,
            horizon: (planning.horizon as usize).clamp(1, MAX_HORIZON),
            samples,
            iterations: planning.iterations,
            elites: (planning.elites as usize).clamp(1, samples),
            discount: planning.discount,
            sight: Sight {
                limits: Limits::Thresholds([ahead, ahead, behind, behind]),
                heard: 0,
            },
            chance: Chance::new(STREAM, person.id),
            lane: 0,
            known: [None; CARS],
        }
    }

    /// Where they believe each car to be, in cells ahead; `None` where they know nothing.
    pub fn believed_cells(&self) -> [Option<f32>; CARS] {
        self.known.map(|known| known.map(|k| k.car.cell as f32))
    }

    /// Reward of each step of the horizon, by lane and action: `[step][lane after][action]`, with known cars at constant speed.
    fn rewards(&self) -> [[[f32; 2]; 2]; MAX_HORIZON] {
        // Cars of which nothing is known are kept out of the way of the others.
        let mut cars = self.known.map(|known| known.map_or(FAR_AWAY, |k| k.car));
        for slot in 0..CARS {
            if self.known[slot].is_none() && slot < 2 {
                cars[slot].cell = -FAR_AWAY.cell;
            }
        }
        let mut out = [[[0.0; 2]; 2]; MAX_HORIZON];
        let mut weight = 1.0;
        for step in out.iter_mut().take(self.horizon) {
            advance(&mut cars);
            let cells: [Option<f32>; CARS] =
                std::array::from_fn(|slot| self.known[slot].map(|_| cars[slot].cell as f32));
            for (lane, by_action) in step.iter_mut().enumerate() {
                for (action, reward) in by_action.iter_mut().enumerate() {
                    let features = features(lane, action, &cells);
                    let terms = features.iter().zip(&self.weights);
                    *reward = weight * terms.map(|(f, w)| f * w).sum::<f32>();
                }
            }
            weight *= self.discount;
        }
        out
    }

    /// The best return found for each first action, by the cross-entropy method over sequences of actions.
    fn plan(&mut self) -> [f32; 2] {
        let rewards = self.rewards();
        let mut best = [f32::NEG_INFINITY; 2];
        let mut probability = [FIRST_PROBABILITY; MAX_HORIZON];
        let mut sequences = [0u16; MAX_SAMPLES];
        let mut returns = [(0.0f32, 0u8); MAX_SAMPLES];
        for iteration in 0..self.iterations {
            for sample in 0..self.samples {
                let mut sequence = 0u16;
                for (step, p) in probability.iter().enumerate().take(self.horizon) {
                    sequence |= u16::from(self.chance.acts.random::<f32>() < *p) << step;
                }
                if iteration == 0 && sample < 2 {
                    sequence = sample as u16; // both first actions are tried at least once: stay, or switch and stay
                }
                let mut lane = self.lane;
                let mut total = 0.0;
                for (step, reward) in rewards.iter().enumerate().take(self.horizon) {
                    let action = (sequence >> step & 1) as usize;
                    lane ^= action;
                    total += reward[lane][action];
                }
                let first = (sequence & 1) as usize;
                best[first] = best[first].max(total);
                sequences[sample] = sequence;
                returns[sample] = (total, sample as u8);
            }
            let order = &mut returns[..self.samples];
            order.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            for (step, p) in probability.iter_mut().enumerate().take(self.horizon) {
                let switches = order[..self.elites]
                    .iter()
                    .filter(|(_, sample)| sequences[*sample as usize] >> step & 1 == 1);
                let frequency = switches.count() as f32 / self.elites as f32;
                *p = SMOOTHING * frequency + (1.0 - SMOOTHING) * *p;
            }
        }
        best
    }
}

/// Where an unknown car of the rear slots is put; the front ones' is the mirror image.
const FAR_AWAY: Car = Car {
    cell: -10_000,
    speed: 0,
};

impl Mind for SimulatedDriver {
    fn reset(&mut self, seed: u64, episode: u32) {
        self.reseed(seed, episode, 0);
        self.lane = 0;
        self.known = [None; CARS];
    }

    fn reseed(&mut self, seed: u64, episode: u32, stream: u64) {
        self.chance.reseed(seed, episode, stream);
    }

    fn sight(&self) -> &Sight {
        &self.sight
    }

    fn look(&mut self, visual: &[f32]) -> Mask {
        self.sight.perceives(visual, &mut self.chance.eyes)
    }

    fn perceive(&mut self, visual: &[f32], verbal: &[f32], perceived: Mask) {
        self.lane = usize::from(visual[0] > 0.0);
        let Limits::Thresholds(limits) = self.sight.limits else {
            unreachable!("drivers see by thresholds")
        };
        for slot in 0..CARS {
            let told = perceived.hears(slot);
            if perceived.sees(slot) || told {
                let (position, speed) = if told {
                    (verbal[2 * slot], Some(verbal[2 * slot + 1].round() as i32))
                } else {
                    (visual[1 + slot], None)
                };
                let cell = (position * RANGE_CELLS).round();
                let cell = cell.clamp(FAR_AWAY.cell as f32, -FAR_AWAY.cell as f32) as i32;
                // Who saw it a step ago sees how it moves; who sees it for the first time takes it to keep its distance.
                let moved = self.known[slot].map_or(0, |known| {
                    let before = known.car.cell - known.car.speed;
                    let moved = if known.fresh {
                        cell - before
                    } else {
                        known.car.speed
                    };
                    moved.clamp(-1, 1)
                });
                self.known[slot] = Some(Known {
                    car: Car {
                        cell,
                        speed: speed.unwrap_or(moved).clamp(-1, 1),
                    },
                    fresh: true,
                });
            } else if let Some(known) = &mut self.known[slot] {
                known.fresh = false;
                // It should be in sight and is not: they no longer know where it is.
                let mut there = [0.0; super::VISUAL];
                there[1 + slot] = known.car.cell as f32 / RANGE_CELLS;
                if visible(&limits, &there) >> slot & 1 == 1 {
                    self.known[slot] = None;
                }
            }
        }
    }

    fn probabilities(&mut self, out: &mut [f32]) {
        let best = self.plan();
        // The learned reward is in units of the maximum-entropy driver's noise: its temperature is 1.
        let switch = 1.0 / (1.0 + (best[STAY] - best[SWITCH]).exp());
        out[SWITCH] = (1.0 - self.slip) * switch + self.slip / 2.0;
        out[STAY] = 1.0 - out[SWITCH];
    }

    fn act(&mut self) -> usize {
        let mut probabilities = [0.0; 2];
        self.probabilities(&mut probabilities);
        let action = draw(&probabilities, &mut self.chance.acts);
        self.acted(action);
        action
    }

    fn acted(&mut self, action: usize) {
        if action == SWITCH {
            self.lane = 1 - self.lane;
        }
        for known in self.known.iter_mut().flatten() {
            known.car.cell += known.car.speed;
        }
    }

    fn memory_len(&self) -> usize {
        1 + 4 * CARS
    }

    fn write_memory(&self, out: &mut [f32]) {
        let (lane, cars) = out.split_at_mut(1);
        lane[0] = self.lane as f32;
        for (out, known) in cars.chunks_exact_mut(4).zip(&self.known) {
            let numbers = known.map_or([0.0; 4], |known| {
                let fresh = f32::from(u8::from(known.fresh));
                [1.0, known.car.cell as f32, known.car.speed as f32, fresh]
            });
            out.copy_from_slice(&numbers);
        }
    }

    fn read_memory(&mut self, memory: &[f32]) {
        let (lane, cars) = memory.split_at(1);
        self.lane = usize::from(lane[0] > 0.5);
        for (known, numbers) in self.known.iter_mut().zip(cars.chunks_exact(4)) {
            *known = (numbers[0] > 0.5).then(|| Known {
                car: Car {
                    cell: numbers[1] as i32,
                    speed: numbers[2] as i32,
                },
                fresh: numbers[3] > 0.5,
            });
        }
    }
}
