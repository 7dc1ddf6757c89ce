//! The road as a page draws it: where its surface ends, and the lines on it.

use super::road::Road;
use serde::{Deserialize, Serialize};

/// Distance between two points of a line.
const STEP_M: f64 = 2.0;
/// Painted beside lanes that map no shoulder.
const VERGE_M: f64 = 0.5;

/// A road's outline, in metres in the world's frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outline {
    /// Left and right border of the surface, shoulders included, every two metres along the road.
    pub surface: Vec<[[f32; 2]; 2]>,
    /// The lines painted on it.
    pub lines: Vec<OutlineLine>,
}

/// A line painted on the road.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OutlineLine {
    /// Every two metres along the road.
    pub points: Vec<[f32; 2]>,
    /// Whether the line is broken, as between lanes.
    pub dashed: bool,
}

impl Outline {
    /// The outline of a road.
    pub fn of(road: &Road) -> Self {
        let place = |s_m: f64, d_m: f64| {
            let (x_m, y_m, ..) = road.place(s_m, d_m);
            [x_m as f32, y_m as f32]
        };
        let (left_m, right_m) = road.shoulders_m();
        let surface = along(0.0, road.length_m()).map(|s_m| {
            let (right, left) = road.edges_m(s_m);
            let (left, right) = (left + left_m.max(VERGE_M), right - right_m.max(VERGE_M));
            [place(s_m, left), place(s_m, right)]
        });
        let mut lines = Vec::new();
        for (index, lane) in road.lanes().iter().enumerate() {
            let (from_m, to_m) = (lane.from_m.max(0.0), lane.to_m.min(road.length_m()));
            // A lane's left line, and for the first lane the right one too; the outermost are drawn through.
            for side in [-0.5, 0.5] {
                if side < 0.0 && index > 0 {
                    continue;
                }
                let points = along(from_m, to_m).map(|s_m| {
                    let width_m = road.lane_width_m(index, s_m);
                    place(s_m, road.lane_offset_m(index, s_m) + side * width_m)
                });
                lines.push(OutlineLine {
                    points: points.collect(),
                    dashed: side > 0.0 && index + 1 < road.lanes().len(),
                });
            }
        }
        Self {
            surface: surface.collect(),
            lines,
        }
    }
}

/// Places from one to the other, about [`STEP_M`] apart.
fn along(from_m: f64, to_m: f64) -> impl Iterator<Item = f64> {
    let steps = ((to_m - from_m) / STEP_M).ceil().max(1.0) as usize;
    (0..=steps).map(move |step| from_m + (to_m - from_m) * step as f64 / steps as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::highway::Scene;

    #[test]
    fn the_lanes_lie_on_the_surface() {
        let scene = Scene::builtin("highway-fog").unwrap();
        let road = scene.road.build().unwrap();
        let outline = Outline::of(&road);
        assert_eq!(outline.lines.len(), 3);
        let dashed: Vec<_> = outline.lines.iter().map(|line| line.dashed).collect();
        assert_eq!(dashed, [false, true, false]);
        let distance = |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        for (index, [left, right]) in outline.surface.iter().enumerate() {
            assert!((distance(*left, *right) - 12.9).abs() < 0.01);
            let painted = |line: usize| outline.lines[line].points[index];
            assert!((distance(*right, painted(0)) - 3.2).abs() < 0.01);
            assert!((distance(painted(0), painted(1)) - 3.5).abs() < 0.01);
            assert!((distance(painted(2), *left) - 2.7).abs() < 0.01);
        }
    }
}
