//! Oriented boxes: do two touch, and how far along a ray is one.

/// A rectangle with a direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrientedBox {
    /// Centre in metres.
    pub x_m: f64,
    /// See `x_m`.
    pub y_m: f64,
    /// Unit vector along the length.
    pub cos: f64,
    /// See `cos`.
    pub sin: f64,
    /// Half of the length.
    pub half_length_m: f64,
    /// Half of the width.
    pub half_width_m: f64,
}

impl OrientedBox {
    /// Whether two boxes overlap, by the separating-axis theorem: two rectangles are apart exactly if their projections
    /// on one of the four edge directions are.
    pub fn overlaps(&self, other: &Self) -> bool {
        let (dx, dy) = (other.x_m - self.x_m, other.y_m - self.y_m);
        // Cosine and sine of the angle between them, as projections of unit vectors on each other.
        let cos = (self.cos * other.cos + self.sin * other.sin).abs();
        let sin = (self.cos * other.sin - self.sin * other.cos).abs();
        let apart =
            |along: f64, half: f64, length: f64, width: f64| along.abs() > half + length + width;
        let reach =
            |first: f64, second: f64, b: &Self| (b.half_length_m * first, b.half_width_m * second);
        let (l, w) = reach(cos, sin, other);
        let (l2, w2) = reach(sin, cos, other);
        let (l3, w3) = reach(cos, sin, self);
        let (l4, w4) = reach(sin, cos, self);
        !(apart(dx * self.cos + dy * self.sin, self.half_length_m, l, w)
            || apart(dy * self.cos - dx * self.sin, self.half_width_m, l2, w2)
            || apart(dx * other.cos + dy * other.sin, other.half_length_m, l3, w3)
            || apart(dy * other.cos - dx * other.sin, other.half_width_m, l4, w4))
    }

    /// Distance from (x, y) along the unit vector (ux, uy) to this box; nothing if the ray misses it, 0 from inside.
    pub fn distance_along(&self, x_m: f64, y_m: f64, ux: f64, uy: f64) -> Option<f64> {
        // The ray in the box's frame, clipped by its two slabs.
        let (dx, dy) = (x_m - self.x_m, y_m - self.y_m);
        let (px, py) = (dx * self.cos + dy * self.sin, dy * self.cos - dx * self.sin);
        let (vx, vy) = (ux * self.cos + uy * self.sin, uy * self.cos - ux * self.sin);
        let (mut near, mut far) = (0.0f64, f64::INFINITY);
        for (p, v, half) in [(px, vx, self.half_length_m), (py, vy, self.half_width_m)] {
            if v.abs() < 1e-12 {
                if p.abs() > half {
                    return None;
                }
            } else {
                let (a, b) = ((-half - p) / v, (half - p) / v);
                near = near.max(a.min(b));
                far = far.min(a.max(b));
            }
        }
        (near <= far).then_some(near)
    }
}
