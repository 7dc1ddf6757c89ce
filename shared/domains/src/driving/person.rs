//! A simulated driver's parameters: the reward that they drive by, and how they plan and slip. Ten ship as parameter files.
//!
//! The weights were learned by maximum-entropy IRL from rounds of a drawn noisy driver, not from people (`draw_drivers` of the
//! training crate).

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{CARS, FEATURES};
use crate::discrete::Domain;
use crate::discrete::file::{PEOPLE, ten_people, text_of};
use crate::highway::FileError;
use crate::highway::file::{Check, parse, read};

const FILES: [&str; PEOPLE as usize] = ten_people!("driving");

/// `[weights]`: reward of each feature ([`super::features`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Weights {
    /// Of a lane to the right of the road's centre.
    pub offset: f32,
    /// Of the closeness of each car, in the order of slots.
    pub closeness: [f32; CARS],
    /// Of a lane change.
    pub change: f32,
}

impl Weights {
    /// In the order of [`super::FEATURE_NAMES`].
    pub fn array(&self) -> [f32; FEATURES] {
        let [a, b, c, d] = self.closeness;
        [self.offset, a, b, c, d, self.change]
    }

    /// From that order.
    pub fn from_array([offset, a, b, c, d, change]: [f32; FEATURES]) -> Self {
        Self {
            offset,
            closeness: [a, b, c, d],
            change,
        }
    }
}

/// `[planning]`: the cross-entropy method over sequences of actions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Planning {
    /// Steps that they look ahead, at most 16.
    pub horizon: u32,
    /// Sequences tried in an iteration, at most 64.
    pub samples: u32,
    /// Iterations.
    pub iterations: u32,
    /// Sequences that the next iteration learns from.
    pub elites: u32,
    /// Discount of a step.
    pub discount: f32,
}

/// A simulated driver.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Person {
    /// Number, from 1.
    pub id: u32,
    /// Probability of doing anything at all instead of what was meant.
    pub slip: f32,
    /// See [`Weights`].
    pub weights: Weights,
    /// See [`Planning`].
    pub planning: Planning,
}

/// Longest horizon.
pub(super) const MAX_HORIZON: usize = 16;
/// Most samples.
pub(super) const MAX_SAMPLES: usize = 64;

impl Person {
    /// One of the people that ship with the project, 1 to 10.
    ///
    /// # Errors
    /// When there is none of that number.
    pub fn builtin(id: u32) -> Result<Self, FileError> {
        let (file, text) = text_of(Domain::Driving, &FILES, id)?;
        Self::from_toml(&file, text)
    }

    /// Reads a person's file.
    ///
    /// # Errors
    /// When it cannot be read, is no driver's file, or holds a value outside its range.
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
        check.range("slip", f64::from(person.slip), 0.0, 1.0)?;
        for (name, weight) in super::FEATURE_NAMES.iter().zip(person.weights.array()) {
            check.range(&format!("weights.{name}"), f64::from(weight), -1e3, 1e3)?;
        }
        let planning = &person.planning;
        for (key, value, low, high) in [
            (
                "planning.horizon",
                planning.horizon as f32,
                1.0,
                MAX_HORIZON as f32,
            ),
            (
                "planning.samples",
                planning.samples as f32,
                2.0,
                MAX_SAMPLES as f32,
            ),
            (
                "planning.iterations",
                planning.iterations as f32,
                1.0,
                100.0,
            ),
            (
                "planning.elites",
                planning.elites as f32,
                1.0,
                planning.samples as f32,
            ),
            ("planning.discount", planning.discount, 0.0, 1.0),
        ] {
            check.range(key, f64::from(value), low, f64::from(high))?;
        }
        Ok(person)
    }
}
