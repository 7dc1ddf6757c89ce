//! What the launcher tells the world process: scene, recording, episodes, seed.

use anyhow::{Context, Result};
use domains::commonroad;
use domains::highway::{Scene, World};
use scenario::Scenario;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;

/// Options of the world process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldOptions {
    /// Which world.
    #[serde(rename = "place")]
    pub scenario: Scenario<HighwayRoad>,
    /// Episodes to drive.
    pub episodes: u32,
    /// Seed of everything that is drawn.
    pub seed: u64,
    /// Whether a person is at the wheel: the world then stands still while nobody is, and on the highway their action
    /// may change from tick to tick.
    #[serde(default)]
    pub has_cockpit: bool,
}

/// A highway, its own or a recorded one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HighwayRoad {
    /// The scene.
    pub scene: Scene,
    /// The CommonRoad file whose road and traffic take the place of the scene's own.
    #[serde(default)]
    pub recording: Option<PathBuf>,
    /// The recorded car that is the driver's; without it, the ego car starts where the planning problem says.
    #[serde(default)]
    pub seat: Option<i32>,
}

impl HighwayRoad {
    /// Builds the world.
    ///
    /// # Errors
    /// When the road cannot be built, or the recording is not what it was when the run was planned.
    pub fn world(&self) -> Result<World> {
        let mut scene = self.scene.clone();
        if let Some(file) = &self.recording {
            scene.course = Some(Arc::new(
                commonroad::Scenario::read(file)?.course(self.seat)?,
            ));
            scene.seat = self.seat;
        }
        World::new(Arc::new(scene)).context("the scene's road")
    }
}
