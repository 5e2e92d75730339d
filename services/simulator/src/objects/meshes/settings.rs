//! How a folder of meshes becomes objects.

use std::path::PathBuf;

use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Which way is up in a mesh file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum UpAxis {
    /// As in the world here.
    #[default]
    Z,
    /// As graphics programs often have it.
    Y,
}

impl UpAxis {
    /// The rotation that makes z up.
    pub fn world_from_file(self) -> UnitQuaternion<f32> {
        match self {
            Self::Z => UnitQuaternion::identity(),
            Self::Y => UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f32::consts::FRAC_PI_2),
        }
    }
}

/// How a folder of meshes becomes objects. A sidecar beside a mesh (see [`super::sidecar`]) overrides what concerns one object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MeshSettings {
    /// Metres per unit of the files. Default 1; 0.001 for millimetres. Never guessed.
    pub scale: f32,
    /// Which way is up in the files. Default z.
    pub up: UpAxis,
    /// Mass per enclosed volume where no sidecar gives a mass, kg/m³. Default 400, about that of filled packaging.
    pub density_kg_m3: f32,
    /// Coulomb friction coefficient where no sidecar gives one. Default 0.5. Scenes draw their own there.
    pub friction: f32,
    /// Most triangles that a file may have. Default 1,000,000; more is refused, not thinned.
    pub max_triangles: usize,
    /// Triangles that are drawn, as far as `tolerance_m` allows. Default 1,500; fewer draw faster.
    pub drawn_triangles: usize,
    /// How far the drawn surface may stray from the file's, metres. Default 0.0005.
    pub tolerance_m: f32,
    /// The convex decomposition.
    pub decomposition: DecompositionSettings,
    /// Where finished objects are kept. Default: `.repose-cache` in the folder of meshes; where that cannot be written, nothing is kept.
    pub cache: Option<PathBuf>,
}

impl Default for MeshSettings {
    fn default() -> Self {
        Self {
            scale: 1.0,
            up: UpAxis::default(),
            density_kg_m3: 400.0,
            friction: 0.5,
            max_triangles: 1_000_000,
            drawn_triangles: 1500,
            tolerance_m: 0.0005,
            decomposition: DecompositionSettings::default(),
            cache: None,
        }
    }
}

/// How a surface is cut into convex parts (approximate convex decomposition, V-HACD).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DecompositionSettings {
    /// Whether the solids of a `convex_parts.stl` (or `.obj`, `.ply`) beside a mesh are taken as its parts; it must be the only mesh of its
    /// folder. Default true: whoever made them looked at them; false decomposes again.
    pub ready_parts: bool,
    /// Voxels along the longest edge. Default 128; more follows thin walls closer and takes its third power in time.
    pub resolution: u32,
    /// Concavity (share of the volume) at which cutting ends. Default 0.002; lower cuts into more parts.
    pub concavity: f32,
    /// Convex parts at most, give or take one. Default 40; more settle slower.
    pub max_parts: u32,
    /// Most corners of a part. Default 48; more settle slower.
    pub max_corners: usize,
}

impl Default for DecompositionSettings {
    fn default() -> Self {
        Self { ready_parts: true, resolution: 128, concavity: 0.002, max_parts: 40, max_corners: 48 }
    }
}
