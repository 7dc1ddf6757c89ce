//! The road, its cars and the ego car.

use std::fmt::Write as _;
use std::sync::Arc;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{CARS, Car, RANGE_CELLS, SWITCH, Scene, advance, best_action, reward_terms};
use crate::Layout;
use crate::discrete::{Discrete, End, Outcome, Setting, random};

/// Stream of random numbers of the traffic.
const STREAM: u64 = 0x6472_6976;

/// The world of gridworld driving.
#[derive(Clone, Debug)]
pub struct World {
    scene: Arc<Scene>,
    layout: Arc<Layout>,
    random: ChaCha8Rng,
    scenario: u32,
    onset: u32,
    lane: usize,
    cars: [Car; CARS],
    steps: u32,
    end: End,
}

impl World {
    /// Scenarios: which car becomes dangerous × the ego car's first lane.
    pub const SCENARIOS: u32 = 8;

    /// A scene's world at scenario 0.
    pub fn new(scene: &Arc<Scene>) -> Self {
        let mut world = Self {
            layout: Arc::new(super::layout(scene)),
            scene: Arc::clone(scene),
            random: random(0, 0, STREAM),
            scenario: 0,
            onset: 0,
            lane: 0,
            cars: [Car::default(); CARS],
            steps: 0,
            end: End::Running,
        };
        world.reset(0, 0, 0);
        world
    }

    /// The ego car's lane: 0 left, 1 right.
    pub fn lane(&self) -> usize {
        self.lane
    }

    /// The other cars.
    pub fn cars(&self) -> &[Car; CARS] {
        &self.cars
    }

    /// The slot of the car that becomes dangerous.
    pub fn dangerous(&self) -> usize {
        (self.scenario % CARS as u32) as usize
    }

    /// Decides how fast everybody is in the next step.
    fn decide_speeds(&mut self) {
        let traffic = &self.scene.traffic;
        let dangerous = (self.scenario % CARS as u32) as usize;
        for slot in 0..CARS {
            let side = if slot < 2 { 1 } else { -1 };
            // Drawn for every car in every step, so that one car's luck does not move another's.
            let changes = self.random.random::<f64>() < traffic.wander;
            let drawn = self.random.random_range(-1..=1);
            let car = &mut self.cars[slot];
            if slot == dangerous {
                car.speed = if self.steps >= self.onset { -side } else { 0 };
                continue;
            }
            if changes {
                car.speed = drawn;
            }
            // Only the dangerous car comes near.
            let distance = (car.cell + car.speed) * side;
            if distance < traffic.gap_cells as i32 || distance > RANGE_CELLS as i32 {
                car.speed = 0;
            }
        }
    }
}

impl Discrete for World {
    fn layout(&self) -> &Layout {
        &self.layout
    }

    fn scenarios(&self) -> u32 {
        Self::SCENARIOS
    }

    fn setting(&self) -> Setting {
        self.scene.setting
    }

    fn reset(&mut self, seed: u64, episode: u32, scenario: u32) {
        self.random = random(seed, episode, STREAM);
        self.scenario = scenario % Self::SCENARIOS;
        self.lane = (self.scenario / CARS as u32) as usize;
        self.steps = 0;
        self.end = End::Running;
        let traffic = &self.scene.traffic;
        let (near, far) = (traffic.nearest_cells as i32, traffic.farthest_cells as i32);
        for slot in 0..CARS {
            let distance = self.random.random_range(near..=far);
            let cell = if slot < 2 { distance } else { -distance };
            self.cars[slot] = Car { cell, speed: 0 };
        }
        self.onset = self.random.random_range(0..=traffic.latest_onset);
        self.decide_speeds();
    }

    fn step(&mut self, action: usize) -> Outcome {
        if !self.end.is_running() {
            return Outcome::new(Default::default(), false, self.end);
        }
        let action = if action == SWITCH {
            SWITCH
        } else {
            super::STAY
        };
        let before = self.cars;
        advance(&mut self.cars);
        let (terms, collided) =
            reward_terms(&self.scene.reward, self.lane, action, &before, &self.cars);
        if action == SWITCH {
            self.lane = 1 - self.lane;
        }
        self.steps += 1;
        if collided {
            self.end = End::Collision;
        } else if self.steps >= self.scene.episode.max_steps {
            self.end = End::Success;
        }
        self.decide_speeds();
        Outcome::new(terms, collided, self.end)
    }

    fn end(&self) -> End {
        self.end
    }

    fn steps(&self) -> u32 {
        self.steps
    }

    fn scenario(&self) -> u32 {
        self.scenario
    }

    fn observe(&self, visual: &mut [f32], verbal: &mut [f32]) {
        assert_eq!(visual.len(), super::VISUAL, "visual numbers");
        assert_eq!(verbal.len(), super::VERBAL, "verbal numbers");
        visual[0] = if self.lane == 0 { -1.0 } else { 1.0 };
        for (slot, car) in self.cars.iter().enumerate() {
            let position = (car.cell as f32 / RANGE_CELLS).clamp(-1.0, 1.0);
            visual[1 + slot] = position;
            verbal[2 * slot] = position;
            verbal[2 * slot + 1] = car.speed as f32;
        }
    }

    fn legal(&self, action: usize) -> bool {
        action < self.layout.actions.rows()
    }

    fn expert(&self) -> usize {
        // Only the dangerous car comes near: the others' wandering is nothing to plan for.
        let mut cars = self.cars;
        for slot in (0..CARS).filter(|slot| *slot != self.dangerous()) {
            cars[slot].speed = 0;
        }
        best_action(&self.scene.reward, self.lane, &cars)
    }

    fn render(&self, out: &mut String) {
        let range = RANGE_CELLS as i32;
        for lane in 0..2 {
            out.push_str(["left  |", "right |"][lane]);
            for cell in -range..=range {
                let slot = (lane..CARS)
                    .step_by(2)
                    .find(|slot| self.cars[*slot].cell == cell);
                out.push(match slot {
                    Some(_) if cell == 0 && lane == self.lane => 'X',
                    Some(slot) => match self.cars[slot].speed {
                        ..0 => '<',
                        0 => '=',
                        1.. => '>',
                    },
                    None if cell == 0 && lane == self.lane => 'E',
                    None => '.',
                });
            }
            out.push_str("|\n");
        }
        let _ = writeln!(
            out,
            "step {} scenario {} ({:?}): E ego, = keeps, < loses, > gains a cell a step",
            self.steps, self.scenario, self.end
        );
    }
}
