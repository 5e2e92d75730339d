//! A candidate placement: where the observed centroid of the query goes, and how far the query is turned.
//!
//! Kept in `f32`, the wire's type, so that what was scored is to the bit what is returned (paper, section 2: δ, an offset and a yaw).

use nalgebra::{Isometry3, Point2, Point3, Vector2};
use repose_belief::offsets::Carry;
use repose_geometry::transform;

/// A candidate placement in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CandidatePose {
    /// Where the centroid of the query's observed points goes, world frame, metres.
    pub centroid_m: [f32; 3],
    /// Turn about world z through that centroid, counter-clockwise, radians in (−π, π].
    pub yaw_rad: f32,
}

impl CandidatePose {
    /// A candidate from coordinates; the yaw is wrapped.
    pub fn new(centroid: &Point3<f64>, yaw_rad: f64) -> Self {
        Self { centroid_m: centroid.cast::<f32>().coords.into(), yaw_rad: transform::wrap_angle(yaw_rad) as f32 }
    }

    /// The wire's row: x, y, z, yaw.
    pub fn row(&self) -> [f32; 4] {
        let [x, y, z] = self.centroid_m;
        [x, y, z, self.yaw_rad]
    }

    /// From the wire's row.
    pub fn from_row([x, y, z, yaw_rad]: [f32; 4]) -> Self {
        Self { centroid_m: [x, y, z], yaw_rad }
    }

    /// Where the centroid goes, world frame, metres.
    pub fn centroid(&self) -> Point3<f64> {
        Point3::from(self.centroid_m).cast()
    }

    /// The motion that carries the query's observed points to the placed ones.
    pub fn placed_from_observed(&self, observed_centroid: &Point3<f64>) -> Isometry3<f64> {
        transform::placed_from_observed(observed_centroid, &self.centroid(), f64::from(self.yaw_rad))
    }

    /// Where something at a horizontal `offset` from the observed centroid goes, seen from above, world frame.
    pub fn carry(&self, offset: &Vector2<f32>) -> Point2<f32> {
        self.carrying().place(offset)
    }

    /// [`CandidatePose::carry`] for many offsets: the turn is computed once.
    pub fn carrying(&self) -> Carry {
        let [x, y, _] = self.centroid_m;
        Carry::new(Point2::new(x, y), self.yaw_rad)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_carried_offset_agrees_with_the_rigid_motion() {
        let observed = Point3::new(0.3, -0.2, 0.1);
        let candidate = CandidatePose::new(&Point3::new(0.5, 0.1, 0.2), 0.7);
        let offset = Vector2::new(0.05f32, -0.02);
        let moved = candidate.placed_from_observed(&observed) * (observed + Vector2::new(0.05, -0.02).push(0.0));
        assert!((candidate.carry(&offset).cast::<f64>() - moved.xy()).norm() < 1e-6);
        assert_eq!(CandidatePose::from_row(candidate.row()), candidate);
    }
}
