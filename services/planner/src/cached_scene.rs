//! A scene as a worker keeps it: prepared when it is first planned on, so that many requests on one scene prepare it once.

use std::sync::{Arc, OnceLock};

use repose_proto::Scene;

use crate::scene::prepared::PreparedScene;

/// A scene that is prepared when it is first planned on.
#[derive(Debug)]
pub struct CachedScene {
    scene_id: String,
    scene: Arc<Scene>,
    prepared: OnceLock<Arc<PreparedScene>>,
}

impl CachedScene {
    /// A scene under its id, not prepared yet.
    pub fn new(scene_id: String, scene: Arc<Scene>) -> Self {
        Self { scene_id, scene, prepared: OnceLock::new() }
    }

    /// The scene, prepared. The first caller prepares it; others that come meanwhile wait for that.
    pub fn prepared(&self) -> &Arc<PreparedScene> {
        self.prepared.get_or_init(|| Arc::new(PreparedScene::with_id(self.scene.clone(), self.scene_id.clone())))
    }
}
