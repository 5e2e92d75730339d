//! The horizontal surfaces of a scene, as perception found them.

use repose_geometry::Footprint;

/// A horizontal surface that was seen.
#[derive(Debug, Clone, PartialEq)]
pub struct SupportPlane {
    /// World z, metres.
    pub height_m: f32,
    /// Outline of what was seen of it, world frame.
    pub outline: Footprint,
    /// The object whose top it is, 0 for furniture.
    pub object: u16,
}

impl SupportPlane {
    /// The plane of a surface on the wire; none when its outline has no area.
    pub fn of(surface: &repose_proto::Surface) -> Option<Self> {
        let outline = Footprint::of_outline(&surface.outline_m)?;
        Some(Self { height_m: surface.height_m as f32, outline, object: surface.object.unwrap_or(0) })
    }
}
