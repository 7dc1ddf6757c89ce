//! What a model observes: two modalities, visual and verbal, with a mask beside each (paper §III-A, "masking"). What their
//! numbers mean is the domain's [`Layout`].

use domains::{Layout, Mask};
use nn::Tensor;

/// Sizes of the modalities, of their masks and of an action.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shape {
    /// Features of the visual modality.
    pub visual: usize,
    /// Entries of its mask.
    pub visual_mask: usize,
    /// Features of the verbal modality.
    pub verbal: usize,
    /// Entries of its mask.
    pub verbal_mask: usize,
    /// Numbers of an action.
    pub action: usize,
}

impl Shape {
    /// A domain's.
    pub fn of(layout: &Layout) -> Self {
        Self {
            visual: layout.visual,
            visual_mask: layout.regions,
            verbal: layout.verbal,
            verbal_mask: layout.utterances,
            action: layout.actions.rows(),
        }
    }

    /// Rows of an encoded observation.
    pub const fn encoded(&self) -> usize {
        self.visual + self.visual_mask + self.verbal + self.verbal_mask
    }
}

/// Which items are communicated to one person, at most 16 visual and 8 verbal: visual in bits 0–7 and 16–23, verbal in
/// bits 8–15.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Communicated(pub u32);

impl Communicated {
    /// From a bit per item for each modality.
    pub const fn new(visual: u32, verbal: u32) -> Self {
        Self((visual & 0xff) | ((verbal & 0xff) << 8) | ((visual & 0xff00) << 8))
    }

    /// From a set whose regions are items: a gridworld's, or what can be communicated.
    pub const fn items(mask: Mask) -> Self {
        Self::new(mask.visual as u32, mask.verbal)
    }

    /// As a set whose regions are items.
    pub const fn mask(self) -> Mask {
        Mask {
            visual: self.visual_bits() as u64,
            verbal: self.verbal_bits(),
        }
    }

    /// Whether visual item `s` (on the highway: a sector) is shown.
    pub const fn visual(self, s: usize) -> bool {
        self.visual_bits() >> s & 1 == 1
    }

    /// Whether verbal item `s` (on the highway: a sector) is spoken about.
    pub const fn verbal(self, s: usize) -> bool {
        self.0 >> (8 + s) & 1 == 1
    }

    /// The visual bits.
    pub const fn visual_bits(self) -> u32 {
        (self.0 & 0xff) | (self.0 >> 8 & 0xff00)
    }

    /// The verbal bits.
    pub const fn verbal_bits(self) -> u32 {
        self.0 >> 8 & 0xff
    }

    /// The visual and the verbal bits.
    pub const fn bits(self) -> (u32, u32) {
        (self.visual_bits(), self.verbal_bits())
    }
}

/// A batch of observations before anybody's perception: `features × batch`.
#[derive(Clone, Debug)]
pub struct Observations {
    /// Visual modality.
    pub visual: Tensor,
    /// Verbal modality.
    pub verbal: Tensor,
}

impl Observations {
    /// Zeros for `batch` observations.
    pub fn new(shape: &Shape, batch: usize) -> Self {
        Self {
            visual: Tensor::new(shape.visual, batch),
            verbal: Tensor::new(shape.verbal, batch),
        }
    }

    /// Number of observations.
    pub fn batch(&self) -> usize {
        self.visual.cols()
    }

    /// Changes the number of observations, keeping memory.
    pub fn resize(&mut self, batch: usize) {
        let (visual, verbal) = (self.visual.rows(), self.verbal.rows());
        self.visual.resize_to(visual, batch);
        self.verbal.resize_to(verbal, batch);
    }
}
