//! A simulated searcher's parameters: how likely they go from each subgoal to each other, and how they slip. Ten ship as parameter
//! files.
//!
//! The probabilities were counted from rounds of a drawn searcher, not of people (`examples/draw_gridworld_people.rs`).

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::map::Cell;
use super::{CORRIDORS, PLACES};
use crate::discrete::Domain;
use crate::discrete::file::{PEOPLE, ten_people, text_of};
use crate::highway::FileError;
use crate::highway::file::{Check, parse, read};

const FILES: [&str; PEOPLE as usize] = ten_people!("search_rescue");

/// Subgoals: the entrance, the two corridors, the three places.
pub const SUBGOALS: usize = 1 + CORRIDORS + PLACES;

/// The cell of a subgoal.
pub fn subgoal_cell(subgoal: usize) -> Cell {
    match subgoal {
        0 => Cell::ENTRANCE,
        1 | 2 => Cell::CORRIDORS[subgoal - 1],
        _ => Cell::PLACES[subgoal - 1 - CORRIDORS],
    }
}

/// The subgoal at a cell, if there is one.
pub fn subgoal_at(cell: Cell) -> Option<usize> {
    (0..SUBGOALS).find(|subgoal| subgoal_cell(*subgoal) == cell)
}

/// Whether one may go from a subgoal to another: from the entrance to a corridor, from there to a place while searching, from
/// place to place; back by a corridor to the entrance.
pub fn is_transition(from: usize, to: usize, found: bool) -> bool {
    let is_corridor = |subgoal: usize| (1..=CORRIDORS).contains(&subgoal);
    let is_place = |subgoal: usize| subgoal > CORRIDORS;
    if found {
        (is_place(from) && is_corridor(to)) || (is_corridor(from) && to == 0)
    } else {
        (from == 0 && is_corridor(to)) || (from != 0 && is_place(to) && from != to)
    }
}

/// A row for each subgoal: probabilities of the next.
pub type Transitions = [[f32; SUBGOALS]; SUBGOALS];

/// Counts, in recorded rounds, which subgoal was reached after which, one count added to each possible transition; returns
/// probabilities. A round is the person's cell and whether they had found the victim, step after step. The first matrix is of the
/// search, the second of the way back.
pub fn count_transitions<'a>(
    rounds: impl Iterator<Item = &'a [(Cell, bool)]>,
) -> (Transitions, Transitions) {
    let mut counts = [[[0.0f32; SUBGOALS]; SUBGOALS]; 2];
    for (phase, table) in counts.iter_mut().enumerate() {
        for from in 0..SUBGOALS {
            for to in 0..SUBGOALS {
                table[from][to] = f32::from(u8::from(is_transition(from, to, phase == 1)));
            }
        }
    }
    for round in rounds {
        let mut last = None;
        for (cell, found) in round {
            let Some(subgoal) = subgoal_at(*cell) else {
                continue;
            };
            if let Some((from, phase)) = last
                && from != subgoal
                && is_transition(from, subgoal, phase)
            {
                counts[usize::from(phase)][from][subgoal] += 1.0;
            }
            last = Some((subgoal, *found));
        }
    }
    for row in counts.iter_mut().flatten() {
        let total: f32 = row.iter().sum();
        if total > 0.0 {
            row.iter_mut().for_each(|count| *count /= total);
        }
    }
    let [searching, returning] = counts;
    (searching, returning)
}

/// A simulated searcher.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Person {
    /// Number, from 1.
    pub id: u32,
    /// Probability of a step in any direction instead of the one that was meant.
    pub slip: f32,
    /// Probabilities of the next subgoal while searching: from each row's to each column's, in the order entrance, top corridor,
    /// bottom corridor, top right, middle right, bottom right. What a person knows to be in vain is left out and the rest
    /// scaled to sum to 1.
    pub searching: Transitions,
    /// The same on the way back.
    pub returning: Transitions,
}

impl Person {
    /// One of the people that ship with the project, 1 to 10.
    ///
    /// # Errors
    /// When there is none of that number.
    pub fn builtin(id: u32) -> Result<Self, FileError> {
        let (file, text) = text_of(Domain::SearchRescue, &FILES, id)?;
        Self::from_toml(&file, text)
    }

    /// Reads a person's file.
    ///
    /// # Errors
    /// When it cannot be read, is no searcher's file, or holds a value outside its range.
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
        for (name, table, found) in [
            ("searching", &person.searching, false),
            ("returning", &person.returning, true),
        ] {
            for from in 0..SUBGOALS {
                for to in 0..SUBGOALS {
                    let possible = is_transition(from, to, found);
                    // Every possible transition keeps some probability: it may become the only one left.
                    let (low, high) = if possible { (1e-6, 1.0) } else { (0.0, 0.0) };
                    let key = format!("{name}[{from}][{to}]");
                    check.range(&key, f64::from(table[from][to]), low, high)?;
                }
            }
        }
        Ok(person)
    }
}
