//! Scene files of the gridworlds: which domain, which setting, and every number of it.

use std::path::Path;
use std::sync::Arc;

use serde::Deserialize;

use super::{Domain, Setting};
use crate::highway::FileError;
use crate::highway::file::{Check, parse, read};
use crate::{bomb_defusal, driving, search_rescue};

/// Scenes that ship with the project: name and contents.
pub(crate) const BUILTIN: [(&str, &str); 5] = [
    (
        "driving",
        include_str!("../../../../launch/scenes/driving.toml"),
    ),
    (
        "driving-fog",
        include_str!("../../../../launch/scenes/driving-fog.toml"),
    ),
    (
        "search",
        include_str!("../../../../launch/scenes/search.toml"),
    ),
    (
        "search-smoke",
        include_str!("../../../../launch/scenes/search-smoke.toml"),
    ),
    ("bomb", include_str!("../../../../launch/scenes/bomb.toml")),
];

/// `[communication]`: what it costs to show or say something. Both keys stand in the file where the table does: the domains
/// have different costs.
#[derive(Clone, Debug, PartialEq, serde::Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Communication {
    /// n visual items at once cost this times n².
    pub visual_cost: f64,
    /// n utterances at once cost this times n².
    pub verbal_cost: f64,
}

impl Communication {
    pub(crate) fn check(&self, check: &Check<'_>) -> Result<(), FileError> {
        check.range("communication.visual_cost", self.visual_cost, 0.0, 1000.0)?;
        check.range("communication.verbal_cost", self.verbal_cost, 0.0, 1000.0)
    }
}

table! {
    /// `[clock]`: how fast time passes where the world does not wait.
    pub struct Clock("clock") {
        /// Simulated seconds per second; a step is [`STEP_S`] of them.
        rate: f64 = 1.0, 0.001, 10_000.0;
    }
}

/// Simulated seconds of a step.
pub const STEP_S: f64 = 1.0;

table! {
    /// `[planning]`: the cross-entropy planner's settings, as in the highway's scenes.
    pub struct Planning("planning") {
        /// Steps that a candidate is imagined for (`--planner race`, as the next four): as long as a detour.
        race_steps: u32 = 12, 1, 64;
        /// Futures that every candidate lives through.
        race_first: u32 = 16, 2, 512;
        /// Futures that the last candidates live through, at most.
        race_futures: u32 = 128, 2, 512;
        /// A gain counts from so many standard errors on.
        race_certainty: f64 = 1.0, 0.0, 100.0;
        /// In real time, share of a step's length after which a decision stands.
        budget: f64 = 0.7, 0.05, 1.0;
        /// Decisions in the horizon.
        horizon: u32 = 4, 1, 100;
        /// Steps that each decision holds for.
        repeat: u32 = 1, 1, 100;
        /// Imagined futures.
        samples: u32 = 500, 2, 100_000;
        /// How many of them each candidate has: its value is their mean, since a person may guess right by luck.
        futures: u32 = 5, 1, 100_000;
        /// Iterations of the cross-entropy method.
        iterations: u32 = 6, 1, 100;
        /// Candidates that the next iteration learns from.
        elites: u32 = 20, 1, 100_000;
        /// Share of the elites' frequencies in the next probabilities.
        smoothing: f64 = 0.8, 0.0, 1.0;
        /// Probability of every bit before the first iteration.
        first_probability: f64 = 0.35, 0.0, 1.0;
        /// Share of the last plan, shifted by a step, in the first probabilities.
        warm_start: f64 = 0.75, 0.0, 1.0;
        /// A visual bit is set above this probability.
        visual_threshold: f64 = 0.5, 0.0, 1.0;
        /// A verbal bit is set above this probability.
        verbal_threshold: f64 = 0.5, 0.0, 1.0;
        /// γ.
        discount: f64 = 0.9, 0.0, 1.0;
        /// Weight of the task reward against the communication cost; the paper's 1.
        reward_weight: f64 = 1.0, 0.0, 1e6;
        /// Add the critic's value of the last imagined state: what the robot would get from there on by itself, which it would also
        /// get where nobody was told anything. The paper's objective has no such term.
        terminal_value: bool = false, false, true;
    }
}

impl Planning {
    /// Checks every value against its range; more elites than candidates are an error.
    pub(crate) fn check_all(&self, check: &Check<'_>) -> Result<(), FileError> {
        self.check(check)?;
        let candidates = self.samples / self.futures;
        let (elites, candidates) = (f64::from(self.elites), f64::from(candidates));
        check.range("planning.elites", elites, 1.0, candidates)
    }
}

/// A scene of any of the gridworlds. Clones share it. As JSON or the like it stands under its domain's name.
#[derive(Clone, Debug, PartialEq, serde::Serialize, Deserialize)]
#[serde(into = "Plain", from = "Plain")]
pub enum Scene {
    /// Gridworld driving.
    Driving(Arc<driving::Scene>),
    /// Search and rescue.
    SearchRescue(Arc<search_rescue::Scene>),
    /// Bomb defusal.
    BombDefusal(Arc<bomb_defusal::Scene>),
}

/// A scene that is not shared.
#[derive(serde::Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Plain {
    Driving(driving::Scene),
    SearchRescue(search_rescue::Scene),
    BombDefusal(bomb_defusal::Scene),
}

impl From<Plain> for Scene {
    fn from(plain: Plain) -> Self {
        match plain {
            Plain::Driving(scene) => Self::Driving(Arc::new(scene)),
            Plain::SearchRescue(scene) => Self::SearchRescue(Arc::new(scene)),
            Plain::BombDefusal(scene) => Self::BombDefusal(Arc::new(scene)),
        }
    }
}

impl From<Scene> for Plain {
    fn from(scene: Scene) -> Self {
        match scene {
            Scene::Driving(scene) => Self::Driving(Arc::unwrap_or_clone(scene)),
            Scene::SearchRescue(scene) => Self::SearchRescue(Arc::unwrap_or_clone(scene)),
            Scene::BombDefusal(scene) => Self::BombDefusal(Arc::unwrap_or_clone(scene)),
        }
    }
}

/// What tells a gridworld's scene file from a highway's.
#[derive(Deserialize)]
struct Head {
    domain: Option<toml::Value>,
}

/// The key that tells which domain a scene file is of.
#[derive(Deserialize)]
struct DomainKey {
    domain: Domain,
}

/// Evaluates an expression for whichever scene it is.
macro_rules! each {
    ($value:expr, $scene:ident => $call:expr) => {
        match $value {
            Scene::Driving($scene) => $call,
            Scene::SearchRescue($scene) => $call,
            Scene::BombDefusal($scene) => $call,
        }
    };
}

impl Scene {
    /// Names of the scenes that ship with the project.
    pub fn names() -> impl Iterator<Item = &'static str> {
        BUILTIN.iter().map(|(name, _)| *name)
    }

    /// A scene that ships with the project.
    ///
    /// # Errors
    /// When there is none of that name.
    pub fn builtin(name: &str) -> Result<Self, FileError> {
        let (name, text) = BUILTIN
            .iter()
            .find(|(known, _)| *known == name)
            .ok_or_else(|| FileError::Unknown {
                name: name.to_owned(),
            })?;
        Self::from_toml(Path::new(&format!("{name}.toml")), text)
    }

    /// The default scene of a domain in a setting.
    pub fn of(domain: Domain, setting: Setting) -> Self {
        let scene = match domain {
            Domain::Driving => Self::Driving(Arc::default()),
            Domain::SearchRescue => Self::SearchRescue(Arc::default()),
            Domain::BombDefusal => Self::BombDefusal(Arc::default()),
        };
        scene.in_setting(setting)
    }

    /// The same scene in a setting of the caller's choice.
    pub fn in_setting(mut self, setting: Setting) -> Self {
        each!(&mut self, scene => Arc::make_mut(scene).setting = setting);
        self
    }

    /// Whether a file's text has the key `domain`: the highway's scenes have none.
    ///
    /// # Errors
    /// When it is not TOML.
    pub fn is_discrete(file: &Path, text: &str) -> Result<bool, FileError> {
        Ok(parse::<Head>(file, text)?.domain.is_some())
    }

    /// Reads a scene file.
    ///
    /// # Errors
    /// When it cannot be read, is not a gridworld's scene, or holds a value outside its range.
    pub fn load(file: &Path) -> Result<Self, FileError> {
        Self::from_toml(file, &read(file)?)
    }

    /// Reads a scene from text; `file` is only named in errors.
    ///
    /// # Errors
    /// As [`Scene::load`].
    pub fn from_toml(file: &Path, text: &str) -> Result<Self, FileError> {
        let scene = match parse::<DomainKey>(file, text)?.domain {
            Domain::Driving => Self::Driving(Arc::new(parse(file, text)?)),
            Domain::SearchRescue => Self::SearchRescue(Arc::new(parse(file, text)?)),
            Domain::BombDefusal => Self::BombDefusal(Arc::new(parse(file, text)?)),
        };
        scene.check(file)?;
        Ok(scene)
    }

    /// Checks every value against its range.
    ///
    /// # Errors
    /// Names the first value outside its range.
    pub fn check(&self, file: &Path) -> Result<(), FileError> {
        each!(self, scene => scene.check(file))
    }

    /// What the scene is called in summaries.
    pub fn name(&self) -> &str {
        each!(self, scene => &scene.name)
    }

    /// Its domain.
    pub fn domain(&self) -> Domain {
        each!(self, scene => scene.domain)
    }

    /// Its setting.
    pub fn setting(&self) -> Setting {
        each!(self, scene => scene.setting)
    }

    /// The planner's settings.
    pub fn planning(&self) -> &Planning {
        each!(self, scene => &scene.planning)
    }

    /// Nanoseconds of a step where the world does not wait.
    pub fn step_ns(&self) -> u64 {
        let rate = each!(self, scene => scene.clock.rate);
        (1e9 * STEP_S / rate) as u64
    }

    /// Steps after which time is up.
    pub fn max_steps(&self) -> u32 {
        each!(self, scene => scene.episode.max_steps)
    }

    /// The sentences whose vectors a world of this scene needs; none for driving, whose words are symbols.
    pub fn sentences(&self) -> &'static [&'static str] {
        match self {
            Self::Driving(_) => &[],
            Self::SearchRescue(_) => &search_rescue::SENTENCES,
            Self::BombDefusal(_) => &bomb_defusal::SENTENCES,
        }
    }
}
