//! What the highway's picture in Foxglove's 3D panel is made of: boxes for cars, lines for the road.

use crate::ros::{Colour, Marker, MarkerPose, MarkerShape, MarkerStamp};
use messages::ObjectPose;

/// Height drawn for every car; messages carry none.
pub const CAR_HEIGHT_M: f64 = 1.5;
const PAINT: Colour = [0.9, 0.9, 0.9, 0.9];

/// A line painted on the road, or its edge.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct RoadLine {
    /// Points in the world's frame, in metres.
    pub points_m: Vec<[f64; 2]>,
    /// Whether the line is broken, as between lanes.
    pub dashed: bool,
}

/// A car as a box.
pub fn car(
    stamp: MarkerStamp,
    namespace: &'static str,
    object: &ObjectPose,
    colour: Colour,
) -> Marker {
    let mut marker = Marker::new(stamp, namespace, object.id, MarkerShape::Cube);
    marker.pose = MarkerPose {
        position: [object.x_m, object.y_m, 0.5 * CAR_HEIGHT_M],
        heading_rad: f64::from(object.heading_rad),
    };
    marker.scale = [
        f64::from(object.length_m),
        f64::from(object.width_m),
        CAR_HEIGHT_M,
    ];
    marker.colour = colour;
    marker
}

/// A broken line draws every other of its pieces.
pub fn road_line(stamp: MarkerStamp, id: i32, line: &RoadLine) -> Marker {
    let shape = if line.dashed {
        MarkerShape::LineList
    } else {
        MarkerShape::LineStrip
    };
    let mut marker = Marker::new(stamp, "road", id, shape);
    marker.scale = [0.15, 0.0, 0.0];
    marker.colour = PAINT;
    let pieces = if line.dashed {
        line.points_m.len() & !1
    } else {
        line.points_m.len()
    };
    marker.points = line.points_m[..pieces]
        .iter()
        .map(|&[x, y]| [x, y, 0.0])
        .collect();
    marker
}
