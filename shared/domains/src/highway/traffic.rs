//! The other cars: how each moves, and where it is at any tick. They never react to the ego car.

use super::road::{Pose, Road, RoadPoint};
use super::scene::Scene;
use crate::commonroad::GoalRegion;

/// What a traffic participant is; the two differ in their size and silhouette only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A passenger car.
    Car,
    /// Anything else: a lorry, a bus, a motorcycle; a full-height box.
    Other,
}

/// One traffic participant.
#[derive(Clone, Debug, PartialEq)]
pub struct Participant {
    /// Identity, ≥ 0 and unique; a recorded car keeps its file's.
    pub id: i32,
    /// Size along the heading in metres.
    pub length_m: f64,
    /// Size across the heading in metres.
    pub width_m: f64,
    /// What it is.
    pub kind: Kind,
    /// How it moves.
    pub motion: Motion,
}

/// How a participant moves.
#[derive(Clone, Debug, PartialEq)]
pub enum Motion {
    /// Along the centre of a lane.
    Lane(LaneMotion),
    /// As recorded.
    Recorded(Recording),
}

/// Motion along the centre of a lane: accelerates from standstill to `speed_mps`; past `slows_at_m` it changes to
/// `slow_speed_mps`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LaneMotion {
    /// The lane, counted from the right.
    pub lane: usize,
    /// Where it starts.
    pub start_s_m: f64,
    /// Cruising speed.
    pub speed_mps: f64,
    /// Where it slows down; infinite for never.
    pub slows_at_m: f64,
    /// Its speed from there on.
    pub slow_speed_mps: f64,
    /// Acceleration up to the speed wanted.
    pub acceleration_mps2: f64,
    /// Deceleration down to the speed wanted, positive.
    pub deceleration_mps2: f64,
    /// Seconds that it waits after traffic starts moving.
    pub delay_s: f64,
}

/// A recorded motion: poses at equal intervals.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// When the first pose holds, in seconds since the recording's time 0.
    pub start_s: f64,
    /// Seconds between poses, > 0.
    pub period_s: f64,
    /// The poses, at least one.
    pub poses: Vec<RecordedPose>,
}

/// A recorded pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RecordedPose {
    /// Position of the car's centre and its direction.
    pub pose: Pose,
    /// Speed over ground, in m/s.
    pub speed_mps: f64,
}

impl Recording {
    /// When the last pose holds.
    pub fn end_s(&self) -> f64 {
        self.start_s + self.period_s * self.poses.len().saturating_sub(1) as f64
    }

    /// Pose and speed at `time_s`, linear between recorded poses; nothing before the first and after the last.
    pub fn at(&self, time_s: f64) -> Option<RecordedPose> {
        // Ticks are sums of 0.05 in floating point: a nanosecond early is on time.
        const SLACK: f64 = 1e-9;
        let last = self.poses.len().checked_sub(1)?;
        let position = (time_s - self.start_s) / self.period_s;
        if !(-SLACK..=last as f64 + SLACK).contains(&position) {
            return None;
        }
        let position = position.clamp(0.0, last as f64);
        let index = (position as usize).min(last.saturating_sub(1));
        let (a, b) = (&self.poses[index], &self.poses[(index + 1).min(last)]);
        let t = position - index as f64;
        let turn = super::road::wrap_angle(b.pose.heading_rad - a.pose.heading_rad);
        Some(RecordedPose {
            pose: Pose {
                x_m: a.pose.x_m + t * (b.pose.x_m - a.pose.x_m),
                y_m: a.pose.y_m + t * (b.pose.y_m - a.pose.y_m),
                heading_rad: a.pose.heading_rad + t * turn,
            },
            speed_mps: a.speed_mps + t * (b.speed_mps - a.speed_mps),
        })
    }
}

/// Where a participant is now.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CarState {
    /// Identity.
    pub id: i32,
    /// Position of the centre in metres.
    pub x_m: f64,
    /// See `x_m`.
    pub y_m: f64,
    /// Unit vector of the heading.
    pub cos: f64,
    /// See `cos`.
    pub sin: f64,
    /// Along the road.
    pub at: RoadPoint,
    /// Speed over ground in m/s.
    pub speed_mps: f64,
    /// Half the box's length.
    pub half_length_m: f64,
    /// Half the box's width.
    pub half_width_m: f64,
    /// Lane that it drives in (nearest lane for a recorded car).
    pub lane: usize,
    /// Whether the silhouette is a full-height box rather than a passenger car's.
    pub tall: bool,
    /// Whether it is on the road now; a recorded car comes and goes.
    pub present: bool,
}

impl Participant {
    /// State at the start of an episode, into `state`.
    pub fn place(&self, road: &Road, state: &mut CarState) {
        *state = CarState {
            id: self.id,
            half_length_m: self.length_m / 2.0,
            half_width_m: self.width_m / 2.0,
            tall: self.kind == Kind::Other,
            ..CarState::default()
        };
        match &self.motion {
            Motion::Lane(motion) => {
                state.lane = motion.lane;
                state.present = true;
                let d_m = road.lane_offset_m(motion.lane, motion.start_s_m);
                state.at = RoadPoint {
                    s_m: motion.start_s_m,
                    d_m,
                };
                set_on_road(road, state);
            }
            Motion::Recorded(recording) => {
                if let Some(first) = recording.poses.first() {
                    state.at = road.project(first.pose.x_m, first.pose.y_m);
                }
                replay(recording, road, 0.0, state);
            }
        }
    }

    /// Moves on to `time_s`, seconds since traffic started moving; `tick_s` is the time since the last call. A car that
    /// keeps a lane drives no faster than `limit_mps`, for the sake of the car ahead of it.
    pub fn advance(
        &self,
        road: &Road,
        time_s: f64,
        tick_s: f64,
        limit_mps: f64,
        state: &mut CarState,
    ) {
        match &self.motion {
            Motion::Lane(motion) => {
                if time_s <= motion.delay_s {
                    return;
                }
                let wanted = if state.at.s_m >= motion.slows_at_m {
                    motion.slow_speed_mps
                } else {
                    motion.speed_mps
                };
                let change = wanted.min(limit_mps) - state.speed_mps;
                state.speed_mps += change.clamp(
                    -motion.deceleration_mps2 * tick_s,
                    motion.acceleration_mps2 * tick_s,
                );
                state.at.s_m += state.speed_mps * tick_s;
                state.at.d_m = road.lane_offset_m(motion.lane, state.at.s_m);
                set_on_road(road, state);
            }
            Motion::Recorded(recording) => replay(recording, road, time_s, state),
        }
    }
}

fn set_on_road(road: &Road, state: &mut CarState) {
    (state.x_m, state.y_m, state.cos, state.sin) = road.place(state.at.s_m, state.at.d_m);
}

fn replay(recording: &Recording, road: &Road, time_s: f64, state: &mut CarState) {
    let Some(now) = recording.at(time_s) else {
        state.present = false;
        return;
    };
    // A car that was not there a tick ago, or was elsewhere, is looked for along the whole road.
    let way = (now.pose.x_m - state.x_m).hypot(now.pose.y_m - state.y_m);
    let moved = state.present && way < 20.0;
    state.present = true;
    (state.x_m, state.y_m) = (now.pose.x_m, now.pose.y_m);
    (state.sin, state.cos) = now.pose.heading_rad.sin_cos();
    state.speed_mps = now.speed_mps;
    state.at = if moved {
        road.project_near(state.x_m, state.y_m, state.at.s_m)
    } else {
        road.project(state.x_m, state.y_m)
    };
    state.lane = road.lane_near(state.at);
}

/// What a recorded scenario gives the world: a road, the cars on it, and where the ego car starts.
#[derive(Clone, Debug, PartialEq)]
pub struct Course {
    /// The road.
    pub road: Road,
    /// The cars, sorted by identity.
    pub traffic: Vec<Participant>,
    /// Where the ego car starts.
    pub start: Pose,
    /// How fast it then drives.
    pub start_speed_mps: f64,
    /// Arc length at which the goal is reached; infinite for none.
    pub goal_s_m: f64,
    /// Places, times and speeds that count as arriving besides.
    pub goal: GoalRegion,
    /// Seconds after which the round ends: as long as cars were recorded, or where none moves, until the goal's last instant.
    pub duration_s: f64,
    /// What the recording's reader passed over, in words: for the run's output and its summary.
    pub notes: Vec<String>,
}

impl Course {
    /// The action that makes the ego car move as a recorded car did in the control step from `time_s` on: its mean
    /// acceleration over full throttle or full brake, and the wheel angle of the turn it made, over full steer.
    pub fn recorded_action(&self, scene: &Scene, car: &Participant, time_s: f64) -> [f32; 2] {
        let Motion::Recorded(recording) = &car.motion else {
            return [0.0; 2];
        };
        let step_s = scene.step_s();
        let (Some(now), Some(next)) = (recording.at(time_s), recording.at(time_s + step_s)) else {
            return [0.0; 2];
        };
        let spec = &scene.ego;
        let mean_mps = (now.speed_mps + next.speed_mps) / 2.0;
        let push = (next.speed_mps - now.speed_mps) / step_s + spec.drag_mps2 * mean_mps / 10.0;
        let full = if push >= 0.0 {
            spec.acceleration_mps2
        } else {
            spec.brake_mps2
        };
        let turn = super::road::wrap_angle(next.pose.heading_rad - now.pose.heading_rad);
        // Inverse of the kinematic bicycle: curvature = sin β / (L/2), tan δ = 2 tan β.
        let curvature = turn / (mean_mps * step_s).max(0.1);
        let slip = (curvature * spec.wheelbase_m / 2.0).clamp(-0.9, 0.9).asin();
        let wheel = (2.0 * slip.tan()).atan();
        let bounded = |value: f64| value.clamp(-1.0, 1.0) as f32;
        [
            bounded(push / full),
            bounded(wheel / spec.steer_deg.to_radians()),
        ]
    }
}
