//! How defusers perceive: a number drawn from U(0, 1), and the probability of noticing the terminal.

use super::TERMINALS;
use crate::Perception;

/// See the module.
#[derive(Debug)]
pub(super) struct ChanceOfNoticing;

impl Perception for ChanceOfNoticing {
    fn regions(&self) -> usize {
        TERMINALS
    }

    fn limits(&self) -> usize {
        TERMINALS
    }

    fn largest(&self) -> f32 {
        1.0
    }

    fn noise_rows(&self) -> usize {
        2 * TERMINALS
    }

    fn distance(&self, region: usize, _: &[f32], noise: Option<&[f32]>) -> (f32, usize) {
        let uniform = noise.map_or(0.5, |noise| {
            // exp(−(a² + b²)/2) of two independent standard normals is uniform on (0, 1].
            let (a, b) = (noise[2 * region], noise[2 * region + 1]);
            (-0.5 * (a * a + b * b)).exp()
        });
        (uniform, region)
    }
}
