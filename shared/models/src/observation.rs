//! What a model observes: two modalities, visual and verbal, with a mask beside each (paper §III-A, "masking").
//!
//! The highway's visual modality is the LIDAR as *nearness*, 1 − range/40 m, so that 0 says "nothing there", and the
//! five ego values, scaled so that each varies by about as much as the others. One mask entry per azimuth covers its three height bands; ego values are never masked. The verbal
//! modality has one mask entry per sector.

use nn::Tensor;

/// LIDAR azimuths.
pub const AZIMUTHS: usize = 36;
/// Height bands.
pub const BANDS: usize = 3;
/// Ego values.
pub const EGO: usize = 5;
/// Sectors that can be communicated about.
pub const SECTORS: usize = 6;
/// Numbers per sector in the verbal modality: 19 of the utterance's embedding, and the range.
pub const PER_SECTOR: usize = 20;
/// Full range of the LIDAR in metres.
pub const RANGE_M: f32 = 40.0;
/// Nearness below which an imagined azimuth counts as empty: 2 m short of the LIDAR's range.
pub const EMPTY: f32 = 0.05;

/// Factors on the ego values (heading error/180°, speed, lane offset, road offset, heading change ahead/180°): 1 stands for
/// 3° and for half a unit of the others. Without them the ELBO would not notice a heading error of a few degrees, and a
/// policy that cannot see its own heading cannot keep a lane.
pub const EGO_SCALE: [f32; EGO] = [60.0, 2.0, 2.0, 2.0, 60.0];

/// Writes the visual modality of normalised ranges (`band · 36 + azimuth`, 1 for nothing) and ego values: 113 numbers.
pub fn write_visual(range: &[f32; AZIMUTHS * BANDS], ego: &[f32; EGO], visual: &mut [f32]) {
    for (nearness, range) in visual.iter_mut().zip(range) {
        *nearness = 1.0 - range;
    }
    for i in 0..EGO {
        visual[AZIMUTHS * BANDS + i] = ego[i] * EGO_SCALE[i];
    }
}

/// The inverse of [`write_visual`]: normalised ranges, then ego values.
pub fn read_visual(visual: &[f32], out: &mut [f32]) {
    for (range, nearness) in out.iter_mut().zip(&visual[..AZIMUTHS * BANDS]) {
        *range = 1.0 - nearness;
    }
    for i in 0..EGO {
        out[AZIMUTHS * BANDS + i] = visual[AZIMUTHS * BANDS + i] / EGO_SCALE[i];
    }
}

/// Sector of an azimuth (DESIGN §4): front 1, left-front 9, left-rear 8, rear 1, right-rear 8, right-front 9.
pub const fn sector_of(azimuth: usize) -> usize {
    match azimuth {
        0 => 0,
        1..=9 => 1,
        10..=17 => 2,
        18 => 3,
        19..=26 => 4,
        _ => 5,
    }
}

/// Whether a head-up display can show something at this azimuth: the front half only.
pub const fn on_display(azimuth: usize) -> bool {
    azimuth <= 9 || azimuth >= 27
}

/// The bit of the sector whose highlight shows an azimuth; none behind the display's edge.
const SHOWN_BY: [u32; AZIMUTHS] = {
    let mut bits = [0; AZIMUTHS];
    let mut azimuth = 0;
    while azimuth < AZIMUTHS {
        if on_display(azimuth) {
            bits[azimuth] = 1 << sector_of(azimuth);
        }
        azimuth += 1;
    }
    bits
};

/// Sizes of the modalities and of their masks.
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
    /// Dimensions of an action.
    pub action: usize,
}

impl Shape {
    /// The highway's: 113, 36, 120, 6, 2.
    pub const HIGHWAY: Self = Self {
        visual: AZIMUTHS * BANDS + EGO,
        visual_mask: AZIMUTHS,
        verbal: SECTORS * PER_SECTOR,
        verbal_mask: SECTORS,
        action: 2,
    };

    /// Rows of the encoder's input that come from the observation.
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
}

/// A batch of observations before anybody's perception: `features × batch`.
#[derive(Clone, Debug)]
pub struct Observations {
    /// Visual modality, `113 × batch`: nearness per band and azimuth, then the ego values.
    pub visual: Tensor,
    /// Verbal modality, `120 × batch`.
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

    /// Fills column `j`'s visual modality from normalised ranges (`band · 36 + azimuth`, 1 for nothing) and ego values.
    pub fn set_lidar(&mut self, j: usize, range: &[f32; AZIMUTHS * BANDS], ego: &[f32; EGO]) {
        write_visual(range, ego, self.visual.column_mut(j));
    }
}

/// Nearest return of an azimuth as nearness, over the height bands of one visual column.
pub fn nearest(visual: &[f32], azimuth: usize) -> f32 {
    let mut nearest = visual[azimuth];
    for band in 1..BANDS {
        nearest = nearest.max(visual[band * AZIMUTHS + azimuth]);
    }
    nearest
}

/// [`nearest`] of every azimuth.
pub fn nearest_of_all(visual: &[f32]) -> [f32; AZIMUTHS] {
    let (bands, _) = visual.as_chunks::<AZIMUTHS>();
    let mut nearest = bands[0];
    for band in &bands[1..BANDS] {
        for (nearest, other) in nearest.iter_mut().zip(band) {
            *nearest = nearest.max(*other);
        }
    }
    nearest
}

/// The encoder's view of an observation: masked values with their masks beside them.
#[derive(Clone, Debug)]
pub struct Encoded {
    /// `encoded × batch`: visual · mask, visual mask, verbal · mask, verbal mask.
    pub rows: Tensor,
    shape: Shape,
}

impl Encoded {
    /// Room for `batch` observations.
    pub fn new(shape: Shape, batch: usize) -> Self {
        Self {
            rows: Tensor::new(shape.encoded(), batch),
            shape,
        }
    }

    /// Changes the number of observations, keeping memory.
    pub fn resize(&mut self, batch: usize) {
        let rows = self.rows.rows();
        self.rows.resize_to(rows, batch);
    }

    /// Writes column `j`: `x` as seen through the masks. `visual_mask`: a weight in [0, 1] per azimuth; `verbal_mask`: per sector.
    pub fn set(
        &mut self,
        j: usize,
        visual: &[f32],
        verbal: &[f32],
        visual_mask: &[f32],
        verbal_mask: &[f32],
    ) {
        let Shape {
            visual: n_visual,
            visual_mask: n_visual_mask,
            verbal: n_verbal,
            verbal_mask: n_verbal_mask,
            ..
        } = self.shape;
        let column = self.rows.column_mut(j);
        let (seen, rest) = column.split_at_mut(n_visual);
        let (seen_mask, rest) = rest.split_at_mut(n_visual_mask);
        let (heard, heard_mask) = rest.split_at_mut(n_verbal);
        let masked = n_visual_mask * BANDS;
        for (out, x) in seen[..masked]
            .chunks_exact_mut(n_visual_mask)
            .zip(visual[..masked].chunks_exact(n_visual_mask))
        {
            for ((out, x), mask) in out.iter_mut().zip(x).zip(visual_mask) {
                *out = through(*mask, *x);
            }
        }
        seen[masked..].copy_from_slice(&visual[masked..]);
        seen_mask.copy_from_slice(visual_mask);
        let words = n_verbal / n_verbal_mask;
        for ((out, x), mask) in heard
            .chunks_exact_mut(words)
            .zip(verbal.chunks_exact(words))
            .zip(verbal_mask)
        {
            for (out, x) in out.iter_mut().zip(x) {
                *out = through(*mask, *x);
            }
        }
        heard_mask.copy_from_slice(verbal_mask);
    }
}

/// `x` behind a mask; a mask of 0 hides even what is not finite, and the sign of zero.
fn through(mask: f32, x: f32) -> f32 {
    if mask == 0.0 { 0.0 } else { x * mask }
}

/// The mask entry that covers visual feature `i`; none for what is never masked.
pub fn visual_group(shape: &Shape, i: usize) -> Option<usize> {
    (i < shape.visual_mask * BANDS).then(|| i % shape.visual_mask)
}

/// What a person is shown and told of a robot's observation (steps 5 and 6 of forward imagination): raises the masks to
/// 1 where something is communicated. A highlight draws boxes around cars: where there is no car, or behind the
/// head-up display's edge, it shows nothing.
pub fn overlay(
    communicated: Communicated,
    visual: &[f32],
    visual_mask: &mut [f32],
    verbal_mask: &mut [f32],
) {
    if communicated.visual_bits() != 0 {
        let nearest = nearest_of_all(visual);
        for (azimuth, mask) in visual_mask[..AZIMUTHS].iter_mut().enumerate() {
            let shown = communicated.0 & SHOWN_BY[azimuth] != 0 && nearest[azimuth] > EMPTY;
            *mask = if shown { 1.0 } else { *mask };
        }
    }
    for (sector, mask) in verbal_mask.iter_mut().enumerate() {
        if communicated.verbal(sector) {
            *mask = 1.0;
        }
    }
}

/// Azimuths that a highlighted sector takes up on the head-up display, the unit of the visual cost (DESIGN §11).
pub fn azimuths_shown(sector: usize) -> usize {
    (0..AZIMUTHS)
        .filter(|&azimuth| on_display(azimuth) && sector_of(azimuth) == sector)
        .count()
}
