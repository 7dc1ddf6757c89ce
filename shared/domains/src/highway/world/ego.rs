//! The ego car: a kinematic bicycle.

use crate::highway::geometry::OrientedBox;
use crate::highway::road::{Pose, RoadPoint, wrap_angle};
use crate::highway::scene::Ego;

/// The ego car.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EgoCar {
    /// Centre of the box, and direction.
    pub pose: Pose,
    /// Along the road.
    pub at: RoadPoint,
    /// Speed in m/s, never negative.
    pub speed_mps: f64,
    /// Angle of the front wheels, left positive.
    pub wheel_rad: f64,
    /// Lane that its centre is in.
    pub lane: usize,
    /// Box length.
    pub length_m: f64,
    /// Box width.
    pub width_m: f64,
}

impl EgoCar {
    /// Its box.
    pub fn oriented_box(&self) -> OrientedBox {
        let (sin, cos) = self.pose.heading_rad.sin_cos();
        OrientedBox {
            x_m: self.pose.x_m,
            y_m: self.pose.y_m,
            cos,
            sin,
            half_length_m: self.length_m / 2.0,
            half_width_m: self.width_m / 2.0,
        }
    }
}

/// Kinematic bicycle: the centre's slip angle is β = atan(½ tan δ) with the centre midway between the axles, the heading
/// turns at v·sin β / (L/2), and tyres limit v² times that curvature.
pub(crate) fn drive(ego: &mut EgoCar, spec: &Ego, throttle: f64, steer: f64, tick_s: f64) {
    let wanted = steer * spec.steer_deg.to_radians();
    let turn = spec.steer_rate_deg_s.to_radians() * tick_s;
    ego.wheel_rad += (wanted - ego.wheel_rad).clamp(-turn, turn);
    let push = if throttle >= 0.0 {
        let limited = ego.speed_mps >= spec.throttle_limit_kmh / 3.6;
        if limited {
            0.0
        } else {
            throttle * spec.acceleration_mps2
        }
    } else {
        throttle * spec.brake_mps2
    };
    let drag = spec.drag_mps2 * ego.speed_mps / 10.0;
    ego.speed_mps = (ego.speed_mps + (push - drag) * tick_s).max(0.0);
    let slip = (0.5 * ego.wheel_rad.tan()).atan();
    let limit = spec.lateral_limit_mps2 / ego.speed_mps.powi(2).max(1e-3);
    let curvature = (slip.sin() / (spec.wheelbase_m / 2.0)).clamp(-limit, limit);
    let distance = ego.speed_mps * tick_s;
    let direction = ego.pose.heading_rad + slip + 0.5 * curvature * distance;
    ego.pose.x_m += distance * direction.cos();
    ego.pose.y_m += distance * direction.sin();
    ego.pose.heading_rad = wrap_angle(ego.pose.heading_rad + curvature * distance);
}
