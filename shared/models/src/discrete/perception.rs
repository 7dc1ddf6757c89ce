//! What a person perceives by themselves, as a function of the few numbers that a perceptual implant learns (paper, appendix,
//! "Perceptual Implants"): every region has a *distance* and a *limit*, and is seen where the distance does not exceed the
//! limit.
//!
//! Driving: cells to the car, and one of four limits by its lane and whether it is ahead. Search and rescue: cells to the middle
//! of the portion, and one limit. Bomb defusal: a number drawn from U(0, 1), and the probability of noticing the terminal.

use domains::discrete::{Domain, Layout, Perception, Sight};
use domains::{bomb_defusal, driving, search_rescue};

/// A domain's distances.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Perceiver {
    domain: Domain,
    regions: usize,
}

/// The limits of a person's true sight, in the order of [`Perceiver::distance`]'s.
pub fn limits_of(perception: &Perception) -> Vec<f32> {
    match perception {
        Perception::Thresholds(cells) => cells.to_vec(),
        Perception::Radius(cells) => vec![*cells],
        Perception::Probabilities(p) => p.to_vec(),
    }
}

/// Most regions that a domain has.
pub const MAX_REGIONS: usize = 16;

impl Perceiver {
    /// The perception of a domain's people.
    pub fn new(layout: &Layout) -> Self {
        debug_assert!(layout.regions <= MAX_REGIONS);
        Self {
            domain: layout.domain,
            regions: layout.regions,
        }
    }

    /// Limits that people have.
    pub fn limits(&self) -> usize {
        match self.domain {
            Domain::Driving => 4,
            Domain::SearchRescue => 1,
            Domain::BombDefusal => bomb_defusal::TERMINALS,
        }
    }

    /// Visual regions.
    pub fn regions(&self) -> usize {
        self.regions
    }

    /// The sight of a person with these limits; none if their number is not [`Self::limits`].
    pub fn sight(&self, limits: &[f32], heard: u32) -> Option<Sight> {
        let perception = match self.domain {
            Domain::Driving => Perception::Thresholds(limits.try_into().ok()?),
            Domain::SearchRescue => match limits {
                [cells] => Perception::Radius(*cells),
                _ => return None,
            },
            Domain::BombDefusal => Perception::Probabilities(limits.try_into().ok()?),
        };
        Some(Sight { perception, heard })
    }

    /// The largest limit: beyond it nothing is left to be seen.
    pub fn largest(&self) -> f32 {
        match self.domain {
            Domain::Driving => driving::RANGE_CELLS + 1.0,
            // The house's diagonal.
            Domain::SearchRescue => 11.0,
            Domain::BombDefusal => 1.0,
        }
    }

    /// How softly gradients pass the limit, in its units: about what lies between two cases.
    pub fn width(&self) -> f32 {
        match self.domain {
            Domain::Driving | Domain::SearchRescue => 1.0,
            Domain::BombDefusal => 0.1,
        }
    }

    /// Standard normals that a person's perception takes in a step.
    pub fn noise_rows(&self) -> usize {
        match self.domain {
            Domain::Driving | Domain::SearchRescue => 0,
            Domain::BombDefusal => 2 * self.regions,
        }
    }

    /// Distance of a region of one person's whole visual modality, and which limit it has. `noise`: `noise_rows` standard
    /// normals; where chance decides and there are none, what is likelier than not happens.
    pub fn distance(&self, region: usize, visual: &[f32], noise: Option<&[f32]>) -> (f32, usize) {
        match self.domain {
            Domain::Driving => {
                let cell = visual[1 + region] * driving::RANGE_CELLS;
                // The domain's own tolerance of half a cell.
                let behind = usize::from(cell < -0.5);
                (cell.abs() - 0.5, driving::lane_of(region) + 2 * behind)
            }
            Domain::SearchRescue => {
                let at = |i: usize| visual[search_rescue::IMAGE + i] * 4.0 + 4.0;
                let centre = search_rescue::centre_of(region);
                let (down, right) = (at(0) - centre.row() as f32, at(1) - centre.column() as f32);
                (down.hypot(right), 0)
            }
            Domain::BombDefusal => {
                let uniform = noise.map_or(0.5, |noise| {
                    // exp(−(a² + b²)/2) of two independent standard normals is uniform on (0, 1].
                    let (a, b) = (noise[2 * region], noise[2 * region + 1]);
                    (-0.5 * (a * a + b * b)).exp()
                });
                (uniform, region)
            }
        }
    }

    /// The regions that are seen, a bit each.
    pub fn seen(&self, limits: &[f32], visual: &[f32], noise: Option<&[f32]>) -> u32 {
        (0..self.regions).fold(0, |bits, region| {
            let (distance, limit) = self.distance(region, visual, noise);
            bits | u32::from(distance <= limits[limit]) << region
        })
    }
}
