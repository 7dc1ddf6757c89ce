//! The drivers of a folder of CommonRoad files, each seen from their own seat; and who is left out.

use anyhow::{Context, ensure};
use domains::commonroad::{RecordedSeat, Scenario};
use domains::highway::{EGO_SPEED_MPS, Scene};
use serde::Serialize;
use std::path::{Path, PathBuf};
use training::environment::visual_of;
use training::rounds::Round;

/// Who is left out: drivers who give too little to learn from or to be measured on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Rule {
    /// Fewest control steps (0.15 s each).
    pub steps: usize,
    /// Least distance driven in them, in metres.
    pub distance_m: f32,
    /// Largest share of actions that the ego car's limits cut.
    pub clamped: f32,
}

impl Default for Rule {
    fn default() -> Self {
        Self {
            steps: 15,
            distance_m: 20.0,
            clamped: 0.1,
        }
    }
}

impl Rule {
    /// As a sentence.
    pub fn words(&self) -> String {
        format!(
            "A driver is left out with fewer than {} control steps, less than {} m driven in them, or more than {:.0} % of actions beyond what the ego car's pedals and wheel can do.",
            self.steps,
            self.distance_m,
            100.0 * self.clamped
        )
    }
}

/// A recorded driver.
#[derive(Clone, Debug)]
pub struct Driver {
    /// File and car.
    pub name: String,
    /// The drive, as sensed from their seat.
    pub round: Round,
}

/// The drivers of a folder.
#[derive(Clone, Debug, Default)]
pub struct Drivers {
    /// Kept, in the order of files and cars.
    pub kept: Vec<Driver>,
    /// Left out, with the reason.
    pub left_out: Vec<(String, String)>,
}

/// Reads a CommonRoad file (`.xml`, or one that ships), or every one of a folder, and sits down in every moving
/// vehicle.
///
/// # Errors
/// If the one file or the folder cannot be read, or the folder holds no such file. Files of a folder that cannot be
/// read are left out, with the reason.
pub fn read_drivers(data: &Path, rule: &Rule) -> anyhow::Result<Drivers> {
    let is_xml = |path: &Path| {
        path.extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("xml"))
    };
    let is_file = is_xml(data) && !data.is_dir();
    let mut files: Vec<PathBuf> = match is_file {
        true => vec![data.to_owned()],
        false => std::fs::read_dir(data)
            .with_context(|| data.display().to_string())?
            .filter_map(|entry| Some(entry.ok()?.path()))
            .filter(|path| is_xml(path))
            .collect(),
    };
    files.sort();
    ensure!(
        !files.is_empty(),
        "{}: no CommonRoad file (.xml) in this folder",
        data.display()
    );
    let mut drivers = Drivers::default();
    // Results are read elsewhere: they name files, not where these lay.
    let place = format!("{}/", data.display());
    for file in files {
        let stem = file
            .file_stem()
            .map_or_else(String::new, |s| s.to_string_lossy().into_owned());
        match Scenario::read(&file) {
            Err(error) if is_file => return Err(error.into()),
            Err(error) => {
                let reason = error.to_string().replace(&place, "");
                drivers.left_out.push((stem, reason));
            }
            Ok(scenario) => {
                for obstacle in scenario.obstacles.iter().filter(|o| o.moving) {
                    let name = format!("{stem}:{}", obstacle.id);
                    match drive(&scenario, obstacle.id, &obstacle.kind, rule) {
                        Ok(round) => drivers.kept.push(Driver { name, round }),
                        Err(reason) => drivers.left_out.push((name, reason.replace(&place, ""))),
                    }
                }
            }
        }
    }
    Ok(drivers)
}

/// One driver's drive, or why it is left out.
fn drive(scenario: &Scenario, id: i32, kind: &str, rule: &Rule) -> Result<Round, String> {
    if matches!(kind, "pedestrian" | "bicycle" | "train") {
        return Err(format!("a {kind}"));
    }
    let seat = RecordedSeat::new(scenario, id).map_err(|e| e.to_string())?;
    let step_s = Scene::default().step_s() as f32;
    let (mut round, mut distance_m, mut clamped) = (Round::default(), 0.0, 0);
    for (observation, action) in seat {
        distance_m += observation.ego[1] * EGO_SPEED_MPS * step_s;
        clamped += usize::from(action.iter().any(|value| value.abs() >= 1.0));
        round.visual.extend(visual_of(&observation));
        round.action.extend(action);
        round.reward.push(0.0);
    }
    let steps = round.len();
    if steps < rule.steps {
        return Err(format!("{steps} control steps"));
    }
    if distance_m < rule.distance_m {
        return Err(format!("{distance_m:.0} m driven"));
    }
    if clamped as f32 > rule.clamped * steps as f32 {
        return Err(format!("{clamped} of {steps} actions cut"));
    }
    Ok(round)
}
