//! An object in a scene.

use std::sync::Arc;

use nalgebra::Isometry3;

use crate::objects::ObjectShape;

/// An object in a scene.
#[derive(Debug, Clone)]
pub struct SceneObject {
    /// Instance id, from 1.
    pub id: u16,
    /// What it is.
    pub shape: Arc<ObjectShape>,
    /// Where it rests.
    pub world_from_object: Isometry3<f64>,
    /// Color in full light.
    pub color: [u8; 3],
}
