//! A scene that an agent was shown.

use repose_proto::Scene;

/// Digits of a scene's id that an agent is given: enough for those held here.
const HANDLE: usize = 12;

/// A scene that an agent was shown, with its full id.
#[derive(Debug)]
pub struct ShownScene {
    /// The id.
    pub scene_id: String,
    /// The scene.
    pub scene: Scene,
}

impl ShownScene {
    /// What agents call it.
    pub fn handle(&self) -> &str {
        handle(&self.scene_id)
    }

    /// The size of its points, bytes.
    pub fn bytes(&self) -> usize {
        // Coordinates, label and color of a point.
        self.scene.points.len() * (12 + 2 + 3)
    }
}

/// What agents call a scene of this id.
pub fn handle(scene_id: &str) -> &str {
    &scene_id[..HANDLE.min(scene_id.len())]
}
