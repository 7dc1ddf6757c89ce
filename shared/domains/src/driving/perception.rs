//! How drivers perceive: cells to a car, and one of four limits by its lane and whether it is ahead.

use super::{CARS, RANGE_CELLS, lane_of};
use crate::Perception;

/// See the module.
#[derive(Debug)]
pub(super) struct CellsToCars;

impl Perception for CellsToCars {
    fn regions(&self) -> usize {
        CARS
    }

    /// Ahead left, ahead right, behind left, behind right.
    fn limits(&self) -> usize {
        4
    }

    /// Ahead and behind.
    fn controls(&self) -> usize {
        2
    }

    fn limits_of(&self, controls: &[f32]) -> Vec<f32> {
        vec![controls[0], controls[0], controls[1], controls[1]]
    }

    fn largest(&self) -> f32 {
        RANGE_CELLS + 1.0
    }

    fn distance(&self, region: usize, visual: &[f32], _: Option<&[f32]>) -> (f32, usize) {
        let cell = visual[1 + region] * RANGE_CELLS;
        // The domain's own tolerance of half a cell.
        let behind = usize::from(cell < -0.5);
        (cell.abs() - 0.5, lane_of(region) + 2 * behind)
    }
}
