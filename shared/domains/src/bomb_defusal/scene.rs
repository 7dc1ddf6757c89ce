//! Scene files of bomb defusal: every number, with its default, and both books of rules.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{BUTTONS, TERMINALS, TYPES};
use crate::discrete::{Clock, Communication, Domain, Planning, Setting};
use crate::highway::FileError;
use crate::highway::file::Check;

/// The right button (0, 1, 2) by type of bomb and live terminal.
pub type Table = [[u8; TERMINALS]; TYPES];

/// `[rules]`: what the robot was trained with, and what the person knows to be right now.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Rules {
    /// In force in the original setting: the robot's.
    pub older: Table,
    /// In force in the transfer setting: the person's.
    pub newer: Table,
}

impl Default for Rules {
    fn default() -> Self {
        Self {
            older: [[0, 1, 2, 0, 1, 2], [1, 2, 0, 1, 2, 0]],
            // Other buttons for terminals 3 and 6 of both types.
            newer: [[0, 1, 0, 0, 1, 1], [1, 2, 1, 1, 2, 2]],
        }
    }
}

impl Rules {
    /// The rules in force in a setting.
    pub fn in_force(&self, setting: Setting) -> &Table {
        match setting {
            Setting::Original => &self.older,
            Setting::Transfer => &self.newer,
        }
    }
}

table! {
    /// `[reward]`: the paper's appendix, "Task Reward".
    pub struct Reward("reward") {
        /// For a right button.
        right: f64 = 5.0, 0.0, 1000.0;
        /// Penalty for a wrong one.
        wrong: f64 = 5.0, 0.0, 1000.0;
        /// Penalty for each step.
        time: f64 = 1.0, 0.0, 1000.0;
    }
}

table! {
    /// `[episode]`: when a round ends.
    pub struct Episode("episode") {
        /// Steps after which time is up.
        max_steps: u32 = 15, 1, 1_000_000;
    }
}

/// A scene of bomb defusal. Keys left out of a file have the values of [`Scene::default`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Scene {
    /// What the scene is called in summaries.
    pub name: String,
    /// Always `bomb_defusal`.
    pub domain: Domain,
    /// Older or newer rules in force.
    pub setting: Setting,
    /// See [`Rules`].
    pub rules: Rules,
    /// See [`Reward`].
    pub reward: Reward,
    /// See [`Communication`].
    pub communication: Communication,
    /// See [`Planning`].
    pub planning: Planning,
    /// See [`Episode`].
    pub episode: Episode,
    /// See [`Clock`].
    pub clock: Clock,
}

impl Default for Scene {
    fn default() -> Self {
        Self {
            name: "bomb".to_owned(),
            domain: Domain::BombDefusal,
            setting: Setting::Transfer,
            rules: Rules::default(),
            reward: Reward::default(),
            communication: Communication {
                visual_cost: 0.3,
                verbal_cost: 0.5,
            },
            planning: Planning::default(),
            episode: Episode::default(),
            clock: Clock::default(),
        }
    }
}

impl Scene {
    /// Checks every value against its range.
    ///
    /// # Errors
    /// Names the first value outside its range.
    pub fn check(&self, file: &Path) -> Result<(), FileError> {
        let check = Check { file };
        for (book, table) in [("older", &self.rules.older), ("newer", &self.rules.newer)] {
            for (kind, row) in table.iter().enumerate() {
                for (terminal, button) in row.iter().enumerate() {
                    let key = format!("rules.{book}[{kind}][{terminal}]");
                    check.range(&key, f64::from(*button), 0.0, (BUTTONS - 1) as f64)?;
                }
            }
        }
        self.reward.check(&check)?;
        self.communication.check(&check)?;
        self.planning.check_all(&check)?;
        self.clock.check(&check)?;
        self.episode.check(&check)
    }
}
