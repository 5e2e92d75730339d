//! Prepared scenes by id, so that many requests on one scene prepare it once; bounded, least recently used out.

use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use lru::LruCache;
use repose_proto::{CallError, Scene};

use crate::scene::prepared::PreparedScene;

/// A scene that is prepared when it is first planned on.
#[derive(Debug)]
pub struct CachedScene {
    scene_id: String,
    scene: Arc<Scene>,
    prepared: OnceLock<PreparedScene>,
}

impl CachedScene {
    /// The scene, prepared. The first caller prepares it; others that come meanwhile wait for that.
    pub fn prepared(&self) -> &PreparedScene {
        self.prepared.get_or_init(|| PreparedScene::with_id(self.scene.clone(), self.scene_id.clone()))
    }
}

/// The scenes that a worker keeps.
#[derive(Debug)]
pub struct SceneCache {
    scenes: Mutex<LruCache<String, Arc<CachedScene>>>,
}

impl SceneCache {
    /// An empty cache; it holds one scene at least.
    pub fn new(capacity: usize) -> Self {
        Self { scenes: Mutex::new(LruCache::new(NonZeroUsize::new(capacity).unwrap_or(NonZeroUsize::MIN))) }
    }

    /// A scene by its id.
    pub fn get(&self, scene_id: &str) -> Option<Arc<CachedScene>> {
        self.scenes().get(scene_id).cloned()
    }

    /// Keeps a scene under the id that a request gave it. Hashes the scene.
    ///
    /// # Errors
    /// `invalid_argument` on `scene.scene_id` when it is not the scene's.
    pub fn insert(&self, scene_id: &str, scene: Scene) -> Result<Arc<CachedScene>, CallError> {
        let actual = scene.id();
        if actual != scene_id {
            return Err(CallError::invalid("scene.scene_id", format!("the scene's id is {actual}, not {scene_id}")));
        }
        let new = || Arc::new(CachedScene { scene_id: actual.clone(), scene: Arc::new(scene), prepared: OnceLock::new() });
        Ok(self.scenes().get_or_insert(actual.clone(), new).clone())
    }

    fn scenes(&self) -> MutexGuard<'_, LruCache<String, Arc<CachedScene>>> {
        // Every change leaves the cache whole, so a panic elsewhere under the lock does not spoil it.
        self.scenes.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use repose_proto::ErrorCode;

    use super::*;
    use crate::tests::synthetic::SceneBuilder;

    #[test]
    fn the_least_recently_used_scene_goes_and_a_wrong_id_is_refused() {
        let scenes = [0.1, 0.2, 0.3].map(|x| SceneBuilder::table().object(1, [x, 0.0], [0.1, 0.1, 0.1]).scene());
        let ids = scenes.each_ref().map(Scene::id);
        let cache = SceneCache::new(2);
        let [a, b, c] = scenes;
        cache.insert(&ids[0], a).unwrap();
        cache.insert(&ids[1], b).unwrap();
        assert!(cache.get(&ids[0]).is_some());
        assert_eq!(cache.insert(&ids[0], c.clone()).unwrap_err().code, ErrorCode::InvalidArgument);
        cache.insert(&ids[2], c).unwrap();
        assert!(cache.get(&ids[0]).is_some() && cache.get(&ids[1]).is_none());
        assert_eq!(cache.get(&ids[2]).unwrap().prepared().objects.len(), 1);
    }
}
