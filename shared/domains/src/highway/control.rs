//! Hands and feet: from a wanted lane and acceleration to pedals and steering wheel.

use super::road::Road;
use super::scene::{Ego, Scene};

/// What everybody who drives this car on this road knows of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cockpit {
    /// Width of a lane.
    pub lane_m: f32,
    /// Number of lanes side by side where the drive begins.
    pub lanes: usize,
    /// Distance between the axles.
    pub wheelbase_m: f32,
    /// Half of the car's length.
    pub half_length_m: f32,
    /// Wheel angle at full steer.
    pub steer_rad: f32,
    /// Acceleration at full throttle.
    pub acceleration_mps2: f32,
    /// Deceleration at full brake.
    pub brake_mps2: f32,
    /// Deceleration without pedals at 10 m/s.
    pub drag_mps2: f32,
    /// Seconds in a control step.
    pub step_s: f32,
    /// How much faster than on the default highway people want to drive here: the ratio of the speeds at which the car's
    /// throttle stops.
    pub pace: f32,
}

impl Cockpit {
    /// The cockpit of a scene's car on a road, begun at `start_s_m`.
    pub fn new(scene: &Scene, road: &Road, start_s_m: f64) -> Self {
        let (right, left) = road.edges_m(start_s_m);
        let lane = road.lane_near(super::road::RoadPoint {
            s_m: start_s_m,
            d_m: 0.0,
        });
        let lane_m = road.lane_width_m(lane, start_s_m);
        Self {
            lane_m: lane_m as f32,
            lanes: ((left - right) / lane_m).round().max(1.0) as usize,
            wheelbase_m: scene.ego.wheelbase_m as f32,
            half_length_m: scene.ego.length_m as f32 / 2.0,
            steer_rad: scene.ego.steer_deg.to_radians() as f32,
            acceleration_mps2: scene.ego.acceleration_mps2 as f32,
            brake_mps2: scene.ego.brake_mps2 as f32,
            drag_mps2: scene.ego.drag_mps2 as f32,
            step_s: scene.step_s() as f32,
            pace: (scene.ego.throttle_limit_kmh / Ego::default().throttle_limit_kmh) as f32,
        }
    }

    /// Throttle (positive) or brake (negative) for a wanted acceleration at a speed.
    pub fn pedal(&self, acceleration_mps2: f32, speed_mps: f32) -> f32 {
        let push = acceleration_mps2 + self.drag_mps2 * speed_mps / 10.0;
        let full = if push >= 0.0 {
            self.acceleration_mps2
        } else {
            self.brake_mps2
        };
        (push / full).clamp(-1.0, 1.0)
    }

    /// Steer that turns the car towards `aside_m` to the left (negative: right) of where it is.
    ///
    /// The heading error ψ is brought to ψ* = aside / (v·`settle_s`), at most `slant_rad`, with time constant `turn_s`,
    /// on top of the road's own curvature: δ = L·(κ + (ψ* − ψ) / (v·`turn_s`)).
    #[allow(clippy::too_many_arguments)]
    pub fn steer(
        &self,
        aside_m: f32,
        heading_error_rad: f32,
        curvature_per_m: f32,
        speed_mps: f32,
        settle_s: f32,
        slant_rad: f32,
        turn_s: f32,
    ) -> f32 {
        let speed = speed_mps.max(2.0);
        let wanted = (aside_m / (speed * settle_s)).clamp(-slant_rad, slant_rad);
        let curvature = curvature_per_m + (wanted - heading_error_rad) / (speed * turn_s);
        ((self.wheelbase_m * curvature).atan() / self.steer_rad).clamp(-1.0, 1.0)
    }
}
