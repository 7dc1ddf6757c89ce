//! Scene files: every number of the highway, with its default: the paper's appendix "CARLA" and, where it is silent, the authors' scripts.

mod traffic;

use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

pub use super::file::FileError;
use super::file::{Check, parse, read};
use super::fog::Fog;
use super::road::{Road, RoadError, Segment};
use super::traffic::Course;

pub use traffic::{CaseOrder, ExtraCar, Traffic};

/// Scenes that ship with the project: name and contents.
pub(super) const BUILTIN: [(&str, &str); 2] = [
    (
        "highway-fog",
        include_str!("../../../../launch/scenes/highway-fog.toml"),
    ),
    (
        "highway-clear",
        include_str!("../../../../launch/scenes/highway-clear.toml"),
    ),
];

/// `[road]`: by default CARLA Town04's road 22.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RoadSpec {
    /// Lines and arcs of the road's middle.
    pub segments: Vec<Segment>,
    /// Number of driving lanes.
    pub lanes: usize,
    /// Width of each.
    pub lane_width_m: f64,
    /// Width of the left shoulder, beyond which is the road's edge.
    pub left_shoulder_m: f64,
    /// Width of the right shoulder.
    pub right_shoulder_m: f64,
}

impl Default for RoadSpec {
    fn default() -> Self {
        let arc = |length_m, curvature_per_m| Segment {
            length_m,
            curvature_per_m,
        };
        Self {
            segments: vec![
                arc(17.5, 0.0),
                arc(137.2, -0.003485),
                arc(45.8, 0.0),
                arc(48.3, 0.002),
                arc(54.5, 0.0),
                arc(81.4, 0.004028),
                arc(79.0, 0.008459),
                arc(4.5, 0.0),
            ],
            lanes: 2,
            lane_width_m: 3.5,
            left_shoulder_m: 2.7,
            right_shoulder_m: 3.2,
        }
    }
}

impl RoadSpec {
    /// Builds the road.
    ///
    /// # Errors
    /// See [`Road::from_segments`].
    pub fn build(&self) -> Result<Road, RoadError> {
        let (left, right) = (self.left_shoulder_m, self.right_shoulder_m);
        Road::from_segments(&self.segments, self.lanes, self.lane_width_m, left, right)
    }
}

table! {
    /// `[ego]`: the person's car, a kinematic bicycle of passenger-car size.
    pub struct Ego("ego") {
        /// Where it starts.
        start_s_m: f64 = 30.0, 0.0, 1e5;
        /// Length of the box.
        length_m: f64 = 4.7, 2.0, 20.0;
        /// Width of the box.
        width_m: f64 = 1.85, 1.0, 3.0;
        /// Distance between the axles.
        wheelbase_m: f64 = 2.85, 1.0, 15.0;
        /// Acceleration at full throttle.
        acceleration_mps2: f64 = 3.5, 0.1, 20.0;
        /// Deceleration at full brake.
        brake_mps2: f64 = 8.0, 0.1, 20.0;
        /// Deceleration without pedals at 10 m/s, growing linearly with speed.
        drag_mps2: f64 = 0.3, 0.0, 5.0;
        /// Throttle has no effect above this speed.
        throttle_limit_kmh: f64 = 37.0, 1.0, 300.0;
        /// Wheel angle at full steer.
        steer_deg: f64 = 20.0, 1.0, 60.0;
        /// How fast the wheels turn.
        steer_rate_deg_s: f64 = 60.0, 1.0, 1000.0;
        /// Tyres give no more sideways acceleration than this.
        lateral_limit_mps2: f64 = 7.0, 0.5, 20.0;
    }
}

table! {
    /// `[reward]`: the terms of the paper's appendix, with weights of our own.
    pub struct Reward("reward") {
        /// v_max of r^speed.
        top_speed_kmh: f64 = 40.0, 1.0, 300.0;
        /// Penalty for full brake.
        brake: f64 = 0.3, 0.0, 1000.0;
        /// Penalty for full steer.
        steer: f64 = 0.1, 0.0, 1000.0;
        /// Penalty for a lane change.
        change: f64 = 1.0, 0.0, 1000.0;
        /// Penalty for driving on the lane's edge.
        center: f64 = 1.0, 0.0, 1000.0;
        /// Penalty for a car within `far_m` straight ahead or behind.
        proximity_far: f64 = 2.0, 0.0, 1000.0;
        /// See `proximity_far`.
        far_m: f64 = 20.0, 0.0, 40.0;
        /// Penalty for a car within `near_m` in any beam.
        proximity_near: f64 = 4.0, 0.0, 1000.0;
        /// See `proximity_near`.
        near_m: f64 = 1.6, 0.0, 40.0;
        /// Penalty for driving on the shoulder.
        road: f64 = 4.0, 0.0, 1000.0;
        /// Penalty for a collision.
        collision: f64 = 10.0, 0.0, 1000.0;
    }
}

table! {
    /// `[communication]`: what it costs to say something, and how often one can.
    pub struct Communication("communication") {
        /// Cost of each azimuth highlighted.
        visual_cost: f64 = 0.02, 0.0, 1000.0;
        /// Cost of n utterances at once is this times n to the power below.
        verbal_cost: f64 = 0.4, 0.0, 1000.0;
        /// See `verbal_cost`.
        verbal_power: f64 = 3.0, 0.0, 10.0;
        /// Least time between the starts of two utterances.
        speech_interval_s: f64 = 3.5, 0.0, 1000.0;
    }
}

table! {
    /// `[planning]`: the planners' settings, `race_…` and `budget` of `--planner race`, the others of `--planner ce` but for
    /// `repeat`, `discount` and `reward_weight`, which are both planners'.
    pub struct Planning("planning") {
        /// Control steps that a candidate is imagined for.
        race_steps: u32 = 24, 1, 64;
        /// Futures that every candidate lives through.
        race_first: u32 = 8, 2, 512;
        /// Futures that the last candidates live through, at most.
        race_futures: u32 = 64, 2, 512;
        /// A gain counts from so many standard errors on.
        race_certainty: f64 = 1.0, 0.0, 100.0;
        /// In real time, share of a step's length after which a decision stands.
        budget: f64 = 0.7, 0.05, 1.0;
        /// Decisions in the horizon.
        horizon: u32 = 4, 1, 100;
        /// Control steps that each decision holds for.
        repeat: u32 = 2, 1, 100;
        /// Imagined futures.
        samples: u32 = 1000, 2, 100_000;
        /// How many of them each candidate has: its value is their mean.
        futures: u32 = 5, 1, 100_000;
        /// Iterations of the cross-entropy method.
        iterations: u32 = 3, 1, 100;
        /// Candidates that the next iteration learns from.
        elites: u32 = 40, 1, 100_000;
        /// Share of the elites' frequencies in the next probabilities.
        smoothing: f64 = 0.8, 0.0, 1.0;
        /// Probability of every bit before the first iteration.
        first_probability: f64 = 0.35, 0.0, 1.0;
        /// Share of the last plan, shifted by a step, in the first probabilities.
        warm_start: f64 = 0.75, 0.0, 1.0;
        /// A visual bit is set above this probability.
        visual_threshold: f64 = 0.15, 0.0, 1.0;
        /// A verbal bit is set above this probability.
        verbal_threshold: f64 = 0.3, 0.0, 1.0;
        /// γ.
        discount: f64 = 0.9, 0.0, 1.0;
        /// Weight of the task reward against the communication cost.
        reward_weight: f64 = 10.0, 0.0, 1e6;
    }
}

table! {
    /// `[episode]`: when a round ends.
    pub struct Episode("episode") {
        /// Control steps after which time is up.
        max_steps: u32 = 250, 1, 1_000_000;
        /// Where the goal line is.
        goal_s_m: f64 = 360.0, 0.0, 1e6;
    }
}

table! {
    /// `[clock]`: how fast time runs.
    pub struct Clock("clock") {
        /// Physics ticks a second.
        tick_hz: f64 = 20.0, 1.0, 1000.0;
        /// Physics ticks in a control step.
        ticks_per_step: u32 = 3, 1, 100;
        /// In the real-time clock, how many simulated seconds pass in a second.
        rate: f64 = 1.0, 0.01, 100.0;
    }
}

/// `[fog]`: how far a person with average eyes sees.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FogSpec {
    /// Straight ahead.
    pub front_m: f64,
    /// To either side.
    pub side_m: f64,
    /// Straight behind, by mirror.
    pub rear_m: f64,
}

/// A highway scene. Keys left out of a file have the values of [`Scene::default`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Scene {
    /// What the scene is called in summaries.
    pub name: String,
    /// See [`RoadSpec`].
    pub road: RoadSpec,
    /// See [`Ego`].
    pub ego: Ego,
    /// See [`Traffic`].
    pub traffic: Traffic,
    /// See [`FogSpec`]; clear weather without it.
    pub fog: Option<FogSpec>,
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
    /// Road and traffic of a recording, in place of `road`, `traffic` and `ego.start_s_m`; see
    /// [`Scene::from_commonroad`].
    #[serde(skip)]
    pub course: Option<Arc<Course>>,
    /// The recorded car in whose seat the driver sits; the planning problem's car without it.
    #[serde(skip)]
    pub seat: Option<i32>,
}

impl Default for Scene {
    fn default() -> Self {
        Self {
            name: "highway-clear".to_owned(),
            road: RoadSpec::default(),
            ego: Ego::default(),
            traffic: Traffic::default(),
            fog: None,
            reward: Reward::default(),
            communication: Communication::default(),
            planning: Planning::default(),
            episode: Episode::default(),
            clock: Clock::default(),
            course: None,
            seat: None,
        }
    }
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

    /// Reads a scene file: a CommonRoad scenario if it is called `….xml`, TOML otherwise.
    ///
    /// # Errors
    /// When it cannot be read, is not a scene, or holds a value outside its range.
    pub fn load(file: &Path) -> Result<Self, FileError> {
        if file
            .extension()
            .is_some_and(|extension| extension.eq_ignore_ascii_case("xml"))
        {
            return Ok(Self::from_commonroad(file, None, None)?);
        }
        Self::from_toml(file, &read(file)?)
    }

    /// Reads a scene from text; `file` is only named in errors.
    ///
    /// # Errors
    /// As [`Scene::load`].
    pub fn from_toml(file: &Path, text: &str) -> Result<Self, FileError> {
        let scene: Self = parse(file, text)?;
        scene.check(file)?;
        Ok(scene)
    }

    /// Checks every value against its range.
    ///
    /// # Errors
    /// Names the first value outside its range.
    pub fn check(&self, file: &Path) -> Result<(), FileError> {
        let check = Check { file };
        let road = self.road.build().map_err(|source| FileError::Road {
            file: file.to_owned(),
            source,
        })?;
        check.range("road.lanes", self.road.lanes as f64, 2.0, 12.0)?;
        self.ego.check(&check)?;
        check.range("ego.start_s_m", self.ego.start_s_m, 0.0, road.length_m())?;
        self.traffic.check(&check, self.road.lanes)?;
        if let Some(fog) = &self.fog {
            for (key, value) in [
                ("fog.front_m", fog.front_m),
                ("fog.side_m", fog.side_m),
                ("fog.rear_m", fog.rear_m),
            ] {
                check.range(key, value, 0.0, 1000.0)?;
            }
        }
        self.reward.check(&check)?;
        self.communication.check(&check)?;
        self.planning.check(&check)?;
        check.range(
            "planning.elites",
            f64::from(self.planning.elites),
            1.0,
            f64::from(self.planning.samples / self.planning.futures),
        )?;
        self.episode.check(&check)?;
        self.clock.check(&check)
    }

    /// How far one sees in this scene.
    pub fn fog(&self) -> Fog {
        self.fog.map_or_else(Fog::clear, |fog| {
            Fog::new(fog.front_m as f32, fog.side_m as f32, fog.rear_m as f32)
        })
    }

    /// Fog in which one sees `front_m` ahead (`--fog METRES`); sideways and behind in the proportions of this scene's
    /// fog, or of highway-fog's where the scene has none.
    pub fn set_fog_m(&mut self, front_m: f64) {
        let pattern = self.fog.unwrap_or(super::fog::PATTERN);
        let factor = front_m / pattern.front_m.max(1e-6);
        self.fog = Some(FogSpec {
            front_m,
            side_m: pattern.side_m * factor,
            rear_m: pattern.rear_m * factor,
        });
    }

    /// Seconds in a control step.
    pub fn step_s(&self) -> f64 {
        f64::from(self.clock.ticks_per_step) / self.clock.tick_hz
    }
}
