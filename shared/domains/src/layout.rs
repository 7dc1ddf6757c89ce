//! What a world's numbers mean: sizes of the modalities, which numbers a visual region or an utterance governs, what can be
//! communicated and what that costs (paper, Table "Communication Modalities and Costs").

use crate::{Mask, Perception};

/// An image's shape; its numbers lie channel after channel, row after row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Image {
    /// Colours.
    pub channels: usize,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Kernel and stride of the convolution that the paper gives this image's encoder.
    pub kernel: usize,
    /// See `kernel`.
    pub stride: usize,
}

impl Image {
    /// Numbers of the image.
    pub fn len(&self) -> usize {
        self.channels * self.height * self.width
    }

    /// Whether it has none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Rows and columns that the convolution gives (no padding). Every pixel is covered: (size − kernel) is a multiple of stride.
    pub fn convolved(&self) -> (usize, usize) {
        let out = |size: usize| (size - self.kernel) / self.stride + 1;
        (out(self.height), out(self.width))
    }
}

/// What an action is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActionSpace {
    /// So many numbers, each in [−1, 1].
    Continuous(usize),
    /// One of so many choices; as numbers, zeros with a one.
    Discrete(usize),
}

impl ActionSpace {
    /// Numbers of an action.
    pub const fn rows(self) -> usize {
        match self {
            Self::Continuous(n) | Self::Discrete(n) => n,
        }
    }
}

/// Costs of communicating at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuadraticCosts {
    /// Showing n regions at once costs this times n².
    pub visual: f32,
    /// Saying n utterances at once costs this times n².
    pub verbal: f32,
}

/// The meaning of a world's numbers. It owns the small tables, so that it can be cloned into models.
#[derive(Clone, Debug)]
pub struct Layout {
    /// The domain's name in scene files, model files and on the command line.
    pub domain: &'static str,
    /// The domain's number in messages: 0 is the highway.
    pub number: u32,
    /// Numbers of the visual modality. If there is an image, it comes first.
    pub visual: usize,
    /// Numbers of the verbal modality.
    pub verbal: usize,
    /// What people do.
    pub actions: ActionSpace,
    /// Shape of the image at the head of the visual modality, if it has one.
    pub image: Option<Image>,
    /// For each visual number, the region that governs whether it is seen; `None`: always seen (one's own lane, position, stage).
    pub visual_region: Vec<Option<u8>>,
    /// For each verbal number, the utterance that it belongs to.
    pub verbal_utterance: Vec<u8>,
    /// For each utterance, the regions in which what it tells of would be seen, a bit each; 0 where it cannot be seen.
    pub told_regions: Vec<u64>,
    /// Visual regions that can be hidden.
    pub regions: usize,
    /// Utterances.
    pub utterances: usize,
    /// How people perceive the regions by themselves.
    pub perception: &'static dyn Perception,
    /// What the robot itself senses.
    pub sensed: Mask,
    /// Utterances that people hear without an assistant, a bit each.
    pub heard: u32,
    /// What can be communicated: the display cannot show every region.
    pub communicable: Mask,
    /// What communicating costs, where that depends on the number of items alone; none on the highway, where the planner's
    /// settings say it.
    pub costs: Option<QuadraticCosts>,
    /// What the actions are called.
    pub action_names: &'static [&'static str],
    /// What the visual regions are called.
    pub region_names: &'static [&'static str],
    /// What the utterances are about.
    pub utterance_names: &'static [&'static str],
    /// The reward's terms.
    pub terms: &'static [&'static str],
    /// What a success is, in words.
    pub success: &'static str,
    /// What happened when something was hit, in words.
    pub accident: &'static str,
}

impl Layout {
    /// Everything that can be hidden.
    pub fn everything(&self) -> Mask {
        Mask {
            visual: u64::MAX.checked_shr(64 - self.regions as u32).unwrap_or(0),
            verbal: ((1u64 << self.utterances) - 1) as u32,
        }
    }

    /// What somebody perceives to whom `items` are communicated, and who sees `seen` by themselves and hears `heard`
    /// (steps 5 and 6 of forward imagination).
    pub fn overlay(&self, seen: u64, heard: u32, items: (u32, u32), visual: &[f32]) -> Mask {
        let (shown, said) = items;
        let shown = match shown {
            0 => 0,
            shown => self.perception.shown(shown, visual),
        };
        Mask {
            visual: seen | shown,
            verbal: heard | said,
        }
    }

    /// Cost of communicating a set in one step: visual · n² + verbal · m²; 0 without [`Self::costs`].
    pub fn cost(&self, communicated: Mask) -> f32 {
        let (shown, said) = communicated.count();
        self.costs.map_or(0.0, |costs| {
            costs.visual * (shown * shown) as f32 + costs.verbal * (said * said) as f32
        })
    }

    /// Whether a visual number is seen under a mask.
    pub fn is_seen(&self, number: usize, mask: Mask) -> bool {
        self.visual_region[number].is_none_or(|region| mask.sees(region as usize))
    }

    /// Sets to 0 what a mask hides.
    ///
    /// # Panics
    /// If a slice is longer than the modality.
    pub fn hide(&self, mask: Mask, visual: &mut [f32], verbal: &mut [f32]) {
        for (number, value) in visual.iter_mut().enumerate() {
            if !self.is_seen(number, mask) {
                *value = 0.0;
            }
        }
        for (number, value) in verbal.iter_mut().enumerate() {
            if !mask.hears(self.verbal_utterance[number] as usize) {
                *value = 0.0;
            }
        }
    }
}
