//! The highway as a model sees it: what the numbers of the visual and the verbal modality are, which azimuth's mask covers
//! which of them, and how people perceive.
//!
//! The visual modality is the LIDAR as *nearness*, 1 − range/40 m, so that 0 says "nothing there", and the five ego values,
//! scaled so that each varies by about as much as the others. One mask entry per azimuth covers its three height bands; ego
//! values are never masked. The verbal modality has one mask entry per sector.

use super::speech::{SECTOR_NAMES, displayable, sector_of};
use super::{AZIMUTHS, BEAMS, EGO_VALUES, HEIGHT_BANDS, LIDAR_RANGE_M, SECTORS};
use crate::{ActionSpace, Layout, Mask, Perception};
use std::sync::{Arc, OnceLock};

/// The domain's name.
pub const NAME: &str = "highway";
/// Numbers of the visual modality.
pub const VISUAL: usize = BEAMS + EGO_VALUES;
/// Numbers per sector in the verbal modality: 19 of the utterance's embedding, and the range.
pub const PER_SECTOR: usize = 20;
/// Numbers of the verbal modality.
pub const VERBAL: usize = SECTORS * PER_SECTOR;
/// Nearness below which an imagined azimuth counts as empty: 2 m short of the LIDAR's range.
pub const EMPTY: f32 = 0.05;
/// The largest limit of sight: one metre beyond the LIDAR's range, so that "sees that nothing is there" can be represented.
pub const MAX_SIGHT_M: f32 = LIDAR_RANGE_M + 1.0;

/// Factors on the ego values (heading error/180°, speed, lane offset, road offset, heading change ahead/180°): 1 stands for
/// 3° and for half a unit of the others. Without them the ELBO would not notice a heading error of a few degrees, and a
/// policy that cannot see its own heading cannot keep a lane.
pub const EGO_SCALE: [f32; EGO_VALUES] = [60.0, 2.0, 2.0, 2.0, 60.0];

/// Writes the visual modality of normalised ranges (`band · 36 + azimuth`, 1 for nothing) and ego values: 113 numbers.
pub fn write_visual(range: &[f32; BEAMS], ego: &[f32; EGO_VALUES], visual: &mut [f32]) {
    for (nearness, range) in visual.iter_mut().zip(range) {
        *nearness = 1.0 - range;
    }
    for i in 0..EGO_VALUES {
        visual[BEAMS + i] = ego[i] * EGO_SCALE[i];
    }
}

/// The inverse of [`write_visual`]: normalised ranges, then ego values.
pub fn read_visual(visual: &[f32], out: &mut [f32]) {
    for (range, nearness) in out.iter_mut().zip(&visual[..BEAMS]) {
        *range = 1.0 - nearness;
    }
    for i in 0..EGO_VALUES {
        out[BEAMS + i] = visual[BEAMS + i] / EGO_SCALE[i];
    }
}

/// Nearest return of an azimuth as nearness, over the height bands of one visual column.
pub fn nearest(visual: &[f32], azimuth: usize) -> f32 {
    let mut nearest = visual[azimuth];
    for band in 1..HEIGHT_BANDS {
        nearest = nearest.max(visual[band * AZIMUTHS + azimuth]);
    }
    nearest
}

/// [`nearest`] of every azimuth.
pub fn nearest_of_all(visual: &[f32]) -> [f32; AZIMUTHS] {
    let (bands, _) = visual.as_chunks::<AZIMUTHS>();
    let mut nearest = bands[0];
    for band in &bands[1..HEIGHT_BANDS] {
        for (nearest, other) in nearest.iter_mut().zip(band) {
            *nearest = nearest.max(*other);
        }
    }
    nearest
}

/// Range in metres of an azimuth's nearest return. Decoders may imagine nearness outside [0, 1].
pub fn range_of(visual: &[f32], azimuth: usize) -> f32 {
    range_m(nearest(visual, azimuth))
}

fn range_m(nearness: f32) -> f32 {
    LIDAR_RANGE_M * (1.0 - nearness.clamp(0.0, 1.0))
}

/// Azimuths that a highlighted sector takes up on the head-up display, the unit of the visual cost.
pub fn azimuths_shown(sector: usize) -> usize {
    (0..AZIMUTHS)
        .filter(|&azimuth| displayable(azimuth) && sector_of(azimuth) == sector)
        .count()
}

/// The azimuths that each sector's highlight reaches, a bit each; none behind the display's edge.
const REACH: [u64; SECTORS] = {
    let mut reach = [0; SECTORS];
    let mut azimuth = 0;
    while azimuth < AZIMUTHS {
        if displayable(azimuth) {
            reach[sector_of(azimuth)] |= 1 << azimuth;
        }
        azimuth += 1;
    }
    reach
};

/// The azimuths of each sector, a bit each.
const EXTENT: [u64; SECTORS] = {
    let mut extent = [0; SECTORS];
    let mut azimuth = 0;
    while azimuth < AZIMUTHS {
        extent[sector_of(azimuth)] |= 1 << azimuth;
        azimuth += 1;
    }
    extent
};

/// Azimuths with a return, a bit each.
fn returns(visual: &[f32]) -> u64 {
    let nearest = nearest_of_all(visual);
    let cars = nearest.iter().enumerate();
    cars.fold(0, |bits, (azimuth, nearest)| {
        bits | u64::from(*nearest > EMPTY) << azimuth
    })
}

/// Sectors of `extent` with a return, a bit each.
fn sectors_with(extent: &[u64; SECTORS], returns: u64) -> u32 {
    let sectors = extent.iter().enumerate();
    sectors.fold(0, |bits, (sector, extent)| {
        bits | u32::from(extent & returns != 0) << sector
    })
}

/// Sectors in which a visual column holds a car, a bit each.
pub fn occupied(visual: &[f32]) -> u32 {
    sectors_with(&EXTENT, returns(visual))
}

/// Sectors whose highlight would show a car, a bit each: those that hold one within the display's reach.
pub fn highlightable(visual: &[f32]) -> u32 {
    sectors_with(&REACH, returns(visual))
}

/// How drivers perceive: metres to the nearest return of an azimuth, and a limit for each azimuth.
#[derive(Debug)]
struct MetresToReturns;

impl Perception for MetresToReturns {
    fn regions(&self) -> usize {
        AZIMUTHS
    }

    fn limits(&self) -> usize {
        AZIMUTHS
    }

    fn largest(&self) -> f32 {
        MAX_SIGHT_M
    }

    /// Straight ahead, then every 45° to the back, alike on both sides.
    fn controls(&self) -> usize {
        5
    }

    /// Straight lines between the controls' azimuths.
    fn limits_of(&self, controls: &[f32]) -> Vec<f32> {
        let limit = |azimuth: usize| {
            let turned = azimuth.min(AZIMUTHS - azimuth) as f32 * 8.0 / AZIMUTHS as f32;
            let before = (turned as usize).min(controls.len() - 2);
            let share = turned - before as f32;
            (1.0 - share) * controls[before] + share * controls[before + 1]
        };
        (0..AZIMUTHS).map(limit).collect()
    }

    fn distance(&self, region: usize, visual: &[f32], _: Option<&[f32]>) -> (f32, usize) {
        (range_of(visual, region), region)
    }

    fn seen(&self, limits: &[f32], visual: &[f32], _: Option<&[f32]>) -> u64 {
        let nearest = nearest_of_all(visual);
        let seen = nearest.into_iter().zip(limits).enumerate();
        seen.fold(0, |bits, (azimuth, (nearness, limit))| {
            bits | u64::from(range_m(nearness) <= *limit) << azimuth
        })
    }

    /// A highlight draws boxes around cars: where there is no car, or behind the head-up display's edge, it shows nothing.
    fn shown(&self, items: u32, visual: &[f32]) -> u64 {
        let sectors = REACH.iter().enumerate();
        let reached = sectors.fold(0, |bits, (sector, reach)| match items >> sector & 1 {
            0 => bits,
            _ => bits | reach,
        });
        reached & returns(visual)
    }
}

/// Directions of the azimuths, anticlockwise from straight ahead.
const AZIMUTH_NAMES: [&str; AZIMUTHS] = [
    "0°", "10°", "20°", "30°", "40°", "50°", "60°", "70°", "80°", "90°", "100°", "110°", "120°",
    "130°", "140°", "150°", "160°", "170°", "180°", "190°", "200°", "210°", "220°", "230°", "240°",
    "250°", "260°", "270°", "280°", "290°", "300°", "310°", "320°", "330°", "340°", "350°",
];

/// What the highway's numbers mean.
pub fn layout() -> Arc<Layout> {
    static LAYOUT: OnceLock<Arc<Layout>> = OnceLock::new();
    Arc::clone(LAYOUT.get_or_init(|| {
        let region = |i: usize| (i < BEAMS).then_some((i % AZIMUTHS) as u8);
        let every_azimuth = u64::MAX >> (64 - AZIMUTHS);
        let reached = (0..SECTORS).filter(|&sector| REACH[sector] != 0);
        Arc::new(Layout {
            domain: NAME,
            number: 0,
            visual: VISUAL,
            verbal: VERBAL,
            actions: ActionSpace::Continuous(2),
            image: None,
            visual_region: (0..VISUAL).map(region).collect(),
            verbal_utterance: (0..VERBAL).map(|i| (i / PER_SECTOR) as u8).collect(),
            told_regions: EXTENT.to_vec(),
            regions: AZIMUTHS,
            utterances: SECTORS,
            perception: &MetresToReturns,
            // The robot has its LIDAR, and nobody talks to it.
            sensed: Mask {
                visual: every_azimuth,
                verbal: 0,
            },
            heard: 0,
            communicable: Mask {
                visual: reached.fold(0, |bits, sector| bits | 1 << sector),
                verbal: (1 << SECTORS) - 1,
            },
            costs: None,
            action_names: &["throttle", "steer"],
            region_names: &AZIMUTH_NAMES,
            utterance_names: &SECTOR_NAMES,
            terms: &[
                "speed",
                "brake",
                "steer",
                "change",
                "center",
                "proximity",
                "road",
                "collision",
            ],
            success: "the end of the road reached",
            accident: "hit another car",
        })
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sight_and_highlights_end_where_they_should() {
        let layout = layout();
        let mut visual = vec![0.0; VISUAL];
        visual[3] = 0.5; // 20 m to the left ahead
        visual[AZIMUTHS + 20] = 0.9; // 4 m to the right behind
        let far = [30.0; AZIMUTHS];
        let seen = layout.perception.seen(&far, &visual, None);
        assert_eq!(seen, 1 << 3 | 1 << 20);
        for region in 0..AZIMUTHS {
            let (distance, limit) = layout.perception.distance(region, &visual, None);
            assert_eq!(distance <= far[limit], seen >> region & 1 == 1);
        }
        let shown = |items| layout.perception.shown(items, &visual);
        assert_eq!(shown(0b00_0010), 1 << 3, "only the car is boxed");
        assert_eq!(shown(0b01_0000), 0, "the display ends at the side");
        assert_eq!(occupied(&visual), 0b01_0010);
        assert_eq!(highlightable(&visual), 0b00_0010);
        assert_eq!(layout.communicable.visual, 0b10_0011);
        assert_eq!((0..SECTORS).map(azimuths_shown).sum::<usize>(), 19);
    }
}
