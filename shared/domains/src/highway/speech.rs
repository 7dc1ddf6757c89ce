//! What can be said: six sectors, three kinds of utterance, eighteen sentences.

use super::{AZIMUTHS, LIDAR_RANGE_M, Observation, SECTORS};

/// A car is called fast from this speed on, in m/s (32 km/h).
pub const FAST_MPS: f32 = 32.0 / 3.6;

/// Names of the sectors, by index.
pub const SECTOR_NAMES: [&str; SECTORS] = [
    "front",
    "left-front",
    "left-rear",
    "rear",
    "right-rear",
    "right-front",
];

/// Azimuths of each sector, first and last.
pub const SECTOR_AZIMUTHS: [(usize, usize); SECTORS] =
    [(0, 0), (1, 9), (10, 17), (18, 18), (19, 26), (27, 35)];

/// The sector that an azimuth belongs to.
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

/// Whether a head-up display can show an azimuth: 0–9 and 27–35.
pub const fn displayable(azimuth: usize) -> bool {
    azimuth <= 9 || (azimuth >= 27 && azimuth < AZIMUTHS)
}

/// What an utterance says about its sector.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum UtteranceKind {
    /// No car in range.
    #[default]
    Nothing = 0,
    /// A car slower than [`FAST_MPS`].
    Slow = 1,
    /// A car at least that fast.
    Fast = 2,
}

impl UtteranceKind {
    /// The kind of that number in a message.
    pub fn from_number(number: u32) -> Option<Self> {
        [Self::Nothing, Self::Slow, Self::Fast]
            .get(number as usize)
            .copied()
    }
}

/// What is true of a sector, and what a person is told by an utterance about it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heard {
    /// What is said.
    pub kind: UtteranceKind,
    /// Range of the sector's nearest car in metres; 40 for none.
    pub range_m: f32,
    /// That car's speed in m/s; 0 for none.
    pub speed_mps: f32,
}

/// What an utterance about each sector would truthfully say, from what the LIDAR sees.
pub fn utterances(observation: &Observation) -> [Heard; SECTORS] {
    std::array::from_fn(|sector| {
        let (first, last) = SECTOR_AZIMUTHS[sector];
        let mut heard = Heard {
            kind: UtteranceKind::Nothing,
            range_m: LIDAR_RANGE_M,
            speed_mps: 0.0,
        };
        for azimuth in first..=last {
            let range_m = observation.nearest_m(azimuth);
            if observation.object[azimuth] >= 0 && range_m < heard.range_m {
                let speed_mps = observation.speed_mps[azimuth];
                let kind = if speed_mps >= FAST_MPS {
                    UtteranceKind::Fast
                } else {
                    UtteranceKind::Slow
                };
                heard = Heard {
                    kind,
                    range_m,
                    speed_mps,
                };
            }
        }
        heard
    })
}

/// The words of an utterance, at most 63 bytes. Sectors past the last are the last.
pub fn sentence(sector: usize, kind: UtteranceKind) -> &'static str {
    const SENTENCES: [[&str; 3]; SECTORS] = [
        [
            "There is no car in front.",
            "Slow car in front.",
            "Fast car in front.",
        ],
        [
            "There is no car on the front left.",
            "Slow car on the front left.",
            "Fast car on the front left.",
        ],
        [
            "There is no car on the rear left.",
            "Slow car on the rear left.",
            "Fast car coming from the rear left.",
        ],
        [
            "There is no car behind.",
            "Slow car behind.",
            "Fast car coming from behind.",
        ],
        [
            "There is no car on the rear right.",
            "Slow car on the rear right.",
            "Fast car coming from the rear right.",
        ],
        [
            "There is no car on the front right.",
            "Slow car on the front right.",
            "Fast car on the front right.",
        ],
    ];
    SENTENCES[sector.min(SECTORS - 1)][kind as usize]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sentences_are_distinct_and_fit_a_message() {
        let mut seen = std::collections::BTreeSet::new();
        for sector in 0..SECTORS {
            for number in 0..3 {
                let kind = UtteranceKind::from_number(number).unwrap();
                let words = sentence(sector, kind);
                assert!(words.len() <= 63 && seen.insert(words), "{words}");
            }
        }
        assert_eq!(UtteranceKind::from_number(3), None);
    }

    #[test]
    fn every_azimuth_is_in_its_sector() {
        for azimuth in 0..AZIMUTHS {
            let (first, last) = SECTOR_AZIMUTHS[sector_of(azimuth)];
            assert!((first..=last).contains(&azimuth), "{azimuth}");
        }
    }

    #[test]
    fn the_nearest_car_of_a_sector_is_spoken_of() {
        let mut observation = Observation::default();
        observation.range[18] = 0.5;
        observation.object[18] = 3;
        observation.speed_mps[18] = 18.0;
        observation.range[AZIMUTHS + 4] = 0.25;
        observation.object[4] = 5;
        observation.speed_mps[4] = 2.0;
        observation.range[6] = 0.75;
        observation.object[6] = 6;
        observation.speed_mps[6] = 12.0;
        let heard = utterances(&observation);
        assert_eq!(
            heard[3],
            Heard {
                kind: UtteranceKind::Fast,
                range_m: 20.0,
                speed_mps: 18.0
            }
        );
        assert_eq!(
            heard[1],
            Heard {
                kind: UtteranceKind::Slow,
                range_m: 10.0,
                speed_mps: 2.0
            }
        );
        assert_eq!(heard[0].kind, UtteranceKind::Nothing);
    }
}
