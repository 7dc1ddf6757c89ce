//! Where a run takes place: the highway or a gridworld; and what depends on it: who acts there, which self-model the
//! robot has, and how it plans.

use crate::inputs;
use anyhow::{Context, Result, bail, ensure};
use domains::Layout;
use domains::commonroad;
use domains::discrete;
use domains::highway::Scene;
use domains::highway::speech::SECTOR_NAMES;
use driver::{Acting, Driving};
use models::SelfModel;
use planning::Settings;
use scenario::Scenario;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use world::HighwayRoad;

/// A scene, and where it came from.
#[derive(Clone, Debug)]
pub struct NamedScene {
    /// Where.
    pub scenario: RunScenario,
    /// Its name, for people.
    pub name: String,
}

/// A scene of some domain: the highway's, with the fog that was asked for; or a gridworld's, and what its numbers mean.
pub type RunScenario = Scenario<HighwayRoad, (discrete::Scene, Arc<Layout>)>;

/// Who acts.
pub type Who = Scenario<Driving, Acting>;

/// Who acts, with a name for people.
#[derive(Clone, Debug)]
pub struct NamedPerson {
    /// Who.
    pub who: Who,
    /// As on the command line.
    pub name: String,
    /// Whether a person at a page in a browser acts, for whom [`NamedPerson::who`] stands in where something has to be
    /// known in advance.
    pub has_cockpit: bool,
}

/// `--driver` for a person at a page in a browser.
pub const BROWSER: &str = "browser";
/// Who stands in for them.
const STAND_IN: &str = "sim:1";

/// The person of the command line, or who stands in for them.
fn simulated(person: &str) -> &str {
    match person {
        BROWSER => STAND_IN,
        person => person,
    }
}

/// What the items that can be communicated are called.
#[derive(Clone, Copy, Debug)]
pub struct ItemNames {
    /// What can be shown.
    pub visual: &'static [&'static str],
    /// What can be said something about.
    pub verbal: &'static [&'static str],
    /// What they are called together.
    pub word: &'static str,
}

impl ItemNames {
    /// The highway's sectors.
    pub const SECTORS: Self = Self {
        visual: &SECTOR_NAMES,
        verbal: &SECTOR_NAMES,
        word: "sectors",
    };

    /// A gridworld's.
    pub fn of(layout: &Layout) -> Self {
        Self {
            visual: layout.region_names,
            verbal: layout.utterance_names,
            word: "items",
        }
    }
}

/// Names of the scenes that ship: the highway's, the recorded one, then the gridworlds'.
pub fn shipped_scenes() -> impl Iterator<Item = &'static str> {
    Scene::names()
        .chain(commonroad::shipped::names())
        .chain(discrete::Scene::names())
}

impl NamedScene {
    /// The gridworld's scene, if it is one.
    pub fn gridworld(&self) -> Option<&discrete::Scene> {
        match &self.scenario {
            Scenario::Highway(_) => None,
            Scenario::Gridworld((scene, _)) => Some(scene),
        }
    }

    /// Simulated seconds of a step.
    pub fn step_s(&self) -> f64 {
        match &self.scenario {
            Scenario::Highway(road) => road.scene.step_s(),
            Scenario::Gridworld(_) => discrete::STEP_S,
        }
    }

    /// Nanoseconds of a step in real time.
    pub fn step_ns(&self) -> u64 {
        match &self.scenario {
            Scenario::Highway(HighwayRoad { scene, .. }) => {
                (1e9 * scene.step_s() / scene.clock.rate) as u64
            }
            Scenario::Gridworld((scene, _)) => scene.step_ns(),
        }
    }

    /// What the reader of a recorded scene passed over, in words.
    pub fn notes(&self) -> &[String] {
        match &self.scenario {
            Scenario::Highway(road) => {
                let course = road.scene.course.as_ref();
                course.map_or(&[], |course| &course.notes)
            }
            Scenario::Gridworld(_) => &[],
        }
    }

    /// What can be communicated.
    pub fn items(&self) -> ItemNames {
        match &self.scenario {
            Scenario::Highway(_) => ItemNames::SECTORS,
            Scenario::Gridworld((_, layout)) => ItemNames::of(layout),
        }
    }
}

/// Reads a scene by name or file, and who acts in it.
///
/// # Errors
/// Names the option, or the file and the place in it.
pub fn scene(text: &str, fog_m: Option<f64>, person: &str) -> Result<(NamedScene, NamedPerson)> {
    let scene = match gridworld_scene(text)? {
        None => {
            let driving = inputs::driver(simulated(person))?;
            highway_scene(text, fog_m, &driving)?
        }
        Some(scene) => {
            ensure!(
                fog_m.is_none(),
                "--fog is for the highway; the scene file of a gridworld says how far people see"
            );
            let layout = models::words::layout_of(&scene)?;
            NamedScene {
                name: scene.name().to_owned(),
                scenario: Scenario::Gridworld((scene, layout)),
            }
        }
    };
    let person = who(person, &scene)?;
    Ok((scene, person))
}

/// The gridworld's scene of that name or file, if it is one's.
///
/// # Errors
/// Names the file and the place in it.
pub fn gridworld_scene(text: &str) -> Result<Option<discrete::Scene>> {
    let path = Path::new(text);
    if path.extension().is_none() && !path.exists() {
        return Ok(match discrete::Scene::names().any(|name| name == text) {
            true => Some(discrete::Scene::builtin(text).context("--scene")?),
            false => None,
        });
    }
    if path
        .extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("xml"))
    {
        return Ok(None);
    }
    // What cannot be read at all, the highway's reader says.
    let Ok(contents) = std::fs::read_to_string(path) else {
        return Ok(None);
    };
    match discrete::Scene::is_discrete(path, &contents)? {
        true => Ok(Some(discrete::Scene::from_toml(path, &contents)?)),
        false => Ok(None),
    }
}

/// Reads who acts in a scene: `sim:ID`, `sim:FILE`, `browser` or, on the highway, `recorded:ID`.
///
/// # Errors
/// Names the option, or the file and the place in it.
pub fn who(named: &str, scene: &NamedScene) -> Result<NamedPerson> {
    let text = simulated(named);
    let who = match &scene.scenario {
        Scenario::Highway(_) => Scenario::Highway(inputs::driver(text)?),
        Scenario::Gridworld((scene, _)) => {
            let Some(("sim", person)) = text.split_once(':') else {
                bail!("--driver {text}: expected sim:ID, sim:FILE.toml or browser in a gridworld");
            };
            let acting = acting(person).with_context(|| format!("--driver {text}"))?;
            let seat = driver::GridworldSeat {
                scene: scene.clone(),
                person: acting,
            };
            seat.simulated()
                .with_context(|| format!("--driver {text}"))?;
            Scenario::Gridworld(seat.person)
        }
    };
    Ok(NamedPerson {
        who,
        name: named.to_owned(),
        has_cockpit: named == BROWSER,
    })
}

fn acting(person: &str) -> Result<Acting> {
    if !person.is_empty() && person.bytes().all(|byte| byte.is_ascii_digit()) {
        return Ok(Acting::Shipped(person.parse().context("not a number")?));
    }
    Ok(Acting::File(std::path::absolute(person)?))
}

/// Reads a scene of the highway by name or file.
fn highway_scene(text: &str, fog_m: Option<f64>, driving: &Driving) -> Result<NamedScene> {
    if let Some(fog_m) = fog_m {
        ensure!(
            (0.0..=1000.0).contains(&fog_m),
            "--fog {fog_m}: expected 0 to 1000 metres"
        );
    }
    let seat = match driving {
        Driving::Simulated(_) => None,
        Driving::Recorded(car) => Some(*car),
    };
    let shipped = match Path::new(text).exists() {
        true => None,
        false => commonroad::shipped::path(text),
    };
    let path = shipped.as_deref().unwrap_or(Path::new(text));
    let extension = path
        .extension()
        .and_then(|extension| extension.to_str())
        .unwrap_or_default();
    if extension.eq_ignore_ascii_case("xml") {
        let mut scene = commonroad::Scenario::read(path)?.scene(fog_m, seat)?;
        if shipped.is_some() {
            text.clone_into(&mut scene.name);
        }
        scene.check(path)?;
        return Ok(NamedScene {
            name: scene.name.clone(),
            scenario: highway(scene, Some(path.to_owned())),
        });
    }
    if let Some(car) = seat {
        bail!(
            "--driver recorded:{car}: only a CommonRoad scenario has recorded drivers, and --scene {text} is none"
        );
    }
    let mut scene = match extension {
        "" if !path.exists() => Scene::builtin(text).context("--scene")?,
        _ => Scene::load(path)?,
    };
    if let Some(fog_m) = fog_m {
        scene.set_fog_m(fog_m);
    }
    Ok(NamedScene {
        name: scene.name.clone(),
        scenario: highway(scene, None),
    })
}

fn highway(scene: Scene, recording: Option<PathBuf>) -> RunScenario {
    Scenario::Highway(HighwayRoad {
        seat: scene.seat,
        scene,
        recording,
    })
}

/// The planner's settings: the scene's.
///
/// # Errors
/// Names the scene's key that the planner cannot use.
pub fn settings(scene: &NamedScene) -> Result<Settings> {
    let settings = match &scene.scenario {
        Scenario::Highway(road) => highway_settings(&road.scene, &scene.name)?,
        Scenario::Gridworld((scene, _)) => planning::items::settings_of(scene.planning()),
    };
    match settings.problem() {
        Some(problem) => bail!("{}: [planning]: {problem}", scene.name),
        None => Ok(settings),
    }
}

fn highway_settings(scene: &Scene, name: &str) -> Result<Settings> {
    let power = scene.communication.verbal_power;
    ensure!(
        power == 3.0,
        "{}: communication.verbal_power is {power}: the planner knows only 3",
        name
    );
    Ok(planning::items::highway_settings_of(scene))
}

/// The robot's self-model for a scene: the given file or the one that ships.
///
/// # Errors
/// Names the file and what is wrong with it.
pub fn self_model(
    given: Option<&Path>,
    scenario: &RunScenario,
) -> Result<(PathBuf, Arc<SelfModel>)> {
    let domain = match scenario {
        Scenario::Highway(_) => None,
        Scenario::Gridworld((scene, _)) => Some(scene.domain()),
    };
    inputs::self_model(domain, given)
}
