//! What a step led to: the reward's terms, and whether the round goes on.

use super::World;
use crate::highway::{AZIMUTHS, LIDAR_RANGE_M};

/// How a round stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum End {
    /// It goes on.
    #[default]
    Running = 0,
    /// The goal line was passed.
    Goal = 1,
    /// The ego car touched another car or left the road.
    Collision = 2,
    /// Time is up.
    OutOfTime = 3,
}

/// Identity in [`Outcome::other`] of the road's edge.
pub const ROAD_EDGE: i32 = -2;
/// Identity in [`Outcome::other`] of nothing.
pub const NOTHING: i32 = -1;

/// What a step led to: the reward's terms, already weighted, and how the round stands.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// Sum of the terms.
    pub reward: f32,
    /// r^speed.
    pub speed: f32,
    /// r^brake.
    pub brake: f32,
    /// r^steer.
    pub steer: f32,
    /// r^change.
    pub change: f32,
    /// r^center.
    pub center: f32,
    /// r^proximity.
    pub proximity: f32,
    /// r^road.
    pub road: f32,
    /// Collision penalty.
    pub collision: f32,
    /// Whether the ego car touched another car or left the road in this step.
    pub collided: bool,
    /// How the round stands.
    pub end: End,
    /// Identity of the car that was touched; [`NOTHING`] or [`ROAD_EDGE`].
    pub other: i32,
}

impl World {
    /// The reward's terms (the paper's appendix, "CARLA").
    pub(super) fn score(
        &self,
        throttle: f64,
        steer: f64,
        lane_before: usize,
        touched: i32,
    ) -> Outcome {
        let weights = &self.scene.reward;
        let (road, ego) = (&self.course.road, &self.ego);
        let top = weights.top_speed_kmh / 3.6;
        let speed = if ego.speed_mps <= top {
            ego.speed_mps / top
        } else {
            top - ego.speed_mps
        };
        let half_lane = road.lane_width_m(ego.lane, ego.at.s_m) / 2.0;
        let off_centre = (ego.at.d_m - road.lane_offset_m(ego.lane, ego.at.s_m)).abs() / half_lane;
        let ahead = self
            .observation
            .nearest_m(0)
            .min(self.observation.nearest_m(AZIMUTHS / 2));
        let around = self.observation.range.iter().copied().fold(1.0, f32::min) * LIDAR_RANGE_M;
        let mut proximity = 0.0;
        if f64::from(ahead) < weights.far_m {
            proximity -= weights.proximity_far;
        }
        if f64::from(around) < weights.near_m {
            proximity -= weights.proximity_near;
        }
        let (right, left) = road.edges_m(ego.at.s_m);
        let on_shoulder = ego.at.d_m < right || ego.at.d_m > left;
        let flag = |condition: bool, weight: f64| if condition { -weight as f32 } else { 0.0 };
        let mut outcome = Outcome {
            reward: 0.0,
            speed: speed as f32,
            brake: (-weights.brake * (-throttle).max(0.0)) as f32,
            steer: (-weights.steer * steer.abs()) as f32,
            change: flag(ego.lane != lane_before, weights.change),
            center: (-weights.center * off_centre) as f32,
            proximity: proximity as f32,
            road: flag(on_shoulder, weights.road),
            collision: flag(touched != NOTHING, weights.collision),
            collided: touched != NOTHING,
            end: self.end,
            other: touched,
        };
        outcome.reward = outcome.speed
            + outcome.brake
            + outcome.steer
            + outcome.change
            + outcome.center
            + outcome.proximity
            + outcome.road
            + outcome.collision;
        outcome
    }
}
