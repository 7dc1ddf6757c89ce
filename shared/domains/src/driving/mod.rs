//! Gridworld driving (paper, Experiments and Appendix): a car at constant speed on two lanes among four others, one of
//! which becomes dangerous.
//!
//! Car slots, visual regions and utterances have one order: front left, front right, rear left, rear right; a slot keeps its
//! name when its car passes the ego car. Visual: `[lane, 4 × position]`, lane −1 left or 1 right, position in cells ahead / 10
//! within [−1, 1]. Verbal: `4 × [position, speed]`, speed in cells a step relative to the ego car. Actions: 0 stay, 1 switch lane.

mod driver;
mod features;
mod perception;
mod person;
mod scene;
mod traffic;
mod world;

pub use driver::SimulatedDriver;
pub use features::{FEATURE_NAMES, FEATURES, features};
pub use person::{Person, Planning, Weights};
pub use scene::{Fog, Reward, Scene, Traffic};
pub use traffic::{Car, advance, best_action, reward_terms};
pub use world::World;

use crate::{ActionSpace, Layout, Mask, QuadraticCosts};

/// The domain's name.
pub const NAME: &str = "driving";

/// Cars other than the ego car.
pub const CARS: usize = 4;
/// Cells by which positions are normalised; what is farther looks as far as this.
pub const RANGE_CELLS: f32 = 10.0;
/// Numbers of the visual modality.
pub const VISUAL: usize = 1 + CARS;
/// Numbers of the verbal modality.
pub const VERBAL: usize = 2 * CARS;
/// Action: stay in the lane.
pub const STAY: usize = 0;
/// Action: switch to the other lane.
pub const SWITCH: usize = 1;

/// Lane of a car slot: 0 left, 1 right. The other cars never change lanes.
pub const fn lane_of(slot: usize) -> usize {
    slot % 2
}

/// Which cars are seen, a bit each: those within `cells` ahead (left lane, right lane) or behind (left, right). A car alongside
/// counts as ahead. `visual` is the whole modality, sensed or imagined.
pub fn visible(cells: &[f32; 4], visual: &[f32]) -> u64 {
    (0..CARS).fold(0, |bits, slot| {
        let cell = visual[1 + slot] * RANGE_CELLS;
        // Half a cell of tolerance: cells are whole numbers, and imagined ones only nearly so.
        let behind = cell < -0.5;
        let limit = cells[lane_of(slot) + 2 * usize::from(behind)];
        bits | u64::from(cell.abs() < limit + 0.5) << slot
    })
}

/// The layout of a scene.
pub(crate) fn layout(scene: &Scene) -> Layout {
    let mut visual_region = vec![None];
    visual_region.extend((0..CARS as u8).map(Some));
    Layout {
        domain: NAME,
        number: 1,
        visual: VISUAL,
        verbal: VERBAL,
        actions: ActionSpace::Discrete(2),
        image: None,
        visual_region,
        verbal_utterance: (0..VERBAL as u8).map(|i| i / 2).collect(),
        told_regions: (0..CARS).map(|slot| 1 << slot).collect(),
        regions: CARS,
        utterances: CARS,
        perception: &perception::CellsToCars,
        sensed: Mask {
            visual: (1 << CARS) - 1,
            verbal: (1 << CARS) - 1,
        },
        heard: 0,
        communicable: Mask {
            visual: 0b0011,
            verbal: 0b1111,
        },
        costs: Some(QuadraticCosts {
            visual: scene.communication.visual_cost as f32,
            verbal: scene.communication.verbal_cost as f32,
        }),
        action_names: &["stay", "switch"],
        region_names: &NAMES,
        utterance_names: &NAMES,
        terms: &["proximity", "collision", "change"],
        success: "the end of the road reached",
        accident: "hit another car",
    }
}

/// Names of the car slots.
pub const NAMES: [&str; CARS] = ["front left", "front right", "rear left", "rear right"];
