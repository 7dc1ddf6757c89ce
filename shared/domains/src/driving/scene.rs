//! Scene files of gridworld driving: every number, with its default.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::discrete::{Clock, Communication, Domain, Planning, Setting};
use crate::highway::FileError;
use crate::highway::file::Check;

table! {
    /// `[traffic]`: where the other cars start and how they move.
    pub struct Traffic("traffic") {
        /// Cars start at least this far ahead or behind.
        nearest_cells: u32 = 4, 1, 10;
        /// Cars start at most this far ahead or behind.
        farthest_cells: u32 = 8, 1, 10;
        /// The dangerous car slows down or speeds up between step 0 and this one.
        latest_onset: u32 = 3, 0, 1000;
        /// Probability, per step, that another car draws anew whether it keeps, gains or loses a cell a step.
        wander: f64 = 0.1, 0.0, 1.0;
        /// Other cars than the dangerous one come no nearer than this.
        gap_cells: u32 = 3, 1, 10;
    }
}

table! {
    /// `[fog]`: how many cells people see.
    pub struct Fog("fog") {
        /// Ahead.
        ahead_cells: f64 = 2.0, 0.0, 10.0;
        /// Behind.
        behind_cells: f64 = 0.0, 0.0, 10.0;
    }
}

table! {
    /// `[reward]`: the paper's appendix, "Task Reward".
    pub struct Reward("reward") {
        /// Penalty for a car within `near_cells` in the same lane.
        proximity: f64 = 2.0, 0.0, 1000.0;
        /// See `proximity`.
        near_cells: u32 = 2, 0, 10;
        /// Penalty for a collision.
        collision: f64 = 5.0, 0.0, 1000.0;
        /// Penalty for a lane change.
        change: f64 = 1.0, 0.0, 1000.0;
    }
}

table! {
    /// `[episode]`: when a round ends.
    pub struct Episode("episode") {
        /// Steps after which the end of the road is reached.
        max_steps: u32 = 14, 1, 1_000_000;
    }
}

/// A scene of gridworld driving. Keys left out of a file have the values of [`Scene::default`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Scene {
    /// What the scene is called in summaries.
    pub name: String,
    /// Always `driving`.
    pub domain: Domain,
    /// Clear weather or fog.
    pub setting: Setting,
    /// See [`Traffic`].
    pub traffic: Traffic,
    /// See [`Fog`]; counts in the transfer setting.
    pub fog: Fog,
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
            name: "driving".to_owned(),
            domain: Domain::Driving,
            setting: Setting::Original,
            traffic: Traffic::default(),
            fog: Fog::default(),
            reward: Reward::default(),
            communication: Communication {
                visual_cost: 0.01,
                verbal_cost: 0.03,
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
        self.traffic.check(&check)?;
        let (nearest, farthest) = (self.traffic.nearest_cells, self.traffic.farthest_cells);
        check.range(
            "traffic.farthest_cells",
            f64::from(farthest),
            f64::from(nearest),
            10.0,
        )?;
        self.fog.check(&check)?;
        self.reward.check(&check)?;
        self.communication.check(&check)?;
        self.planning.check_all(&check)?;
        self.clock.check(&check)?;
        self.episode.check(&check)
    }
}
