//! A level rectangle of furniture where objects can stand.

use nalgebra::{Isometry3, Point3, Vector2};

use super::FurnitureRole;

/// A surface of a piece of furniture that objects can stand on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FurnitureSurface {
    /// What it belongs to.
    pub role: FurnitureRole,
    /// The surface's frame: origin in its middle, x and y along its edges, z up.
    pub world_from_surface: Isometry3<f64>,
    /// Half its edge lengths, metres.
    pub half_extents_m: Vector2<f64>,
    /// Free height above it, metres; infinite under the open sky.
    pub clear_m: f64,
    /// How often objects are put here, relative to the scene's other surfaces; on a surface with 0 they may only come to rest.
    pub weight: f64,
}

impl FurnitureSurface {
    /// A surface under the open sky around a point of furniture that is not turned.
    pub fn open(role: FurnitureRole, middle: Point3<f64>, half_extents_m: Vector2<f64>, weight: f64) -> Self {
        let world_from_surface = Isometry3::translation(middle.x, middle.y, middle.z);
        Self { role, world_from_surface, half_extents_m, clear_m: f64::INFINITY, weight }
    }

    /// Its height in the world, metres.
    pub fn height_m(&self) -> f64 {
        self.world_from_surface.translation.z
    }

    /// Whether a point of the world is over it: within its edges, not more than `below_m` lower, and under what covers it.
    pub fn is_under(&self, point: &Point3<f64>, below_m: f64) -> bool {
        let at = self.world_from_surface.inverse_transform_point(point);
        let within = at.x.abs() <= self.half_extents_m.x && at.y.abs() <= self.half_extents_m.y;
        within && at.z >= -below_m && at.z < self.clear_m
    }
}
