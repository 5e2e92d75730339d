//! Planes that are level, or would be if the camera's pose were right.

use repose_geometry::{Point2, Point3, Vector3};

/// A plane that is level but for errors of the camera's pose: z = `height_m` + `slope_x` x + `slope_y` y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LevelPlane {
    /// Height over the world's origin, metres.
    pub height_m: f32,
    /// Rise per metre along x.
    pub slope_x: f32,
    /// Rise per metre along y.
    pub slope_y: f32,
}

impl LevelPlane {
    /// The height over or under a place, metres.
    pub fn height_at(&self, p: &Point2<f32>) -> f32 {
        self.height_m + self.slope_x * p.x + self.slope_y * p.y
    }

    /// Its steepest rise per metre.
    pub fn slope(&self) -> f32 {
        self.slope_x.hypot(self.slope_y)
    }

    /// How far a point is above the plane, metres.
    pub fn rise_m(&self, p: &Point3<f32>) -> f32 {
        p.z - (self.height_m + self.slope_x * p.x + self.slope_y * p.y)
    }

    /// The least-squares plane of points, or the level one at their mean height where that would tilt by more than `max_slope`.
    pub fn fit(points: &[Point3<f32>], max_slope: f32) -> Option<Self> {
        let n = points.len() as f64;
        if points.is_empty() {
            return None;
        }
        let mean = points.iter().fold(Vector3::<f64>::zeros(), |sum, p| sum + p.coords.cast::<f64>()) / n;
        let (mut xx, mut xy, mut yy, mut xz, mut yz) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for p in points {
            let d = p.coords.cast::<f64>() - mean;
            xx += d.x * d.x;
            xy += d.x * d.y;
            yy += d.y * d.y;
            xz += d.x * d.z;
            yz += d.y * d.z;
        }
        let determinant = xx * yy - xy * xy;
        let (mut a, mut b) = ((xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant);
        let is_level = a.hypot(b) <= f64::from(max_slope);
        if !is_level {
            (a, b) = (0.0, 0.0);
        }
        Some(Self { height_m: (mean.z - a * mean.x - b * mean.y) as f32, slope_x: a as f32, slope_y: b as f32 })
    }
}
