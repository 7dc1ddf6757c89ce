//! `[traffic]` of a scene file.

use serde::{Deserialize, Serialize};

use crate::highway::file::{Check, FileError};

/// Which of the six cases an episode has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CaseOrder {
    /// Episode number modulo 6: six rounds show every case once.
    #[default]
    Cycle,
    /// Drawn from seed and episode.
    Drawn,
}

/// A car besides those of the cases, driving at one speed along its lane.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExtraCar {
    /// Its lane, counted from the right.
    pub lane: usize,
    /// Where it starts.
    pub start_s_m: f64,
    /// Its speed.
    pub speed_kmh: f64,
}

/// `[traffic]`: two cars behind, two ahead, and how they misbehave.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Traffic {
    /// How episodes get their case.
    pub order: CaseOrder,
    /// One case for every episode, 1 to 6; see [`super::world::Case`].
    pub case: Option<u32>,
    /// Rear cars start between these.
    pub rear_s_m: [f64; 2],
    /// Front cars start between these.
    pub front_s_m: [f64; 2],
    /// The speed that the factors below multiply.
    pub reference_kmh: f64,
    /// Factor of the rear cars.
    pub rear_factor: f64,
    /// Factor of the front cars.
    pub front_factor: f64,
    /// Factor of a rear car that rushes.
    pub rush_factor: [f64; 2],
    /// A front car that slows down does so near here …
    pub slow_s_m: [f64; 2],
    /// … to this share of the reference speed.
    pub slow_factor: [f64; 2],
    /// Acceleration of the cars.
    pub acceleration_mps2: f64,
    /// Acceleration of a car that rushes.
    pub rush_acceleration_mps2: f64,
    /// Deceleration of the cars.
    pub deceleration_mps2: f64,
    /// Length of the cars.
    pub length_m: f64,
    /// Width of the cars.
    pub width_m: f64,
    /// More cars.
    pub extra: Vec<ExtraCar>,
}

impl Default for Traffic {
    fn default() -> Self {
        Self {
            order: CaseOrder::Cycle,
            case: None,
            rear_s_m: [0.0, 10.0],
            front_s_m: [115.0, 125.0],
            reference_kmh: 30.0,
            rear_factor: 1.35,
            front_factor: 1.64,
            rush_factor: [2.2, 2.3],
            slow_s_m: [185.0, 195.0],
            slow_factor: [0.1, 0.2],
            acceleration_mps2: 1.2,
            rush_acceleration_mps2: 3.0,
            deceleration_mps2: 4.0,
            length_m: 4.6,
            width_m: 1.85,
            extra: Vec::new(),
        }
    }
}

impl Traffic {
    pub(super) fn check(&self, check: &Check<'_>, lanes: usize) -> Result<(), FileError> {
        check.range("traffic.case", f64::from(self.case.unwrap_or(1)), 1.0, 6.0)?;
        for (key, [low, high], least, most) in [
            ("traffic.rear_s_m", self.rear_s_m, -1e4, 1e5),
            ("traffic.front_s_m", self.front_s_m, -1e4, 1e5),
            ("traffic.rush_factor", self.rush_factor, 0.0, 20.0),
            ("traffic.slow_s_m", self.slow_s_m, 0.0, 1e5),
            ("traffic.slow_factor", self.slow_factor, 0.0, 20.0),
        ] {
            check.range(key, low, least, most)?;
            check.range(key, high, low, most)?;
        }
        for (key, value, low, high) in [
            ("traffic.reference_kmh", self.reference_kmh, 1.0, 200.0),
            ("traffic.rear_factor", self.rear_factor, 0.0, 20.0),
            ("traffic.front_factor", self.front_factor, 0.0, 20.0),
            (
                "traffic.acceleration_mps2",
                self.acceleration_mps2,
                0.1,
                20.0,
            ),
            (
                "traffic.rush_acceleration_mps2",
                self.rush_acceleration_mps2,
                0.1,
                20.0,
            ),
            (
                "traffic.deceleration_mps2",
                self.deceleration_mps2,
                0.1,
                20.0,
            ),
            ("traffic.length_m", self.length_m, 1.0, 30.0),
            ("traffic.width_m", self.width_m, 0.5, 4.0),
            (
                "traffic.extra (number of cars)",
                self.extra.len() as f64,
                0.0,
                1000.0,
            ),
        ] {
            check.range(key, value, low, high)?;
        }
        for (index, car) in self.extra.iter().enumerate() {
            let key = |name| format!("traffic.extra[{index}].{name}");
            check.range(&key("lane"), car.lane as f64, 0.0, lanes as f64 - 1.0)?;
            check.range(&key("start_s_m"), car.start_s_m, -1e4, 1e5)?;
            check.range(&key("speed_kmh"), car.speed_kmh, 0.0, 300.0)?;
        }
        Ok(())
    }
}
