//! Roads from polylines, as recorded maps give them.

use super::{Lane, MAX_SAMPLES, Road, RoadError, SAMPLE_M, Sample, in_range, wrap_angle};

/// A lane given by its two edges, as CommonRoad's lanelets are; the points run in driving direction.
#[derive(Clone, Debug, PartialEq)]
pub struct LaneEdges {
    /// Points of the left edge, in metres.
    pub left: Vec<[f64; 2]>,
    /// Points of the right edge, in metres.
    pub right: Vec<[f64; 2]>,
}

impl Road {
    /// A road along `reference`, with lanes given by their edges. Lanes are sorted from right to left; a lane may begin
    /// and end anywhere along the reference line.
    ///
    /// # Errors
    /// When the reference line has no length, no lane lies beside it, or a number is not finite.
    pub fn from_polylines(
        reference: &[[f64; 2]],
        lanes: &[LaneEdges],
        left_shoulder_m: f64,
        right_shoulder_m: f64,
    ) -> Result<Self, RoadError> {
        in_range("left shoulder", left_shoulder_m, 0.0, 20.0, "0 to 20 m")?;
        in_range("right shoulder", right_shoulder_m, 0.0, 20.0, "0 to 20 m")?;
        let edges = lanes
            .iter()
            .flat_map(|lane| lane.left.iter().chain(&lane.right));
        for point in reference.iter().chain(edges) {
            for value in point {
                in_range(
                    "a point's coordinate",
                    *value,
                    -1e8,
                    1e8,
                    "a finite number of metres",
                )?;
            }
        }
        let samples = resample(reference)?;
        let length = samples.1 * (samples.0.len() - 1) as f64;
        let mut road = Self {
            samples: samples.0,
            step_m: samples.1,
            lanes: Vec::new(),
            left_shoulder_m,
            right_shoulder_m,
        };
        let count = road.samples.len();
        for edges in lanes {
            let (Some(left), Some(right)) = (road.profile(&edges.left), road.profile(&edges.right))
            else {
                continue;
            };
            let from_m = left.first_s.max(right.first_s).max(0.0);
            let to_m = left.last_s.min(right.last_s).min(length);
            if to_m <= from_m {
                continue;
            }
            let mut lane = Lane {
                from_m,
                to_m,
                offset: Vec::with_capacity(count),
                width: Vec::with_capacity(count),
                core: true,
            };
            for index in 0..count {
                let s = (index as f64 * road.step_m).clamp(from_m, to_m);
                let (l, r) = (left.at(s), right.at(s));
                lane.offset.push(((l + r) / 2.0) as f32);
                lane.width.push(((l - r).abs()).max(0.1) as f32);
            }
            road.lanes.push(lane);
        }
        if road.lanes.is_empty() {
            return Err(RoadError::NoLane);
        }
        road.lanes.sort_by(|a, b| a.middle().total_cmp(&b.middle()));
        Ok(road)
    }

    /// An edge's offset as a function of s, or nothing where it has fewer than two points that advance along the road.
    fn profile(&self, points: &[[f64; 2]]) -> Option<Profile> {
        let mut knots: Vec<(f64, f64)> = Vec::with_capacity(points.len());
        for point in points {
            let at = match knots.last() {
                Some(last) => {
                    let near = self.project_near(point[0], point[1], last.0);
                    // A jump that Newton's method cannot follow is found by searching everywhere.
                    let (x, y, _, _) = self.place(near.s_m, near.d_m);
                    if (x - point[0]).hypot(y - point[1]) < 0.1 {
                        near
                    } else {
                        self.project(point[0], point[1])
                    }
                }
                None => self.project(point[0], point[1]),
            };
            if knots.last().is_none_or(|last| at.s_m > last.0 + 1e-6) {
                knots.push((at.s_m, at.d_m));
            }
        }
        let (first, last) = (knots.first()?.0, knots.last()?.0);
        (knots.len() >= 2).then_some(Profile {
            first_s: first,
            last_s: last,
            knots,
        })
    }
}

struct Profile {
    first_s: f64,
    last_s: f64,
    knots: Vec<(f64, f64)>,
}

impl Profile {
    fn at(&self, s: f64) -> f64 {
        let after = self
            .knots
            .partition_point(|knot| knot.0 < s)
            .clamp(1, self.knots.len() - 1);
        let (a, b) = (self.knots[after - 1], self.knots[after]);
        let t = ((s - a.0) / (b.0 - a.0)).clamp(0.0, 1.0);
        a.1 + t * (b.1 - a.1)
    }
}

/// Samples at equal distances along a polyline, with headings from central differences.
fn resample(points: &[[f64; 2]]) -> Result<(Vec<Sample>, f64), RoadError> {
    let mut kept: Vec<[f64; 2]> = Vec::with_capacity(points.len());
    let mut arc: Vec<f64> = Vec::with_capacity(points.len());
    for point in points {
        match kept.last() {
            Some(last) => {
                let distance = (point[0] - last[0]).hypot(point[1] - last[1]);
                if distance > 1e-6 {
                    arc.push(arc[arc.len() - 1] + distance);
                    kept.push(*point);
                }
            }
            None => {
                kept.push(*point);
                arc.push(0.0);
            }
        }
    }
    let length = arc.last().copied().unwrap_or(0.0);
    if kept.len() < 2 {
        return Err(RoadError::Empty);
    }
    in_range("road length", length, 1.0, 1e5, "1 to 100000 m")?;
    let count = ((length / SAMPLE_M).ceil() as usize + 1).clamp(3, MAX_SAMPLES);
    let step = length / (count - 1) as f64;
    let mut segment = 0;
    let mut positions = Vec::with_capacity(count);
    for index in 0..count {
        let s = (index as f64 * step).min(length);
        while segment + 2 < kept.len() && s > arc[segment + 1] {
            segment += 1;
        }
        let t = (s - arc[segment]) / (arc[segment + 1] - arc[segment]);
        let (a, b) = (kept[segment], kept[segment + 1]);
        positions.push([a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]);
    }
    let mut samples: Vec<Sample> = Vec::with_capacity(count);
    for index in 0..count {
        // Over ± 4 samples: lanelet points lie metres apart, and a heading that jumps at each would be no road's.
        let (a, b) = (
            positions[index.saturating_sub(4)],
            positions[(index + 4).min(count - 1)],
        );
        let raw = (b[1] - a[1]).atan2(b[0] - a[0]);
        let heading = match samples.last() {
            Some(last) => last.heading + wrap_angle(raw - last.heading),
            None => raw,
        };
        let (ty, tx) = heading.sin_cos();
        samples.push(Sample {
            x: positions[index][0],
            y: positions[index][1],
            tx,
            ty,
            heading,
            curvature: 0.0,
        });
    }
    for index in 0..count {
        let (a, b) = (index.saturating_sub(1), (index + 1).min(count - 1));
        samples[index].curvature =
            (samples[b].heading - samples[a].heading) / ((b - a) as f64 * step);
    }
    Ok((samples, step))
}
