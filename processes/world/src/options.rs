//! What the launcher tells the world process: scene, recording, episodes, seed.

use anyhow::{Context, Result};
use domains::commonroad::Scenario;
use domains::highway::{Scene, World};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;

/// Options of the world process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Options {
    /// The scene.
    pub scene: Scene,
    /// Recorded traffic instead of the scene's own.
    #[serde(default)]
    pub recording: Option<Recording>,
    /// Episodes to drive.
    pub episodes: u32,
    /// Seed of everything that is drawn.
    pub seed: u64,
}

/// A CommonRoad scenario and the seat that the drive is seen from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recording {
    /// The scenario's file.
    pub file: PathBuf,
    /// The recorded car that is the driver's; without it, the ego car starts where the planning problem says.
    #[serde(default)]
    pub seat: Option<i32>,
}

impl Options {
    /// Builds the world.
    ///
    /// # Errors
    /// When the road cannot be built, or the scenario's file is not what it was when the run was planned.
    pub fn world(&self) -> Result<World> {
        build(&self.scene, self.recording.as_ref())
    }
}

/// Builds the world of a scene and, if there is one, a recording: also for the driver process, which has to know the
/// road and may replay a recorded person.
///
/// # Errors
/// As [`Options::world`].
pub fn build(scene: &Scene, recording: Option<&Recording>) -> Result<World> {
    let scene = Arc::new(scene.clone());
    let Some(Recording { file, seat }) = recording else {
        return World::new(scene).context("the scene's road");
    };
    let course = Arc::new(Scenario::read(file)?.course(*seat)?);
    match seat {
        None => Ok(World::with_course(scene, course)),
        Some(car) => World::seated(scene, course, *car)
            .with_context(|| format!("{}: car {car} has no recorded motion to drive by", file.display())),
    }
}
