//! A simulated defuser's parameters: how likely they notice a terminal within a step. Ten ship as parameter files.
//!
//! The probabilities were estimated from rounds of a drawn defuser, not of people (`examples/draw_gridworld_people.rs`).

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::discrete::Domain;
use crate::discrete::file::{PEOPLE, ten_people, text_of};
use crate::highway::FileError;
use crate::highway::file::{Check, parse, read};

const FILES: [&str; PEOPLE as usize] = ten_people!("bomb_defusal");

/// A simulated defuser.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Person {
    /// Number, from 1.
    pub id: u32,
    /// Probability p of noticing a terminal within a step: the live one is found after a geometric time.
    pub notice: f32,
}

impl Person {
    /// One of the people that ship with the project, 1 to 10.
    ///
    /// # Errors
    /// When there is none of that number.
    pub fn builtin(id: u32) -> Result<Self, FileError> {
        let (file, text) = text_of(Domain::BombDefusal, &FILES, id)?;
        Self::from_toml(&file, text)
    }

    /// Reads a person's file.
    ///
    /// # Errors
    /// When it cannot be read, is no defuser's file, or holds a value outside its range.
    pub fn load(file: &Path) -> Result<Self, FileError> {
        Self::from_toml(file, &read(file)?)
    }

    /// Reads a person from text; `file` is only named in errors.
    ///
    /// # Errors
    /// As [`Person::load`].
    pub fn from_toml(file: &Path, text: &str) -> Result<Self, FileError> {
        let person: Self = parse(file, text)?;
        Check { file }.range("notice", f64::from(person.notice), 0.0, 1.0)?;
        Ok(person)
    }
}
