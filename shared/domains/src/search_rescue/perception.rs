//! How searchers perceive: cells to the middle of a portion of the map, and one limit.

use super::{IMAGE, PORTIONS, centre_of};
use crate::Perception;

/// See the module.
#[derive(Debug)]
pub(super) struct CellsToPortions;

impl Perception for CellsToPortions {
    fn regions(&self) -> usize {
        PORTIONS
    }

    fn limits(&self) -> usize {
        1
    }

    /// The house's diagonal.
    fn largest(&self) -> f32 {
        11.0
    }

    fn distance(&self, region: usize, visual: &[f32], _: Option<&[f32]>) -> (f32, usize) {
        let at = |i: usize| visual[IMAGE + i] * 4.0 + 4.0;
        let centre = centre_of(region);
        let (down, right) = (at(0) - centre.row() as f32, at(1) - centre.column() as f32);
        (down.hypot(right), 0)
    }
}
