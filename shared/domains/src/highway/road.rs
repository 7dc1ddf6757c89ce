//! A road: a reference line with lanes beside it, and the map between (s, d) along it and (x, y) in the world.
//!
//! `s` is arc length along the reference line and `d` the offset from it, left positive, both in metres. Lanes are
//! numbered from the right: lane 0 is the rightmost.

mod polylines;

use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use polylines::LaneEdges;

/// Distance between the samples that a road is stored as, in metres.
///
/// On the tightest arc of the default road (1/118 m) a chord of this length leaves the arc by 1 mm.
const SAMPLE_M: f64 = 1.0;
/// Largest number of samples: a road of 100 km.
const MAX_SAMPLES: usize = 100_000;

/// Why a road could not be built.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum RoadError {
    /// Fewer than two distinct points, or no length at all.
    #[error("the road's reference line has no length")]
    Empty,
    /// A number that is not finite or outside its range.
    #[error("{what} is {value}, expected {expected}")]
    Value {
        /// Which number.
        what: String,
        /// What it was.
        value: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// No lane was given, or none lies beside the reference line.
    #[error("the road has no lane")]
    NoLane,
}

/// A piece of the reference line: a line where the curvature is 0, an arc elsewhere.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Segment {
    /// Length in metres.
    pub length_m: f64,
    /// Curvature in 1/m, positive to the left.
    #[serde(default)]
    pub curvature_per_m: f64,
}

/// Where a point lies along a road.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RoadPoint {
    /// Arc length along the reference line.
    pub s_m: f64,
    /// Offset from the reference line, left positive.
    pub d_m: f64,
}

/// A position and a direction in the world.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// Position in metres.
    pub x_m: f64,
    /// See `x_m`.
    pub y_m: f64,
    /// Anticlockwise from the x axis, in radians.
    pub heading_rad: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Sample {
    x: f64,
    y: f64,
    /// Unit tangent.
    tx: f64,
    ty: f64,
    /// Unwrapped, so that differences between samples are turns.
    heading: f64,
    curvature: f64,
}

/// A lane, as offsets from the reference line.
#[derive(Clone, Debug, PartialEq)]
pub struct Lane {
    /// Where along the reference line the lane begins.
    pub from_m: f64,
    /// Where it ends.
    pub to_m: f64,
    /// Offset of the lane's centre, one value a sample.
    offset: Vec<f32>,
    /// Width, one value a sample.
    width: Vec<f32>,
    /// Whether it counts for the road's centre.
    core: bool,
}

/// A road. Reading it never allocates.
#[derive(Clone, Debug, PartialEq)]
pub struct Road {
    samples: Vec<Sample>,
    step_m: f64,
    lanes: Vec<Lane>,
    left_shoulder_m: f64,
    right_shoulder_m: f64,
}

fn in_range(
    what: &str,
    value: f64,
    low: f64,
    high: f64,
    expected: &'static str,
) -> Result<(), RoadError> {
    if value.is_finite() && (low..=high).contains(&value) {
        Ok(())
    } else {
        Err(RoadError::Value {
            what: what.to_owned(),
            value,
            expected,
        })
    }
}

/// The angle brought into (−π, π].
pub fn wrap_angle(angle: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    let wrapped = angle - turn * (angle / turn).round();
    if wrapped <= -std::f64::consts::PI {
        wrapped + turn
    } else {
        wrapped
    }
}

impl Road {
    /// A road of lines and arcs from the origin, heading along x, with `lanes` lanes of the same width. The reference
    /// line is the middle of the lanes.
    ///
    /// # Errors
    /// When there is no segment or lane, or a number is outside its range.
    pub fn from_segments(
        segments: &[Segment],
        lanes: usize,
        lane_width_m: f64,
        left_shoulder_m: f64,
        right_shoulder_m: f64,
    ) -> Result<Self, RoadError> {
        in_range("lane width", lane_width_m, 2.0, 10.0, "2 to 10 m")?;
        in_range("left shoulder", left_shoulder_m, 0.0, 20.0, "0 to 20 m")?;
        in_range("right shoulder", right_shoulder_m, 0.0, 20.0, "0 to 20 m")?;
        in_range("number of lanes", lanes as f64, 0.0, 12.0, "1 to 12")?;
        if lanes == 0 {
            return Err(RoadError::NoLane);
        }
        for (index, segment) in segments.iter().enumerate() {
            let name = |what| format!("{what} of segment {}", index + 1);
            in_range(
                &name("length"),
                segment.length_m,
                0.01,
                1e5,
                "0.01 to 100000 m",
            )?;
            in_range(
                &name("curvature"),
                segment.curvature_per_m,
                -0.05,
                0.05,
                "-0.05 to 0.05 per m",
            )?;
        }
        let length: f64 = segments.iter().map(|segment| segment.length_m).sum();
        if segments.is_empty() {
            return Err(RoadError::Empty);
        }
        in_range("road length", length, 1.0, 1e5, "1 to 100000 m")?;
        let count = ((length / SAMPLE_M).ceil() as usize + 1).clamp(2, MAX_SAMPLES);
        let step_m = length / (count - 1) as f64;
        let mut samples = Vec::with_capacity(count);
        let (mut x, mut y, mut heading, mut start) = (0.0, 0.0, 0.0, 0.0);
        let mut index = 0;
        for sample in 0..count {
            let s = sample as f64 * step_m;
            while index + 1 < segments.len() && s > start + segments[index].length_m {
                let segment = segments[index];
                let (dx, dy, turn) = along(segment.length_m, segment.curvature_per_m, heading);
                (x, y, heading) = (x + dx, y + dy, heading + turn);
                start += segment.length_m;
                index += 1;
            }
            let curvature = segments[index].curvature_per_m;
            let (dx, dy, turn) = along(s - start, curvature, heading);
            let at = heading + turn;
            samples.push(Sample {
                x: x + dx,
                y: y + dy,
                tx: at.cos(),
                ty: at.sin(),
                heading: at,
                curvature,
            });
        }
        let middle = (lanes as f64 - 1.0) / 2.0;
        let lanes = (0..lanes)
            .map(|lane| Lane {
                from_m: 0.0,
                to_m: length,
                offset: vec![((lane as f64 - middle) * lane_width_m) as f32; count],
                width: vec![lane_width_m as f32; count],
                core: true,
            })
            .collect();
        Ok(Self {
            samples,
            step_m,
            lanes,
            left_shoulder_m,
            right_shoulder_m,
        })
    }

    /// Length of the reference line in metres.
    pub fn length_m(&self) -> f64 {
        self.step_m * (self.samples.len() - 1) as f64
    }

    /// The lanes, from right to left.
    pub fn lanes(&self) -> &[Lane] {
        &self.lanes
    }

    /// Width of the left and the right shoulder.
    pub fn shoulders_m(&self) -> (f64, f64) {
        (self.left_shoulder_m, self.right_shoulder_m)
    }

    /// The point of the reference line at `s_m` and the unit tangent there; straight beyond either end.
    fn frame(&self, s_m: f64) -> (f64, f64, f64, f64) {
        let last = self.samples.len() - 1;
        let position = s_m / self.step_m;
        let index = (position.max(0.0) as usize).min(last - 1);
        let (a, b) = (&self.samples[index], &self.samples[index + 1]);
        let t = position - index as f64;
        if (0.0..=1.0).contains(&t) {
            let (tx, ty) = (a.tx + t * (b.tx - a.tx), a.ty + t * (b.ty - a.ty));
            let norm = 1.0 / (tx * tx + ty * ty).sqrt();
            (
                a.x + t * (b.x - a.x),
                a.y + t * (b.y - a.y),
                tx * norm,
                ty * norm,
            )
        } else {
            let (end, beyond) = if t < 0.0 {
                (a, t * self.step_m)
            } else {
                (b, (t - 1.0) * self.step_m)
            };
            (
                end.x + beyond * end.tx,
                end.y + beyond * end.ty,
                end.tx,
                end.ty,
            )
        }
    }

    /// World position of (s, d), and the unit tangent of the road there.
    pub fn place(&self, s_m: f64, d_m: f64) -> (f64, f64, f64, f64) {
        let (x, y, tx, ty) = self.frame(s_m);
        (x - d_m * ty, y + d_m * tx, tx, ty)
    }

    /// World pose of (s, d), heading along the road.
    pub fn pose(&self, point: RoadPoint) -> Pose {
        let (x_m, y_m, tx, ty) = self.place(point.s_m, point.d_m);
        Pose {
            x_m,
            y_m,
            heading_rad: ty.atan2(tx),
        }
    }

    /// Direction of the road at `s_m`, in radians and not wrapped.
    pub fn heading_rad(&self, s_m: f64) -> f64 {
        let last = self.samples.len() - 1;
        let position = (s_m / self.step_m).clamp(0.0, last as f64);
        let index = (position as usize).min(last - 1);
        let (a, b) = (&self.samples[index], &self.samples[index + 1]);
        a.heading + (position - index as f64) * (b.heading - a.heading)
    }

    /// Curvature at `s_m`, in 1/m, positive to the left.
    pub fn curvature_per_m(&self, s_m: f64) -> f64 {
        let position = (s_m / self.step_m).clamp(0.0, (self.samples.len() - 1) as f64);
        self.samples[position.round() as usize].curvature
    }

    /// How much the road turns over the next `ahead_m` metres, in radians, left positive.
    pub fn turn_ahead_rad(&self, s_m: f64, ahead_m: f64) -> f64 {
        self.heading_rad(s_m + ahead_m) - self.heading_rad(s_m)
    }

    /// The road point nearest to (x, y), searched along the whole road.
    pub fn project(&self, x_m: f64, y_m: f64) -> RoadPoint {
        let mut best = (f64::INFINITY, 0);
        for (index, sample) in self.samples.iter().enumerate() {
            let square = (x_m - sample.x).powi(2) + (y_m - sample.y).powi(2);
            if square < best.0 {
                best = (square, index);
            }
        }
        self.project_near(x_m, y_m, best.1 as f64 * self.step_m)
    }

    /// The road point nearest to (x, y), searched from `hint_s_m`, which should lie within some metres of it (such as
    /// where the same car was a tick ago). Newton's method on (p − c(s))·t(s) = 0, whose slope is −(1 − d·κ).
    pub fn project_near(&self, x_m: f64, y_m: f64, hint_s_m: f64) -> RoadPoint {
        let mut s = hint_s_m;
        let mut d = 0.0;
        for _ in 0..6 {
            let (x, y, tx, ty) = self.frame(s);
            let (dx, dy) = (x_m - x, y_m - y);
            let along = dx * tx + dy * ty;
            d = dy * tx - dx * ty;
            let beyond = s < 0.0 || s > self.length_m();
            let slope = if beyond {
                1.0
            } else {
                (1.0 - d * self.curvature_per_m(s)).clamp(0.25, 4.0)
            };
            s += along / slope;
            if along.abs() < 1e-9 {
                break;
            }
        }
        RoadPoint { s_m: s, d_m: d }
    }

    /// Offset of a lane's centre from the reference line at `s_m`. Past the last lane, the nearest lane's.
    pub fn lane_offset_m(&self, lane: usize, s_m: f64) -> f64 {
        let lane = &self.lanes[lane.min(self.lanes.len() - 1)];
        f64::from(self.interpolate(&lane.offset, s_m))
    }

    /// Width of a lane at `s_m`.
    pub fn lane_width_m(&self, lane: usize, s_m: f64) -> f64 {
        let lane = &self.lanes[lane.min(self.lanes.len() - 1)];
        f64::from(self.interpolate(&lane.width, s_m))
    }

    /// The lane whose centre is nearest to (s, d) among those that exist at s; the nearest of all where none does.
    pub fn lane_near(&self, point: RoadPoint) -> usize {
        let mut best = (f64::INFINITY, 0);
        for (index, lane) in self.lanes.iter().enumerate() {
            let beyond = (lane.from_m - point.s_m)
                .max(point.s_m - lane.to_m)
                .max(0.0);
            let offset = f64::from(self.interpolate(&lane.offset, point.s_m));
            let distance = (point.d_m - offset).abs() + 100.0 * beyond;
            if distance < best.0 {
                best = (distance, index);
            }
        }
        best.1
    }

    /// Direction of a lane at `s_m`, in radians and not wrapped: the road's, turned by how the lane's offset changes
    /// around there (central difference over ± 4 m; beyond the lane's ends it changes no more).
    pub fn lane_heading_rad(&self, lane: usize, s_m: f64) -> f64 {
        let change = self.lane_offset_m(lane, s_m + 4.0) - self.lane_offset_m(lane, s_m - 4.0);
        let (from_m, to_m) = {
            let lane = &self.lanes[lane.min(self.lanes.len() - 1)];
            (lane.from_m, lane.to_m)
        };
        let over = (s_m + 4.0).min(to_m) - (s_m - 4.0).max(from_m);
        self.heading_rad(s_m)
            + if over > 0.0 {
                (change / over).atan()
            } else {
                0.0
            }
    }

    /// Whether a point lies on one of the lanes. A lane reaches some metres past its ends, because maps are cut at an
    /// angle and lanelets meet with gaps of centimetres.
    pub fn on_lane(&self, point: RoadPoint) -> bool {
        const PAST_M: f64 = 5.0;
        const SEAM_M: f64 = 0.05;
        (0..self.lanes.len()).any(|index| {
            let lane = &self.lanes[index];
            (lane.from_m - PAST_M..=lane.to_m + PAST_M).contains(&point.s_m)
                && (point.d_m - self.lane_offset_m(index, point.s_m)).abs()
                    <= self.lane_width_m(index, point.s_m) / 2.0 + SEAM_M
        })
    }

    /// The right and the left edge of the driving lanes at `s_m`, as offsets from the reference line.
    pub fn edges_m(&self, s_m: f64) -> (f64, f64) {
        let mut edges = (f64::INFINITY, f64::NEG_INFINITY);
        for lane in &self.lanes {
            if s_m < lane.from_m - 1.0 || s_m > lane.to_m + 1.0 {
                continue;
            }
            let offset = f64::from(self.interpolate(&lane.offset, s_m));
            let half = f64::from(self.interpolate(&lane.width, s_m)) / 2.0;
            edges = (edges.0.min(offset - half), edges.1.max(offset + half));
        }
        if edges.0 > edges.1 {
            // Between lanes that have ended and lanes that have not begun: those nearest count.
            let lane = self.lane_near(RoadPoint { s_m, d_m: 0.0 });
            let half = self.lane_width_m(lane, s_m) / 2.0;
            let offset = self.lane_offset_m(lane, s_m);
            return (offset - half, offset + half);
        }
        edges
    }

    /// Fixes which lanes the road's centre is the middle of: those that exist at `s_m`. Lanes that begin or end elsewhere
    /// then do not shift it.
    #[must_use]
    pub fn with_core_at(mut self, s_m: f64) -> Self {
        for lane in &mut self.lanes {
            lane.core = (lane.from_m - 1.0..=lane.to_m + 1.0).contains(&s_m);
        }
        self
    }

    /// Offset of the road's centre from the reference line at `s_m`: the middle between the outer edges of those lanes
    /// that count for it and exist there.
    pub fn center_m(&self, s_m: f64) -> f64 {
        let mut edges = (f64::INFINITY, f64::NEG_INFINITY);
        for lane in self.lanes.iter().filter(|lane| lane.core) {
            if (lane.from_m - 1.0..=lane.to_m + 1.0).contains(&s_m) {
                let offset = f64::from(self.interpolate(&lane.offset, s_m));
                let half = f64::from(self.interpolate(&lane.width, s_m)) / 2.0;
                edges = (edges.0.min(offset - half), edges.1.max(offset + half));
            }
        }
        if edges.0 > edges.1 {
            edges = self.edges_m(s_m);
        }
        (edges.0 + edges.1) / 2.0
    }

    fn interpolate(&self, values: &[f32], s_m: f64) -> f32 {
        let last = values.len() - 1;
        let position = (s_m / self.step_m).clamp(0.0, last as f64);
        let index = (position as usize).min(last - 1);
        values[index] + (position - index as f64) as f32 * (values[index + 1] - values[index])
    }
}

impl Lane {
    fn middle(&self) -> f64 {
        f64::from(self.offset[self.offset.len() / 2])
    }
}

/// Displacement and turn after `length` along an arc that starts with `heading`.
fn along(length: f64, curvature: f64, heading: f64) -> (f64, f64, f64) {
    let turn = length * curvature;
    if turn.abs() < 1e-9 {
        (length * heading.cos(), length * heading.sin(), turn)
    } else {
        let radius = 1.0 / curvature;
        let end = heading + turn;
        (
            radius * (end.sin() - heading.sin()),
            radius * (heading.cos() - end.cos()),
            turn,
        )
    }
}
