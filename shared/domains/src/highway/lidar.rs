//! The semantic LIDAR: 36 azimuths × 3 height bands, cast against the silhouettes of cars.

use super::geometry::OrientedBox;
use super::traffic::CarState;
use super::{AZIMUTHS, BEAMS, HEIGHT_BANDS, LIDAR_RANGE_M, Observation};

/// A passenger car's silhouette in a height band: shares of its length and width, and how far the part's centre lies
/// behind the box's, as a share of the length. Below 0.5 m the bumpers, 0.5–1.0 m the body, 1.0–1.7 m the cabin.
const SILHOUETTE: [[f64; 3]; HEIGHT_BANDS] =
    [[1.0, 1.0, 0.0], [0.96, 1.0, 0.0], [0.55, 0.85, 0.08]];

/// Directions of the beams in the car's frame.
#[derive(Clone, Debug)]
pub struct Lidar {
    beams: [(f64, f64); AZIMUTHS],
}

impl Default for Lidar {
    fn default() -> Self {
        let beams = std::array::from_fn(|azimuth| {
            let angle = azimuth as f64 * std::f64::consts::TAU / AZIMUTHS as f64;
            (angle.cos(), angle.sin())
        });
        Self { beams }
    }
}

/// The part of a car that a height band sees.
pub(crate) fn silhouette(car: &CarState, band: usize) -> OrientedBox {
    let [length, width, back] = if car.tall {
        [1.0, 1.0, 0.0]
    } else {
        SILHOUETTE[band]
    };
    let shift = back * 2.0 * car.half_length_m;
    OrientedBox {
        x_m: car.x_m - shift * car.cos,
        y_m: car.y_m - shift * car.sin,
        cos: car.cos,
        sin: car.sin,
        half_length_m: car.half_length_m * length,
        half_width_m: car.half_width_m * width,
    }
}

impl Lidar {
    /// Clears `out`'s LIDAR part: nothing in range.
    pub fn clear(out: &mut Observation) {
        out.range = [1.0; BEAMS];
        out.object = [-1; AZIMUTHS];
        out.speed_mps = [0.0; AZIMUTHS];
    }

    /// Casts the beams of a sensor at (x, y) with direction (cos, sin) against one car, keeping whatever is nearer.
    pub fn cast(
        &self,
        x_m: f64,
        y_m: f64,
        cos: f64,
        sin: f64,
        car: &CarState,
        out: &mut Observation,
    ) {
        let (dx, dy) = (car.x_m - x_m, car.y_m - y_m);
        let square = dx * dx + dy * dy;
        let radius = car.half_length_m.hypot(car.half_width_m);
        let reach = f64::from(LIDAR_RANGE_M) + radius;
        if square > reach * reach {
            return;
        }
        // Only beams within the circle around the car can meet it.
        let (first, count) = if square <= radius * radius * 1.01 {
            (0, AZIMUTHS)
        } else {
            let (ahead, left) = (dx * cos + dy * sin, dy * cos - dx * sin);
            let width = (radius / square.sqrt()).asin();
            let middle = left.atan2(ahead);
            let step = std::f64::consts::TAU / AZIMUTHS as f64;
            let low = ((middle - width) / step).ceil() as i64;
            let high = ((middle + width) / step).floor() as i64;
            if high < low {
                return;
            }
            (
                low.rem_euclid(AZIMUTHS as i64) as usize,
                (high - low + 1) as usize,
            )
        };
        let parts: [OrientedBox; HEIGHT_BANDS] = std::array::from_fn(|band| silhouette(car, band));
        for offset in 0..count {
            let azimuth = (first + offset) % AZIMUTHS;
            let (bx, by) = self.beams[azimuth];
            let (ux, uy) = (bx * cos - by * sin, bx * sin + by * cos);
            let nearest = (0..HEIGHT_BANDS)
                .map(|band| out.range[band * AZIMUTHS + azimuth])
                .fold(1.0, f32::min);
            for (band, part) in parts.iter().enumerate() {
                let Some(distance) = part.distance_along(x_m, y_m, ux, uy) else {
                    continue;
                };
                let range = (distance / f64::from(LIDAR_RANGE_M)) as f32;
                let beam = &mut out.range[band * AZIMUTHS + azimuth];
                if range < *beam {
                    *beam = range;
                    if range < nearest {
                        out.object[azimuth] = car.id;
                        out.speed_mps[azimuth] = car.speed_mps as f32;
                    }
                }
            }
        }
    }
}
