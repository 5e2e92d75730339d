//! Things to put on tables: a shape to look at, convex parts to collide with, what it weighs, and what can be done with it.
//!
//! Families are procedural (paper, section 3 and appendix: mugs, bowls, plates, bottles, pots, boxes, cylinders and small things; its
//! scanned models may not be redistributed). Hollow things are hollow for physics too: their walls are convex wedges, cut at the same
//! angles as the picture's facets, so that what is seen is what is touched.

pub mod bar;
pub mod body;
#[cfg(test)]
mod checks;
pub mod color;
pub mod families;
pub mod loft;
pub mod material;
pub mod meshes;
pub mod outline;
pub mod source;

use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};
use parry3d::shape::SharedShape;
use rapier3d::math::Pose;
use repose_geometry::{OrientedBox, TriMesh};

pub use families::Family;
pub use meshes::{MeshError, MeshLibrary, MeshSettings};
pub use source::ObjectSource;

/// A flat place on top of an upright object where another can stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Top {
    /// Its middle (x, y) in the object's frame, metres.
    pub center_m: [f32; 2],
    /// Height above the object's origin, metres.
    pub height_m: f32,
    /// Half the edge lengths of a large level rectangle there, metres.
    pub half_extents_m: [f32; 2],
}

/// The inside of an upright vessel that is open above.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VesselInterior {
    /// The axis (x, y) in the object's frame, metres: not the box's where a handle sticks out.
    pub center_m: [f32; 2],
    /// Height of the level inner floor above the object's origin, metres (negative: below).
    pub floor_m: f32,
    /// Height of the rim above the object's origin, metres.
    pub rim_m: f32,
    /// Radius of the upright cylinder around the axis that is clear from the floor to the rim, metres.
    pub radius_m: f32,
    /// Radius of the largest ball around the axis that fits through the rim, metres.
    pub mouth_radius_m: f32,
    /// Half the edge lengths (x, y) of the upright cuboid that is clear from the floor to the rim, metres.
    pub half_extents_m: [f32; 2],
}

/// A rigid object in its own frame: origin at the centre of its box, z up when it stands as intended.
#[derive(Debug, Clone)]
pub struct ObjectShape {
    /// What it is, as labels and logs say it: `mug`, `hammer`, or the name of the user's mesh.
    pub name: Arc<str>,
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
    /// Whether that is this object's own, from a sidecar; scenes draw the friction of all others.
    pub is_friction_known: bool,
    /// Where another object can stand, if anywhere.
    pub top: Option<Top>,
    /// What it can hold, if anything.
    pub opening: Option<VesselInterior>,
}

impl ObjectShape {
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
