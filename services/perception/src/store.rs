//! The scenes that can still be asked for: bounded in number and in bytes, the least recently asked for goes first. And which of them
//! is each camera's newest.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use repose_proto::{Payload, SceneSummary};

/// What a warning of [`KeptScene::left_out`] says.
pub const LEFT_OUT: &str = "labelled, but too thin or too small to be objects; what was read of them stays in the scene as nobody's";

/// A scene in the form that it is answered with, so that answering copies nothing.
#[derive(Debug, Clone, PartialEq)]
pub struct KeptScene {
    /// What `latest` answers and the scene's topic carries; names the id.
    pub summary: SceneSummary,
    /// The scene in bulk form.
    pub payload: Payload,
    /// Ids of the frame's masks that are no objects of the scene.
    pub left_out: Vec<u16>,
}

/// How much a [`SceneStore`] holds, and what it takes for late.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StoreLimits {
    /// Most scenes.
    pub scenes: usize,
    /// Most bytes of their bulk forms; a single larger scene is still kept.
    pub bytes: usize,
    /// Most cameras whose newest scene is known.
    pub cameras: usize,
    /// A stamp this much before its camera's newest is late; an earlier one says that the camera's clock was set back.
    pub late_ns: u64,
}

/// Scenes by id, and the newest of each camera.
#[derive(Debug)]
pub struct SceneStore {
    limits: StoreLimits,
    scenes: BTreeMap<String, Arc<KeptScene>>,
    /// Ids, least recently used first.
    order: VecDeque<String>,
    bytes: usize,
    latest: BTreeMap<String, Newest>,
    /// Scenes of streams so far.
    streamed: u64,
}

/// A camera's newest scene.
#[derive(Debug)]
struct Newest {
    summary: SceneSummary,
    left_out: Vec<u16>,
    /// Its number among the scenes of streams.
    number: u64,
}

/// What became of a camera's scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrival {
    /// It is the camera's newest.
    Newest,
    /// It is the camera's newest, although its stamp is far before the last one's.
    Restarted,
    /// The camera has a newer one already.
    Late,
}

impl SceneStore {
    /// An empty store; at least one scene is held whatever the limits say.
    pub fn new(limits: StoreLimits) -> Self {
        Self { limits, scenes: BTreeMap::new(), order: VecDeque::new(), bytes: 0, latest: BTreeMap::new(), streamed: 0 }
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

    /// Keeps a scene of a camera's stream. Scenes come in the order of their frames, so it is the camera's newest, unless its stamp says
    /// that its frame was overtaken on the way: only a little before the newest one's, for a clock may also have been wrong.
    pub fn keep_latest(&mut self, scene: Arc<KeptScene>) -> Arrival {
        let summary = scene.summary.clone();
        let newest_ns = self.latest.get(&summary.camera).map_or(0, |newest| newest.summary.stamp_ns);
        let arrival = match newest_ns.saturating_sub(summary.stamp_ns) {
            0 => Arrival::Newest,
            back_ns if back_ns > self.limits.late_ns => Arrival::Restarted,
            _ => return Arrival::Late,
        };
        let left_out = scene.left_out.clone();
        self.keep(scene);
        self.streamed += 1;
        self.latest.insert(summary.camera.clone(), Newest { summary, left_out, number: self.streamed });
        if self.latest.len() > self.limits.cameras.max(1)
            && let Some(gone) = self.latest.iter().min_by_key(|(_, newest)| newest.number).map(|(camera, _)| camera.clone())
        {
            self.latest.remove(&gone);
        }
        arrival
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
        self.latest.get(camera).map(|newest| &newest.summary)
    }

    /// [`KeptScene::left_out`] of that scene.
    pub fn left_out(&self, camera: &str) -> &[u16] {
        self.latest.get(camera).map_or(&[], |newest| &newest.left_out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(id: &str, camera: &str, stamp_ns: u64, bytes: usize) -> Arc<KeptScene> {
        let summary =
            SceneSummary { scene_id: id.to_owned(), camera: camera.to_owned(), stamp_ns, objects: Vec::new(), surfaces: Vec::new() };
        Arc::new(KeptScene { summary, payload: Payload { encoding: String::new(), bytes: vec![0; bytes].into() }, left_out: Vec::new() })
    }

    fn store(scenes: usize, bytes: usize) -> SceneStore {
        SceneStore::new(StoreLimits { scenes, bytes, cameras: 2, late_ns: 10 })
    }

    #[test]
    fn the_least_recently_asked_for_goes_first() {
        let mut store = store(2, 1000);
        store.keep(scene("a", "c", 1, 10));
        store.keep(scene("b", "c", 2, 10));
        assert!(store.get("a").is_some());
        store.keep(scene("c", "c", 3, 10));
        assert!(store.get("a").is_some() && store.get("b").is_none() && store.get("c").is_some());
    }

    #[test]
    fn bytes_are_bounded_and_the_same_scene_counts_once() {
        let mut store = store(10, 100);
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
        let mut store = store(10, 100);
        assert_eq!(store.keep_latest(scene("a", "left", 5, 1)), Arrival::Newest);
        assert_eq!(store.keep_latest(scene("b", "left", 4, 1)), Arrival::Late);
        assert_eq!(store.keep_latest(scene("c", "right", 1, 1)), Arrival::Newest);
        assert_eq!(store.latest("left").unwrap().scene_id, "a");
        assert_eq!(store.latest("nobody"), None);
    }

    #[test]
    fn one_stamp_from_the_future_does_not_silence_a_camera() {
        let mut store = store(10, 100);
        assert_eq!(store.keep_latest(scene("a", "left", 1000, 1)), Arrival::Newest);
        assert_eq!(store.keep_latest(scene("b", "left", 990, 1)), Arrival::Late);
        assert_eq!(store.keep_latest(scene("c", "left", 100, 1)), Arrival::Restarted);
        assert_eq!(store.latest("left").unwrap().scene_id, "c");
        assert_eq!(store.keep_latest(scene("d", "left", 101, 1)), Arrival::Newest);
    }

    #[test]
    fn the_number_of_cameras_is_bounded_and_the_longest_silent_one_goes() {
        let mut store = store(10, 100);
        for camera in ["a", "b", "a", "c"] {
            store.keep_latest(scene(camera, camera, 1, 1));
        }
        assert_eq!(["a", "b", "c"].map(|camera| store.latest(camera).is_some()), [true, false, true]);
    }
}
