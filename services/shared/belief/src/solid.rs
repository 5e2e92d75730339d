//! The whole surface of an object as points, guessed from the half of it that a camera saw: what tells on which sides it could stand.
//!
//! An object that stands by itself looks from behind as it does from the front: its hidden half is the visible one, turned by half a turn about
//! its upright axis (as in [`crate::shape`]), and it stands on its base. One that leans has no upright axis: its hidden half is the
//! visible one reflected through its middle, which is right for boxes and tubes in any attitude.

use nalgebra::{Isometry3, Point3, UnitQuaternion};
use repose_geometry::cloud;

use crate::far_side::far_side;
use crate::front::Front;
use crate::settings::ShapeSettings;
use crate::shape::Shape;

/// Distance between its points, metres.
const VOXEL_M: f32 = 0.004;

/// A completed surface, world frame.
#[derive(Debug, Clone, PartialEq)]
pub struct CompletedSurface {
    /// Points all over it.
    pub points: Vec<Point3<f32>>,
    /// How many of them were seen: the first ones.
    pub seen: usize,
    /// Where its centre of mass is believed to be.
    pub center_of_mass: Point3<f32>,
}

impl CompletedSurface {
    /// Of an object that stands by itself.
    pub fn standing(seen: &[Point3<f32>], shape: &Shape) -> Self {
        let seen = cloud::voxel_downsampled(seen, VOXEL_M);
        let far = far_side(&seen, &shape.turn_axis);
        let base = shape.turn_base.corners().iter().map(|c| Point3::new(c.x, c.y, shape.bottom_m));
        let count = seen.len();
        let points = seen.into_iter().chain(far).chain(base).collect();
        let volumes = shape.slabs.iter().map(|s| (s.outline.area() * (s.high_m - s.low_m), (s.low_m + s.high_m) / 2.0));
        let (volume, moment) = volumes.fold((0.0, 0.0), |(sum, moment), (v, z)| (sum + v, moment + v * z));
        let height_m = if volume > 0.0 { moment / volume } else { (shape.bottom_m + shape.top_m) / 2.0 };
        Self { points, seen: count, center_of_mass: Point3::new(shape.axis.x, shape.axis.y, height_m) }
    }

    /// Of an object that leans on something.
    pub fn leaning(seen: &[Point3<f32>], shape: &Shape) -> Self {
        let seen = cloud::voxel_downsampled(seen, VOXEL_M);
        let middle = Point3::new(shape.turn_axis.x, shape.turn_axis.y, (shape.bottom_m + shape.top_m) / 2.0);
        let points = seen.iter().copied().chain(seen.iter().map(|p| middle + (middle - p))).collect();
        Self { points, seen: seen.len(), center_of_mass: middle }
    }

    /// The prisms around it after a motion of the object whose shape it was completed from; `None` when it has no extent seen from above. Where more of
    /// that object's back may be has gone with it, and what was doubtful of its foot is so of one of its sides.
    pub fn shape_after(&self, motion: &Isometry3<f64>, before: &Shape, settings: &ShapeSettings) -> Option<Shape> {
        let bottom_m = self.points.iter().map(|p| p.z).fold(f32::INFINITY, f32::min);
        // Whoever sees all of it looks from above.
        let middle = self.center_of_mass.xy();
        let around = Shape::of_surface(&Front::of(&self.points, bottom_m, &middle, settings)?, middle, settings)?;
        Some(Shape {
            doubt: before.doubt_after(motion),
            ends: before.ends_after(motion),
            foot_probability: before.foot_probability,
            ..around
        })
    }

    /// The same after a motion.
    pub fn moved(&self, motion: &Isometry3<f64>) -> Self {
        let carry = |p: &Point3<f32>| (motion * p.cast::<f64>()).cast::<f32>();
        Self { points: self.points.iter().map(carry).collect(), center_of_mass: carry(&self.center_of_mass), ..*self }
    }

    /// Share of what it stands on that was seen: of its points within `contact_m` of the lowest.
    pub fn seen_base_share(&self, contact_m: f32) -> f64 {
        let low_m = self.points.iter().map(|p| p.z).fold(f32::INFINITY, f32::min);
        let base = self.points.iter().enumerate().filter(|(_, p)| p.z <= low_m + contact_m);
        let (seen, all) = base.fold((0usize, 0usize), |(seen, all), (i, _)| (seen + usize::from(i < self.seen), all + 1));
        seen as f64 / all.max(1) as f64
    }

    /// The same turned about the origin.
    pub fn turned(&self, by: &UnitQuaternion<f64>) -> Self {
        self.moved(&Isometry3::from_parts(nalgebra::Translation3::identity(), *by))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_base_was_seen_as_far_as_its_points_were() {
        let at = |x: f32, z: f32| Point3::new(x, 0.0, z);
        let points = vec![at(0.0, 0.0), at(0.1, 0.1), at(0.2, 0.001), at(0.3, 0.002), at(0.4, 0.1)];
        let solid = CompletedSurface { points, seen: 3, center_of_mass: Point3::origin() };
        assert!((solid.seen_base_share(0.003) - 2.0 / 3.0).abs() < 1e-9);
        let over = UnitQuaternion::from_axis_angle(&nalgebra::Vector3::y_axis(), std::f64::consts::PI);
        assert_eq!(solid.turned(&over).seen_base_share(0.003), 0.5);
    }
}
