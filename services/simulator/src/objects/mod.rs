//! Things to put on tables: a shape to look at, convex parts to collide with, and what it weighs.
//!
//! Families are procedural (paper, section 3 and appendix: mugs, bowls, plates, bottles, pots, boxes, cylinders and small things; its
//! scanned models may not be redistributed). Hollow things are hollow for physics too: their walls are convex wedges, cut at the same
//! angles as the picture's facets, so that what is seen is what is touched.

pub mod body;
pub mod families;
pub mod revolution;

use nalgebra::{Isometry3, Vector3};
use parry3d::shape::SharedShape;
use rapier3d::math::Pose;
use repose_geometry::{OrientedBox, TriMesh};

pub use families::Family;

/// A flat place on top of an upright object where another can stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Top {
    /// Height above the object's origin, metres.
    pub height_m: f32,
    /// Half the edge lengths of the largest level rectangle there, metres.
    pub half_extents_m: [f32; 2],
}

/// A rigid object in its own frame: origin at the centre of its box, z up when it stands as intended.
#[derive(Debug, Clone)]
pub struct Shape {
    /// What it is, as labels and logs say it.
    pub family: Family,
    /// Closed surface, outward oriented.
    pub mesh: TriMesh,
    /// Convex parts: pose in the object's frame, and shape.
    pub parts: Vec<(Pose, SharedShape)>,
    /// Half the edge lengths of the box around the mesh.
    pub half_extents_m: Vector3<f64>,
    /// Mass.
    pub mass_kg: f32,
    /// Coulomb friction coefficient; a contact takes the mean of the two.
    pub friction: f32,
    /// Where another object can stand, if anywhere.
    pub top: Option<Top>,
}

impl Shape {
    /// The object's box in the world; its axes are the object's.
    pub fn bounds(&self, world_from_object: &Isometry3<f64>) -> OrientedBox {
        OrientedBox { world_from_box: *world_from_object, half_extents: self.half_extents_m }
    }

    /// One collision shape of all parts.
    pub fn collider(&self) -> SharedShape {
        match self.parts.as_slice() {
            [(pose, shape)] if *pose == Pose::IDENTITY => shape.clone(),
            parts => SharedShape::compound(parts.to_vec()),
        }
    }

    /// How far the mesh reaches below the origin when turned by the rotation of `world_from_object`, metres.
    pub fn depth_below_origin_m(&self, world_from_object: &Isometry3<f64>) -> f64 {
        let down = world_from_object.rotation.inverse_transform_vector(&-Vector3::z()).cast::<f32>();
        f64::from(self.mesh.vertices.iter().map(|v| v.coords.dot(&down)).fold(f32::NEG_INFINITY, f32::max))
    }

    /// Half the diagonal of the box: the object fits into a ball of this radius, metres.
    pub fn radius_m(&self) -> f64 {
        self.half_extents_m.norm()
    }
}
