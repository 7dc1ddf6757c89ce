//! A simulated person: what they see, how they drive, how slow and noisy they are. Twenty-one ship as parameter files.
//!
//! The parameters are drawn from stated distributions (`examples/draw_people.rs`), not from people.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::file::{Check, FileError, parse, read};
use super::{AZIMUTHS, Fog, LIDAR_RANGE_M};

macro_rules! people {
    ($($number:literal)*) => {
        [$(include_str!(concat!("../../people/highway/", $number, ".toml")),)*]
    };
}

const PEOPLE: [&str; 21] = people!(
    "01" "02" "03" "04" "05" "06" "07" "08" "09" "10" "11" "12" "13" "14" "15" "16" "17" "18" "19" "20" "21"
);

/// How far a person sees.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sight {
    /// Multiplies a fog's distances ahead.
    pub fog_front_factor: f32,
    /// Multiplies a fog's distances sideways.
    pub fog_side_factor: f32,
    /// Multiplies a fog's distances behind.
    pub fog_rear_factor: f32,
    /// In clear weather, how far behind the mirrors show a car.
    pub mirror_m: f32,
    /// In clear weather, how far back a look over the shoulder reaches (110° to 150° to either side).
    pub shoulder_m: f32,
}

/// Car following: the Intelligent Driver Model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Following {
    /// Speed on an empty road.
    pub desired_kmh: f32,
    /// How much slower where one sees nothing at all, as a share.
    pub caution: f32,
    /// Time headway T.
    pub headway_s: f32,
    /// Gap at standstill s0.
    pub standstill_m: f32,
    /// Acceleration a.
    pub acceleration_mps2: f32,
    /// Comfortable deceleration b.
    pub deceleration_mps2: f32,
}

/// Lane changing: MOBIL, with the knowledge that other cars do not brake for one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Changing {
    /// Politeness p: how much cars behind count.
    pub politeness: f32,
    /// Advantage Δa that a lane change must bring.
    pub threshold_mps2: f32,
    /// A lane is safe if no car in it would be met within this time.
    pub safe_s: f32,
    /// Largest slant to the road while changing lanes.
    pub slant_rad: f32,
}

/// Reaction and hands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reacting {
    /// Control steps between seeing and acting.
    pub delay_steps: u32,
    /// Deviation of the noise on the pedals.
    pub pedal_noise: f32,
    /// Deviation of the noise on the steering wheel.
    pub steer_noise: f32,
    /// Share of the noise that stays from step to step.
    pub noise_memory: f32,
    /// Time constant of steering.
    pub turn_s: f32,
}

/// A simulated person.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Person {
    /// Number, from 1.
    pub id: u32,
    /// See [`Sight`].
    pub sight: Sight,
    /// See [`Following`].
    pub following: Following,
    /// See [`Changing`].
    pub changing: Changing,
    /// See [`Reacting`].
    pub reacting: Reacting,
}

impl Person {
    /// How many people ship with the project.
    pub const COUNT: u32 = PEOPLE.len() as u32;

    /// One of the people that ship with the project, 1 to 21.
    ///
    /// # Errors
    /// When there is none of that number.
    pub fn builtin(id: u32) -> Result<Self, FileError> {
        let file = PathBuf::from(format!("people/highway/{id:02}.toml"));
        let text = (id as usize)
            .checked_sub(1)
            .and_then(|index| PEOPLE.get(index))
            .ok_or_else(|| FileError::Range {
                file: "simulated people".into(),
                key: "id".to_owned(),
                value: f64::from(id),
                expected: format!("1 to {}", PEOPLE.len()),
            })?;
        Self::from_toml(&file, text)
    }

    /// Reads a person's file.
    ///
    /// # Errors
    /// When it cannot be read, is no person's file, or holds a value outside its range.
    pub fn load(file: &Path) -> Result<Self, FileError> {
        Self::from_toml(file, &read(file)?)
    }

    /// Reads a person from text; `file` is only named in errors.
    ///
    /// # Errors
    /// As [`Person::load`].
    pub fn from_toml(file: &Path, text: &str) -> Result<Self, FileError> {
        let person: Self = parse(file, text)?;
        let check = Check { file };
        let Self {
            sight,
            following,
            changing,
            reacting,
            ..
        } = &person;
        for (key, value, low, high) in [
            ("sight.fog_front_factor", sight.fog_front_factor, 0.0, 10.0),
            ("sight.fog_side_factor", sight.fog_side_factor, 0.0, 10.0),
            ("sight.fog_rear_factor", sight.fog_rear_factor, 0.0, 10.0),
            ("sight.mirror_m", sight.mirror_m, 0.0, 40.0),
            ("sight.shoulder_m", sight.shoulder_m, 0.0, 40.0),
            ("following.desired_kmh", following.desired_kmh, 1.0, 200.0),
            ("following.caution", following.caution, 0.0, 0.9),
            ("following.headway_s", following.headway_s, 0.1, 10.0),
            ("following.standstill_m", following.standstill_m, 0.1, 20.0),
            (
                "following.acceleration_mps2",
                following.acceleration_mps2,
                0.1,
                10.0,
            ),
            (
                "following.deceleration_mps2",
                following.deceleration_mps2,
                0.1,
                10.0,
            ),
            ("changing.politeness", changing.politeness, 0.0, 5.0),
            (
                "changing.threshold_mps2",
                changing.threshold_mps2,
                0.0,
                10.0,
            ),
            ("changing.safe_s", changing.safe_s, 0.1, 20.0),
            ("changing.slant_rad", changing.slant_rad, 0.01, 0.6),
            (
                "reacting.delay_steps",
                reacting.delay_steps as f32,
                0.0,
                MAX_DELAY as f32,
            ),
            ("reacting.pedal_noise", reacting.pedal_noise, 0.0, 1.0),
            ("reacting.steer_noise", reacting.steer_noise, 0.0, 1.0),
            ("reacting.noise_memory", reacting.noise_memory, 0.0, 0.999),
            ("reacting.turn_s", reacting.turn_s, 0.15, 5.0),
        ] {
            check.range(key, f64::from(value), low, f64::from(high))?;
        }
        Ok(person)
    }

    /// How far this person sees a car in each direction, in metres: in clear weather, ahead and to the sides as far as
    /// the LIDAR, behind as far as the mirrors and the look over the shoulder go; in fog no farther than it allows.
    pub fn visibility_m(&self, fog: &Fog) -> [f32; AZIMUTHS] {
        let sight = &self.sight;
        std::array::from_fn(|azimuth| {
            let angle = azimuth as f32 * std::f32::consts::TAU / AZIMUTHS as f32;
            let ends = if angle.cos() > 0.0 {
                sight.fog_front_factor
            } else {
                sight.fog_rear_factor
            };
            let (along, across) = (angle.cos().powi(2), angle.sin().powi(2));
            let clear = match azimuth {
                11..=15 | 21..=25 => sight.shoulder_m,
                16..=20 => sight.mirror_m,
                _ => LIDAR_RANGE_M,
            };
            // No fog reaches as far as the LIDAR: then the eyes' factors have nothing to multiply.
            let through = if fog.visible_m[azimuth] >= LIDAR_RANGE_M {
                LIDAR_RANGE_M
            } else {
                fog.visible_m[azimuth] * (ends * along + sight.fog_side_factor * across)
            };
            clear.min(through)
        })
    }
}

/// Longest reaction delay, in control steps.
pub(crate) const MAX_DELAY: usize = 32;
