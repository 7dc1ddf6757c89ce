//! How a masked observation looks to the networks: masked values with their masks beside them.

use domains::{Layout, Mask};

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

    /// Writes an observation as it looks through a mask. What is hidden leaves nothing, even of what is not finite.
    pub fn write(&self, visual: &[f32], verbal: &[f32], mask: Mask, out: &mut [f32]) {
        let (shown, rest) = out.split_at_mut(self.region.len());
        let (visual_mask, rest) = rest.split_at_mut(self.regions);
        let (heard, verbal_mask) = rest.split_at_mut(self.utterance.len());
        for (region, out) in visual_mask.iter_mut().enumerate() {
            *out = f32::from(u8::from(mask.sees(region)));
        }
        for (utterance, out) in verbal_mask.iter_mut().enumerate() {
            *out = f32::from(u8::from(mask.hears(utterance)));
        }
        for ((out, x), region) in shown.iter_mut().zip(visual).zip(&self.region) {
            // What no region governs is always seen.
            let seen = visual_mask.get(*region as usize).is_none_or(|m| *m != 0.0);
            *out = if seen { *x } else { 0.0 };
        }
        for ((out, x), utterance) in heard.iter_mut().zip(verbal).zip(&self.utterance) {
            let said = verbal_mask[*utterance as usize] != 0.0;
            *out = if said { *x } else { 0.0 };
        }
    }
}
