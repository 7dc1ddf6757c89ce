//! Fog: how far one sees in each of the 36 directions.

use super::scene::FogSpec;
use super::{AZIMUTHS, LIDAR_RANGE_M};

/// Distances of the shipped fog scene, in whose proportions `--fog METRES` scales (`launch/scenes/highway-fog.toml`).
pub(crate) const PATTERN: FogSpec = FogSpec {
    front_m: 15.0,
    side_m: 8.0,
    rear_m: 3.0,
};

/// Distance, in metres and per azimuth, up to which a person with average eyes sees a car.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fog {
    /// One value an azimuth, at most the LIDAR's range.
    pub visible_m: [f32; AZIMUTHS],
}

impl Fog {
    /// No fog: everything in the LIDAR's range is visible.
    pub fn clear() -> Self {
        Self {
            visible_m: [LIDAR_RANGE_M; AZIMUTHS],
        }
    }

    /// Fog that lets one see `front_m` ahead, `side_m` at right angles and `rear_m` behind, and in between the ellipse
    /// arcs through these: 1/r² = cos²φ/a² + sin²φ/b².
    pub fn new(front_m: f32, side_m: f32, rear_m: f32) -> Self {
        let mut visible_m = [0.0; AZIMUTHS];
        for (azimuth, visible) in visible_m.iter_mut().enumerate() {
            let angle = azimuth as f32 * std::f32::consts::TAU / AZIMUTHS as f32;
            let ends = if angle.cos() > 0.0 { front_m } else { rear_m };
            let square =
                (angle.cos() / ends.max(1e-3)).powi(2) + (angle.sin() / side_m.max(1e-3)).powi(2);
            *visible = square.sqrt().recip().min(LIDAR_RANGE_M);
        }
        Self { visible_m }
    }
}
