//! What drivers weigh (paper, Experiments, "Simulated Humans"): the distance to the road's centre, the distances to the other
//! cars, and the action.

use super::{CARS, SWITCH, lane_of};

/// Features of a step.
pub const FEATURES: usize = 2 + CARS;
/// What they are called, in their order.
pub const FEATURE_NAMES: [&str; FEATURES] = [
    "offset",
    "front_left",
    "front_right",
    "rear_left",
    "rear_right",
    "change",
];
/// How quickly a car's weight falls with distance, in cells.
const REACH_CELLS: f32 = 1.5;
/// How far apart lanes count, in cells.
const LANE_CELLS: f32 = 3.0;

/// Features of a step that ends in lane `lane` after `action`, with the cars then at `cells` ahead (`None`: not known, which weighs
/// nothing): offset from the road's centre in lanes, right positive; each car's closeness exp(−d² / 2·1.5²) with d the distance
/// in cells and a lane counting 3; 1 for a lane change.
pub fn features(lane: usize, action: usize, cells: &[Option<f32>; CARS]) -> [f32; FEATURES] {
    let mut out = [0.0; FEATURES];
    out[0] = lane as f32 - 0.5;
    for slot in 0..CARS {
        if let Some(cell) = cells[slot] {
            let aside = if lane_of(slot) == lane {
                0.0
            } else {
                LANE_CELLS
            };
            let squared = cell * cell + aside * aside;
            out[1 + slot] = (-squared / (2.0 * REACH_CELLS * REACH_CELLS)).exp();
        }
    }
    out[1 + CARS] = if action == SWITCH { 1.0 } else { 0.0 };
    out
}
