//! The whole surface of an object, which tells how it may be set up otherwise than it was seen.

use nalgebra::Point2;
use repose_geometry::cloud;

use crate::scene::prepared::PreparedScene;
use crate::scene::traits::{StandingTraits, VOXEL_M};
use repose_belief::BelievedObject;
use repose_belief::settings::BeliefSettings;
use repose_belief::shape::Shape;
use repose_belief::solid::Solid;

/// What an object's whole surface is believed to be.
pub fn solid_of(prepared: &PreparedScene, id: u16, object: &BelievedObject, shape: &Shape) -> Solid {
    let traits = StandingTraits::of(prepared, id, shape, &cloud::voxel_downsampled(&object.points, VOXEL_M));
    if traits.leans() { Solid::leaning(&object.points, shape) } else { Solid::standing(&object.points, shape) }
}

/// The prisms around a whole surface.
pub fn completed(solid: &Solid) -> Option<Shape> {
    let bottom_m = solid.points.iter().map(|p| p.z).fold(f32::INFINITY, f32::min);
    // Whoever sees all of it looks from above.
    let eye: Point2<f32> = solid.center_of_mass.xy();
    Shape::complete(&solid.points, bottom_m, &eye, &BeliefSettings::default().shape)
}
