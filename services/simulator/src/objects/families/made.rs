//! What a family's maker hands back, and how it becomes a shape.

use super::super::body::{Body, Finish};
use super::super::material::{Mass, Material};
use super::super::outline::Outline;
use super::super::{ObjectShape, Top, VesselInterior};
use super::draw::Draw;

/// An object with its geometry done.
pub struct Made {
    name: &'static str,
    body: Body,
    material: Material,
    mass: Mass,
    top: Option<Top>,
    opening: Option<VesselInterior>,
}

impl Made {
    /// Of one material all through.
    pub fn solid(name: &'static str, body: Body, material: Material) -> Self {
        Self { name, body, material, mass: Mass::Solid, top: None, opening: None }
    }

    /// A skin around contents.
    pub fn filled(name: &'static str, body: Body, material: Material, skin_m: f32, content_kg_m3: f32) -> Self {
        Self { name, body, material, mass: Mass::Filled { skin_m, content_kg_m3 }, top: None, opening: None }
    }

    /// With a flat place on top.
    pub fn with_top(self, center_m: [f32; 2], height_m: f32, half_extents_m: [f32; 2]) -> Self {
        Self { top: Some(Top { center_m, height_m, half_extents_m }), ..self }
    }

    /// With a flat place on top: the ring of this radius around the axis.
    pub fn with_round_top(self, outline: &Outline, radius: f32, height_m: f32) -> Self {
        self.with_top([0.0, 0.0], height_m, outline.inner_half_extents().map(|half| half * radius))
    }

    /// A vessel.
    pub fn with_opening(self, opening: VesselInterior) -> Self {
        Self { opening: Some(opening), ..self }
    }

    /// The finished shape, of random density and friction within its material's.
    pub fn shape(self, draw: &mut Draw) -> ObjectShape {
        let [light, heavy] = self.material.density_kg_m3();
        let [slippery, rough] = self.material.friction();
        let (volume_m3, area_m2) = self.body.volume_and_area();
        let mass_kg = self.mass.of(draw.between(light, heavy), volume_m3, area_m2);
        let friction = draw.between(slippery, rough);
        self.body.finish(&Finish { name: self.name, mass_kg, friction, top: self.top, opening: self.opening })
    }
}
