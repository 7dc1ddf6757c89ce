//! The driver's seat of a recorded car: what the person in it could see, and what they did.

use super::error::CommonRoadError;
use super::scenario::{Scenario, wrap};
use crate::highway::road::RoadPoint;
use crate::highway::traffic::{Motion, Participant};
use crate::highway::world::{EgoCar, drive};
use crate::highway::{End, Observation, Scene, World};
use std::path::Path;
use std::sync::Arc;

impl Scene {
    /// The scene of a CommonRoad file, usable wherever one from a TOML file is: road, traffic and start from the file,
    /// everything else by default, but for
    /// - the fog, in which one sees `fog_m` ahead if that is given ([`Scene::set_fog_m`]);
    /// - the speed above which throttle does nothing, raised to [`Scenario::speed_limit_mps`]; the reward's top speed is
    ///   raised in proportion. Ego speed/40 km/h exceeds 1 then;
    /// - the round's length, which is the recording's.
    ///
    /// With `seat`, the driver sits in the recorded car of that identity and the ego car follows its recorded motion.
    ///
    /// # Errors
    /// When the file cannot be read or driven; see [`Scenario::read`] and [`Scenario::course`].
    pub fn from_commonroad(
        file: &Path,
        fog_m: Option<f64>,
        seat: Option<i32>,
    ) -> Result<Self, CommonRoadError> {
        Scenario::read(file)?.scene(fog_m, seat)
    }
}

impl Scenario {
    /// See [`Scene::from_commonroad`].
    ///
    /// # Errors
    /// See [`Scenario::course`].
    pub fn scene(&self, fog_m: Option<f64>, seat: Option<i32>) -> Result<Scene, CommonRoadError> {
        let course = self.course(seat)?;
        let mut scene = Scene {
            name: self.name(),
            seat,
            ..Scene::default()
        };
        let default_limit_kmh = scene.ego.throttle_limit_kmh;
        scene.ego.throttle_limit_kmh = self.speed_limit_mps() * 3.6;
        let faster = scene.ego.throttle_limit_kmh / default_limit_kmh;
        scene.reward.top_speed_kmh = (scene.reward.top_speed_kmh * faster).min(300.0);
        scene.episode.max_steps = (course.duration_s / scene.step_s()).ceil().max(1.0) as u32;
        scene.course = Some(Arc::new(course));
        if let Some(fog_m) = fog_m {
            scene.set_fog_m(fog_m);
        }
        Ok(scene)
    }

    /// The benchmark's identity, or the file's name.
    fn name(&self) -> String {
        if !self.benchmark_id.is_empty() {
            return self.benchmark_id.clone();
        }
        let stem = Path::new(&self.file).file_stem();
        stem.map_or_else(
            || self.file.clone(),
            |stem| stem.to_string_lossy().into_owned(),
        )
    }

    /// The actions that a recorded person took, one per control step of `scene`, and how well the ego car's kinematic
    /// bicycle reproduces the recorded motion with them.
    ///
    /// # Errors
    /// When there is no such car, or the scenario cannot be driven.
    pub fn recorded_actions(
        &self,
        id: i32,
        scene: &Scene,
    ) -> Result<RecordedActions, CommonRoadError> {
        let course = self.course(Some(id))?;
        let missing = || self.lacks(format!("car {id} is gone before the start"));
        let car: &Participant = course
            .traffic
            .iter()
            .find(|car| car.id == id)
            .ok_or_else(missing)?;
        let Motion::Recorded(recording) = &car.motion else {
            return Err(missing());
        };
        let step_s = scene.step_s();
        let ticks = scene.clock.ticks_per_step;
        let mut spec = scene.ego.clone();
        spec.throttle_limit_kmh = f64::INFINITY;
        let mut found = RecordedActions::default();
        let (mut position, mut heading, mut speed) = (0.0, 0.0, 0.0);
        for step in 0u32.. {
            // As the world counts time, so that both find the same action to the last bit.
            let time_s = recording.start_s + f64::from(step * ticks) * (1.0 / scene.clock.tick_hz);
            let (Some(now), Some(next)) = (recording.at(time_s), recording.at(time_s + step_s))
            else {
                break;
            };
            let action = course.recorded_action(scene, car, time_s);
            found.actions.push(action);
            found.clamped += usize::from(action.iter().any(|value| value.abs() >= 1.0));
            let mut ego = EgoCar {
                pose: now.pose,
                at: RoadPoint::default(),
                speed_mps: now.speed_mps,
                wheel_rad: f64::from(action[1]) * spec.steer_deg.to_radians(),
                ..EgoCar::default()
            };
            for _ in 0..ticks {
                drive(
                    &mut ego,
                    &spec,
                    f64::from(action[0]),
                    f64::from(action[1]),
                    step_s / f64::from(ticks),
                );
            }
            let away = (ego.pose.x_m - next.pose.x_m).hypot(ego.pose.y_m - next.pose.y_m);
            found.position_max_m = found.position_max_m.max(away);
            position += away * away;
            heading += wrap(ego.pose.heading_rad - next.pose.heading_rad).powi(2);
            speed += (ego.speed_mps - next.speed_mps).powi(2);
        }
        let count = found.actions.len().max(1) as f64;
        found.position_rms_m = (position / count).sqrt();
        found.heading_rms_rad = (heading / count).sqrt();
        found.speed_rms_mps = (speed / count).sqrt();
        Ok(found)
    }
}

/// What a recorded person did, and what the kinematic bicycle leaves unexplained per control step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordedActions {
    /// Throttle/brake and steer, one a control step.
    pub actions: Vec<[f32; 2]>,
    /// Steps in which an action was cut to [−1, 1].
    pub clamped: usize,
    /// Distance between where the bicycle gets to in one control step from the recorded state and where the recorded
    /// car got to: root of the mean square.
    pub position_rms_m: f64,
    /// The largest such distance.
    pub position_max_m: f64,
    /// Likewise for the heading.
    pub heading_rms_rad: f64,
    /// Likewise for the speed.
    pub speed_rms_mps: f64,
}

/// Real driving, step by step: what was sensed from a recorded car's seat, and what the person in it then did.
#[derive(Clone, Debug)]
pub struct RecordedSeat {
    world: World,
}

impl RecordedSeat {
    /// Sits down in the recorded car of that identity.
    ///
    /// # Errors
    /// When there is no such car, or the scenario cannot be driven.
    pub fn new(scenario: &Scenario, id: i32) -> Result<Self, CommonRoadError> {
        let scene = Arc::new(scenario.scene(None, Some(id))?);
        let course = scene.course.clone();
        course
            .and_then(|course| World::seated(scene, course, id))
            .map(|world| Self { world })
            .ok_or_else(|| scenario.lacks(format!("car {id} is gone before the start")))
    }

    /// The world as it now is around the seat.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The next step, without allocating: fills `observation` and returns the person's action; nothing at the end.
    pub fn advance(&mut self, observation: &mut Observation) -> Option<[f32; 2]> {
        if self.world.end() != End::Running {
            return None;
        }
        let action = self.world.recorded_action()?;
        self.world.observe(observation);
        self.world.step(action);
        Some(action)
    }
}

impl Iterator for RecordedSeat {
    type Item = (Observation, [f32; 2]);

    fn next(&mut self) -> Option<Self::Item> {
        let mut observation = Observation::default();
        let action = self.advance(&mut observation)?;
        Some((observation, action))
    }
}
