//! Scene files of search and rescue: every number, with its default.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::discrete::{Clock, Communication, Domain, Planning, Setting};
use crate::highway::FileError;
use crate::highway::file::Check;

table! {
    /// `[smoke]`: how far people see.
    pub struct Smoke("smoke") {
        /// A portion of the map is seen if its centre is within so many cells.
        radius_cells: f64 = 1.5, 0.0, 20.0;
    }
}

table! {
    /// `[reward]`: the paper's appendix, "Task Reward".
    pub struct Reward("reward") {
        /// For finding the victim.
        found: f64 = 1.0, 0.0, 1000.0;
        /// For being back at the entrance with the victim.
        rescued: f64 = 15.0, 0.0, 1000.0;
        /// Penalty for running into an obstacle.
        obstacle: f64 = 10.0, 0.0, 1000.0;
        /// Penalty for each step.
        time: f64 = 0.1, 0.0, 1000.0;
    }
}

table! {
    /// `[episode]`: when a round ends.
    pub struct Episode("episode") {
        /// Steps after which time is up.
        max_steps: u32 = 60, 1, 1_000_000;
    }
}

/// A scene of search and rescue. Keys left out of a file have the values of [`Scene::default`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Scene {
    /// What the scene is called in summaries.
    pub name: String,
    /// Always `search_rescue`.
    pub domain: Domain,
    /// Clear air or smoke.
    pub setting: Setting,
    /// See [`Smoke`]; counts in the transfer setting.
    pub smoke: Smoke,
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
            name: "search".to_owned(),
            domain: Domain::SearchRescue,
            setting: Setting::Original,
            smoke: Smoke::default(),
            reward: Reward::default(),
            communication: Communication {
                visual_cost: 0.02,
                verbal_cost: 0.1,
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
        self.smoke.check(&check)?;
        self.reward.check(&check)?;
        self.communication.check(&check)?;
        self.planning.check_all(&check)?;
        self.clock.check(&check)?;
        self.episode.check(&check)
    }
}
