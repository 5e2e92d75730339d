//! The scenes that can still be asked for: bounded in number and in bytes, the least recently asked for goes first.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use repose_proto::{Payload, SceneSummary};

/// A scene in the form that it is answered with, so that answering copies nothing.
#[derive(Debug, Clone, PartialEq)]
pub struct KeptScene {
    /// What `latest` answers and the scene's topic carries; names the id.
    pub summary: SceneSummary,
    /// The scene in bulk form.
    pub payload: Payload,
}

/// How much a [`SceneStore`] holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StoreLimits {
    /// Most scenes.
    pub scenes: usize,
    /// Most bytes of their bulk forms; a single larger scene is still kept.
    pub bytes: usize,
}

/// Scenes by id, and the newest of each camera.
#[derive(Debug)]
pub struct SceneStore {
    limits: StoreLimits,
    scenes: BTreeMap<String, Arc<KeptScene>>,
    /// Ids, least recently used first.
    order: VecDeque<String>,
    bytes: usize,
    latest: BTreeMap<String, SceneSummary>,
}

/// What became of a camera's scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrival {
    /// It is the camera's newest.
    Newest,
    /// The camera has a newer one already.
    Late,
}

impl SceneStore {
    /// An empty store; at least one scene is held whatever the limits say.
    pub fn new(limits: StoreLimits) -> Self {
        Self { limits, scenes: BTreeMap::new(), order: VecDeque::new(), bytes: 0, latest: BTreeMap::new() }
    }

    /// Keeps a scene under its id. The same content again is kept once, with the newer stamp.
    pub fn keep(&mut self, scene: Arc<KeptScene>) {
        let id = scene.summary.scene_id.clone();
        self.bytes += scene.payload.bytes.len();
        if let Some(old) = self.scenes.insert(id.clone(), scene) {
            self.bytes -= old.payload.bytes.len();
            self.order.retain(|other| *other != id);
        }
        self.order.push_back(id);
        while self.order.len() > 1 && (self.order.len() > self.limits.scenes || self.bytes > self.limits.bytes) {
            if let Some(gone) = self.order.pop_front().and_then(|id| self.scenes.remove(&id)) {
                self.bytes -= gone.payload.bytes.len();
            }
        }
    }

    /// Keeps a scene of a camera's stream, as the camera's newest unless a newer one came before.
    pub fn keep_latest(&mut self, scene: Arc<KeptScene>) -> Arrival {
        let summary = scene.summary.clone();
        if self.latest.get(&summary.camera).is_some_and(|newest| newest.stamp_ns > summary.stamp_ns) {
            return Arrival::Late;
        }
        self.keep(scene);
        self.latest.insert(summary.camera.clone(), summary);
        Arrival::Newest
    }

    /// A scene by id.
    pub fn get(&mut self, scene_id: &str) -> Option<Arc<KeptScene>> {
        let scene = self.scenes.get(scene_id)?.clone();
        if let Some(at) = self.order.iter().position(|id| id == scene_id)
            && let Some(id) = self.order.remove(at)
        {
            self.order.push_back(id);
        }
        Some(scene)
    }

    /// The newest scene of a camera's stream.
    pub fn latest(&self, camera: &str) -> Option<&SceneSummary> {
        self.latest.get(camera)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(id: &str, camera: &str, stamp_ns: u64, bytes: usize) -> Arc<KeptScene> {
        let summary =
            SceneSummary { scene_id: id.to_owned(), camera: camera.to_owned(), stamp_ns, objects: Vec::new(), surfaces: Vec::new() };
        Arc::new(KeptScene { summary, payload: Payload { encoding: String::new(), bytes: vec![0; bytes].into() } })
    }

    #[test]
    fn the_least_recently_asked_for_goes_first() {
        let mut store = SceneStore::new(StoreLimits { scenes: 2, bytes: 1000 });
        store.keep(scene("a", "c", 1, 10));
        store.keep(scene("b", "c", 2, 10));
        assert!(store.get("a").is_some());
        store.keep(scene("c", "c", 3, 10));
        assert!(store.get("a").is_some() && store.get("b").is_none() && store.get("c").is_some());
    }

    #[test]
    fn bytes_are_bounded_and_the_same_scene_counts_once() {
        let mut store = SceneStore::new(StoreLimits { scenes: 10, bytes: 100 });
        for stamp_ns in 0..5 {
            store.keep(scene("same", "c", stamp_ns, 60));
        }
        assert_eq!((store.bytes, store.order.len()), (60, 1));
        assert_eq!(store.get("same").unwrap().summary.stamp_ns, 4);
        store.keep(scene("other", "c", 9, 60));
        assert!(store.get("same").is_none() && store.get("other").is_some());
        store.keep(scene("huge", "c", 9, 5000));
        assert_eq!((store.bytes, store.order.len()), (5000, 1));
    }

    #[test]
    fn a_late_frame_does_not_become_the_newest() {
        let mut store = SceneStore::new(StoreLimits { scenes: 10, bytes: 100 });
        assert_eq!(store.keep_latest(scene("a", "left", 5, 1)), Arrival::Newest);
        assert_eq!(store.keep_latest(scene("b", "left", 4, 1)), Arrival::Late);
        assert_eq!(store.keep_latest(scene("c", "right", 1, 1)), Arrival::Newest);
        assert_eq!(store.latest("left").unwrap().scene_id, "a");
        assert_eq!(store.latest("nobody"), None);
    }
}
