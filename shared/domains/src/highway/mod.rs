//! Highway driving (the paper's CARLA study).
//!
//! Azimuth a counts anticlockwise from straight ahead, 10° each. Actions are `[throttle or brake, steer]`, each in
//! [−1, 1], steer left positive.

pub mod control;
pub mod display;
pub mod driver;
pub mod episode;
pub mod expert;
pub mod file;
pub mod fog;
pub mod geometry;
pub mod lidar;
mod memory;
pub mod modalities;
pub mod outline;
pub mod person;
pub mod road;
pub mod scene;
pub mod speech;
pub mod traffic;
pub mod world;

pub use control::Cockpit;
pub use driver::{Shown, SimulatedDriver};
pub use expert::Expert;
pub use file::FileError;
pub use fog::Fog;
pub use person::Person;
pub use road::Road;
pub use scene::Scene;
pub use speech::{Heard, UtteranceKind};
pub use world::{Case, End, Outcome, World};

/// LIDAR azimuths, every 10°.
pub const AZIMUTHS: usize = 36;
/// Height bands of the LIDAR.
pub const HEIGHT_BANDS: usize = 3;
/// LIDAR beams.
pub const BEAMS: usize = AZIMUTHS * HEIGHT_BANDS;
/// Values that the car measures on itself.
pub const EGO_VALUES: usize = 5;
/// Directions that can be communicated about.
pub const SECTORS: usize = 6;
/// Range of the LIDAR in metres.
pub const LIDAR_RANGE_M: f32 = 40.0;
/// Speed by which the ego car's speed is normalised, in m/s: 40 km/h.
pub const EGO_SPEED_MPS: f32 = 40.0 / 3.6;
/// Offset from the lane's centre by which it is normalised.
pub const EGO_LANE_M: f32 = 1.75;
/// Offset from the road's centre by which it is normalised.
pub const EGO_ROAD_M: f32 = 7.0;
/// How far ahead the road's heading change is measured.
pub const EGO_AHEAD_M: f64 = 10.0;

/// What the car measures in a step.
#[derive(Clone, Debug, PartialEq)]
pub struct Observation {
    /// Range over 40 m, 1 where nothing is in range: `range[band · 36 + azimuth]`.
    pub range: [f32; BEAMS],
    /// Identity of the object of the azimuth's nearest return; −1 for none.
    pub object: [i32; AZIMUTHS],
    /// Speed of that object over the road, in m/s; 0 for none.
    pub speed_mps: [f32; AZIMUTHS],
    /// Heading error/180°, speed/40 km/h, offset from lane centre/1.75 m, offset from road centre/7 m, road heading
    /// change 10 m ahead/180°; angles and offsets left positive.
    pub ego: [f32; EGO_VALUES],
    /// Whether traffic moves.
    pub moving: bool,
}

impl Default for Observation {
    fn default() -> Self {
        Self {
            range: [1.0; BEAMS],
            object: [-1; AZIMUTHS],
            speed_mps: [0.0; AZIMUTHS],
            ego: [0.0; EGO_VALUES],
            moving: false,
        }
    }
}

impl Observation {
    /// Range of an azimuth's nearest return over the height bands, in metres; 40 for none.
    pub fn nearest_m(&self, azimuth: usize) -> f32 {
        let bands = (0..HEIGHT_BANDS).map(|band| self.range[band * AZIMUTHS + azimuth]);
        bands.fold(1.0, f32::min) * LIDAR_RANGE_M
    }
}

/// A generator of random numbers that depends on nothing but these three.
pub(crate) fn random(seed: u64, episode: u32, stream: u64) -> rand_chacha::ChaCha8Rng {
    use rand::SeedableRng;
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&seed.to_le_bytes());
    bytes[8..12].copy_from_slice(&episode.to_le_bytes());
    bytes[16..24].copy_from_slice(&stream.to_le_bytes());
    rand_chacha::ChaCha8Rng::from_seed(bytes)
}
