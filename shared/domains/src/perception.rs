//! What a person perceives by themselves, as a function of the few numbers that a perceptual implant learns (paper, appendix,
//! "Perceptual Implants"): every region of the visual modality has a *distance* and a *limit*, and is seen where the distance
//! does not exceed the limit.
//!
//! Each domain says in its own folder what its distances are; models, implants and learning know no more than this trait.

use core::fmt::Debug;

/// A domain's distances and limits.
pub trait Perception: Debug + Send + Sync {
    /// Visual regions.
    fn regions(&self) -> usize;

    /// Limits that a person has, at least one.
    fn limits(&self) -> usize;

    /// Numbers that a person's limits are taken to follow from, each from 0 to [`Self::largest`]: how far people see changes little
    /// from one region to the next, and a few rounds tell nothing of most regions.
    fn controls(&self) -> usize {
        1
    }

    /// The limits that follow from `controls`; where there is one, all are alike.
    fn limits_of(&self, controls: &[f32]) -> Vec<f32> {
        vec![controls[0]; self.limits()]
    }

    /// The largest limit, in the distance's unit: beyond it nothing is left to be seen.
    fn largest(&self) -> f32;

    /// Standard normals that a person's perception takes in a step, where it is a matter of chance.
    fn noise_rows(&self) -> usize {
        0
    }

    /// Distance of a region of one person's whole visual modality, and which limit it has. `noise`: [`Self::noise_rows`]
    /// standard normals; where chance decides and there are none, what is likelier than not happens.
    fn distance(&self, region: usize, visual: &[f32], noise: Option<&[f32]>) -> (f32, usize);

    /// The regions that are seen under `limits`, a bit each.
    fn seen(&self, limits: &[f32], visual: &[f32], noise: Option<&[f32]>) -> u64 {
        (0..self.regions()).fold(0, |bits, region| {
            let (distance, limit) = self.distance(region, visual, noise);
            bits | u64::from(distance <= limits[limit]) << region
        })
    }

    /// The regions that a display shows when it is asked to show `items` (a bit each), and this is what there is to show. Where
    /// items and regions are the same, all of them.
    fn shown(&self, items: u32, _visual: &[f32]) -> u64 {
        u64::from(items)
    }
}
