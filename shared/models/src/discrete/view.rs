//! How a masked observation looks to the networks: masked values with their masks beside them, as on the highway.

use crate::Communicated;
use domains::discrete::{Layout, Mask};
use nn::{Tape, Tensor, Var};

/// Rows of an encoded observation: visual · mask, a number per region, verbal · mask, a number per utterance.
#[derive(Clone, Debug)]
pub struct View {
    /// For each visual number its region; one past the last for what is always seen.
    region: Vec<u32>,
    /// For each verbal number its utterance.
    utterance: Vec<u32>,
    regions: usize,
    utterances: usize,
}

impl View {
    /// The view of a domain.
    pub fn new(layout: &Layout) -> Self {
        let always = layout.regions as u32;
        Self {
            region: layout
                .visual_region
                .iter()
                .map(|region| region.map_or(always, u32::from))
                .collect(),
            utterance: layout.verbal_utterance.iter().map(|&u| u.into()).collect(),
            regions: layout.regions,
            utterances: layout.utterances,
        }
    }

    /// Rows of an encoded observation.
    pub fn rows(&self) -> usize {
        self.region.len() + self.regions + self.utterance.len() + self.utterances
    }

    /// Visual regions.
    pub fn regions(&self) -> usize {
        self.regions
    }

    /// Writes an observation as it looks through a mask.
    pub fn write(&self, visual: &[f32], verbal: &[f32], mask: Mask, out: &mut [f32]) {
        let seen = |region: u32| region as usize == self.regions || mask.sees(region as usize);
        let (shown, rest) = out.split_at_mut(self.region.len());
        for ((out, x), region) in shown.iter_mut().zip(visual).zip(&self.region) {
            *out = if seen(*region) { *x } else { 0.0 };
        }
        let (visual_mask, rest) = rest.split_at_mut(self.regions);
        let (heard, verbal_mask) = rest.split_at_mut(self.utterance.len());
        for ((out, x), utterance) in heard.iter_mut().zip(verbal).zip(&self.utterance) {
            *out = if mask.hears(*utterance as usize) {
                *x
            } else {
                0.0
            };
        }
        for (region, out) in visual_mask.iter_mut().enumerate() {
            *out = f32::from(u8::from(mask.sees(region)));
        }
        for (utterance, out) in verbal_mask.iter_mut().enumerate() {
            *out = f32::from(u8::from(mask.hears(utterance)));
        }
    }

    /// As [`View::write`], for a batch on a tape and differentiable in what is seen. `seen`: regions × batch of 0 or 1;
    /// `heard`: the utterances that everybody hears.
    pub fn on_tape(
        &self,
        tape: &mut Tape,
        visual: &Tensor,
        verbal: &Tensor,
        seen: Var,
        heard: u32,
    ) -> Var {
        let batch = visual.cols();
        let always = tape.constant(1, batch, 1.0);
        let mask = tape.concat(&[seen, always]);
        let mask = tape.gather_rows(mask, &self.region);
        let visual = tape.input(visual);
        let shown = tape.mul(visual, mask);
        let hears = |utterance: u32| heard >> utterance & 1 == 1;
        let spoken = tape.input_with(self.utterance.len(), batch, |out| {
            for (out, x) in out
                .chunks_exact_mut(self.utterance.len().max(1))
                .zip(verbal.data().chunks_exact(self.utterance.len().max(1)))
            {
                for ((out, x), utterance) in out.iter_mut().zip(x).zip(&self.utterance) {
                    *out = if hears(*utterance) { *x } else { 0.0 };
                }
            }
        });
        let verbal_mask = tape.input_with(self.utterances, batch, |out| {
            for out in out.chunks_exact_mut(self.utterances.max(1)) {
                for (utterance, out) in out.iter_mut().enumerate() {
                    *out = f32::from(u8::from(hears(utterance as u32)));
                }
            }
        });
        tape.concat(&[shown, seen, spoken, verbal_mask])
    }
}

/// What is communicated as a set of regions and utterances.
fn mask_of(communicated: Communicated) -> Mask {
    Mask {
        visual: communicated.visual_bits(),
        verbal: communicated.verbal_bits(),
    }
}

impl From<Mask> for Communicated {
    fn from(mask: Mask) -> Self {
        Self::new(mask.visual, mask.verbal)
    }
}

impl From<Communicated> for Mask {
    fn from(communicated: Communicated) -> Self {
        mask_of(communicated)
    }
}
