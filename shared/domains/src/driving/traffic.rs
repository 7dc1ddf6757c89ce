//! How the other cars move, what a step is worth, and the best action for somebody who sees them all.

use super::{CARS, Reward, STAY, SWITCH, lane_of};
use crate::discrete::MAX_TERMS;

/// Steps that [`best_action`] looks ahead.
const LOOK_AHEAD: usize = 12;
/// Discount of [`best_action`].
const DISCOUNT: f32 = 0.95;

/// Another car, relative to the ego car.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Car {
    /// Cells ahead; negative behind.
    pub cell: i32,
    /// Cells that it gains (positive) or loses in the next step.
    pub speed: i32,
}

/// Moves the cars by a step. None drives through another of its lane: the one behind keeps a cell's distance.
pub fn advance(cars: &mut [Car; CARS]) {
    for lane in 0..2 {
        let (a, b) = (lane, lane + 2);
        let (leader, follower) = if cars[a].cell >= cars[b].cell {
            (a, b)
        } else {
            (b, a)
        };
        cars[leader].cell += cars[leader].speed;
        let limit = cars[leader].cell - 1;
        cars[follower].cell = (cars[follower].cell + cars[follower].speed).min(limit);
    }
}

/// Reward by term (proximity, collision, change) of an action in lane `lane`, and whether it ends in a collision. `before` and
/// `after` are the cars before and after the step. Switching into a car alongside is a collision as well.
pub fn reward_terms(
    reward: &Reward,
    lane: usize,
    action: usize,
    before: &[Car; CARS],
    after: &[Car; CARS],
) -> ([f32; MAX_TERMS], bool) {
    let switched = action == SWITCH;
    let lane = if switched { 1 - lane } else { lane };
    let mut near = false;
    let mut collided = false;
    for slot in (0..CARS).filter(|slot| lane_of(*slot) == lane) {
        near |= after[slot].cell.abs() <= reward.near_cells as i32;
        collided |= after[slot].cell == 0 || (switched && before[slot].cell == 0);
    }
    let penalty = |on: bool, size: f64| if on { -size as f32 } else { 0.0 };
    let terms = [
        penalty(near, reward.proximity),
        penalty(collided, reward.collision),
        penalty(switched, reward.change),
        0.0,
    ];
    (terms, collided)
}

/// The best action for somebody who knows every car's position and speed and expects the speeds to last: dynamic programming
/// over lane and time.
pub fn best_action(reward: &Reward, lane: usize, cars: &[Car; CARS]) -> usize {
    let mut future = [*cars; LOOK_AHEAD + 1];
    for t in 0..LOOK_AHEAD {
        let mut next = future[t];
        advance(&mut next);
        future[t + 1] = next;
    }
    let mut value = [0.0f32; 2];
    let mut first = STAY;
    for t in (0..LOOK_AHEAD).rev() {
        let mut here = [0.0; 2];
        for from in 0..2 {
            let worth = |action: usize| {
                let (terms, collided) =
                    reward_terms(reward, from, action, &future[t], &future[t + 1]);
                let to = if action == SWITCH { 1 - from } else { from };
                let rest = if collided { 0.0 } else { value[to] };
                terms.iter().sum::<f32>() + DISCOUNT * rest
            };
            let (stay, switch) = (worth(STAY), worth(SWITCH));
            here[from] = stay.max(switch);
            if t == 0 && from == lane {
                first = if switch > stay { SWITCH } else { STAY };
            }
        }
        value = here;
    }
    first
}
