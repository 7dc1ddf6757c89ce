//! `mirror scenes`: the scenes that ship, and how far people see in each.

use crate::cli::{DEFAULT_SCENE, ListArguments};
use crate::columns;
use crate::console::out;
use crate::failure::Failure;
use crate::place;
use anyhow::{Context, Result};
use domains::discrete::{self, Setting};
use domains::highway;
use scenario::Scenario;
use serde::Serialize;
use std::process::ExitCode;

/// A scene that ships.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Row {
    /// For `--scene`.
    name: &'static str,
    /// The domain, as `--domain` has it.
    domain: &'static str,
    /// What it is.
    about: String,
    /// How far people see in it, in words.
    sight: String,
    /// What hides things from everybody in it; nothing where the air is clear, or only chance hides them.
    limits: Option<Limits>,
    /// Simulated seconds of a step.
    step_s: f64,
    /// Steps after which a round ends, whatever has become of it.
    max_steps: u32,
}

/// How far average eyes see.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(untagged)]
enum Limits {
    /// Fog on the highway.
    Fog {
        front_m: f64,
        side_m: f64,
        rear_m: f64,
    },
    /// Fog in gridworld driving.
    Cells { ahead_cells: f64, behind_cells: f64 },
    /// Smoke in search and rescue.
    Smoke { radius_cells: f64 },
}

impl Limits {
    fn words(&self) -> String {
        match self {
            Self::Fog {
                front_m,
                side_m,
                rear_m,
            } => {
                format!("fog: {front_m} m ahead, {side_m} m to the side, {rear_m} m behind")
            }
            Self::Cells {
                ahead_cells,
                behind_cells,
            } => format!("fog: {ahead_cells} cells ahead, {behind_cells} behind"),
            Self::Smoke { radius_cells } => {
                format!("smoke: {radius_cells} cells around, and nothing is heard")
            }
        }
    }
}

/// `mirror scenes`.
pub fn scenes(arguments: &ListArguments) -> Result<ExitCode, Failure> {
    let rows = place::shipped_scenes()
        .map(row)
        .collect::<Result<Vec<_>>>()?;
    if arguments.json {
        out!(
            "{}",
            serde_json::to_string_pretty(&rows).context("scenes as JSON")?
        );
        return Ok(ExitCode::SUCCESS);
    }
    let cells: Vec<Vec<String>> = rows
        .iter()
        .map(|row| {
            let Row {
                name,
                domain,
                about,
                sight,
                ..
            } = row.clone();
            vec![name.to_owned(), domain.to_owned(), about, sight]
        })
        .collect();
    for line in columns::lines(
        &["scene", "domain", "what it is", "what people see"],
        &cells,
    ) {
        out!("{line}");
    }
    Ok(ExitCode::SUCCESS)
}

fn row(name: &'static str) -> Result<Row> {
    // Who drives makes no difference to what is said of a scene.
    let (scene, _) = place::scene(name, None, "sim:1")?;
    let step_s = scene.step_s();
    let row = match &scene.scenario {
        Scenario::Highway(road) => {
            let highway = &road.scene;
            let limits = highway.fog.map(|fog| Limits::Fog {
                front_m: fog.front_m,
                side_m: fog.side_m,
                rear_m: fog.rear_m,
            });
            Row {
                name,
                domain: "highway",
                about: about_highway(highway)?,
                sight: limits.map_or_else(
                    || "clear weather: as far as the LIDAR ahead, mirrors behind".to_owned(),
                    |limits| limits.words(),
                ),
                limits,
                step_s,
                max_steps: highway.episode.max_steps,
            }
        }
        Scenario::Gridworld((scene, _)) => {
            let limits = limits_of(scene);
            Row {
                name,
                domain: scene.domain().name(),
                about: about_gridworld(scene),
                sight: match (limits, scene) {
                    (Some(limits), _) => limits.words(),
                    (None, discrete::Scene::BombDefusal(_)) => {
                        "a terminal when they notice it".to_owned()
                    }
                    (None, _) => "everything".to_owned(),
                },
                limits,
                step_s,
                max_steps: scene.max_steps(),
            }
        }
    };
    Ok(match name == DEFAULT_SCENE {
        true => Row {
            about: format!("{} (the default)", row.about),
            ..row
        },
        false => row,
    })
}

fn about_highway(scene: &highway::Scene) -> Result<String> {
    if let Some(course) = &scene.course {
        return Ok(format!(
            "{} lanes with {} recorded cars, {:.0} s; --driver recorded:ID is one of {}",
            course.road.lanes().len(),
            course.traffic.len(),
            course.duration_s,
            numbers(&course.traffic.iter().map(|car| car.id).collect::<Vec<_>>())
        ));
    }
    let road = scene.road.build().context("the scene's road")?;
    Ok(format!(
        "{} lanes, {:.0} m; a car that slows down ahead or rushes up from behind, {} cases",
        road.lanes().len(),
        road.length_m(),
        highway::Case::ALL.len()
    ))
}

/// `1 to 5` where nothing is missing in between, `1, 2, 7` otherwise.
fn numbers(ids: &[i32]) -> String {
    match ids {
        [first, .., last] if (last - first) as usize == ids.len() - 1 => {
            format!("{first} to {last}")
        }
        _ => {
            let ids: Vec<String> = ids.iter().map(i32::to_string).collect();
            ids.join(", ")
        }
    }
}

fn about_gridworld(scene: &discrete::Scene) -> String {
    let steps = scene.max_steps();
    match scene {
        discrete::Scene::Driving(_) => {
            format!("two lanes, four cars, one of them dangerous; {steps} steps")
        }
        discrete::Scene::SearchRescue(_) => {
            format!("find the victim in a burning house and bring them out; at most {steps} steps")
        }
        discrete::Scene::BombDefusal(scene) => {
            let rules = match scene.setting {
                Setting::Original => "the rules that the robot knows",
                Setting::Transfer => "newer rules than the robot's",
            };
            format!("three buttons by {rules}, in at most {steps} steps")
        }
    }
}

fn limits_of(scene: &discrete::Scene) -> Option<Limits> {
    if scene.setting() == Setting::Original {
        return None;
    }
    match scene {
        discrete::Scene::Driving(scene) => Some(Limits::Cells {
            ahead_cells: scene.fog.ahead_cells,
            behind_cells: scene.fog.behind_cells,
        }),
        discrete::Scene::SearchRescue(scene) => Some(Limits::Smoke {
            radius_cells: scene.smoke.radius_cells,
        }),
        discrete::Scene::BombDefusal(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_scene_that_ships_is_listed_once_with_its_sight() {
        let rows: Vec<Row> = place::shipped_scenes()
            .map(|name| row(name).unwrap())
            .collect();
        let mut names: Vec<&str> = rows.iter().map(|row| row.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), rows.len());
        let of = |name: &str| rows.iter().find(|row| row.name == name).unwrap();
        assert_eq!(
            of("highway-fog").limits,
            Some(Limits::Fog {
                front_m: 15.0,
                side_m: 8.0,
                rear_m: 3.0
            })
        );
        assert_eq!(of("highway-clear").limits, None);
        assert_eq!(of("driving-fog").sight, "fog: 2 cells ahead, 0 behind");
        assert_eq!(of("search").sight, "everything");
        for row in &rows {
            assert!(row.step_s > 0.0 && row.max_steps > 0, "{row:?}");
        }
    }

    #[test]
    fn cars_are_named_by_the_shortest_list() {
        assert_eq!(numbers(&[3, 4, 5]), "3 to 5");
        assert_eq!(numbers(&[3, 5]), "3, 5");
        assert_eq!(numbers(&[3]), "3");
    }
}
