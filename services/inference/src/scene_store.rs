//! Scenes held by id, with what the networks need of them; bounded, least recently used out.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use lru::LruCache;
use nalgebra::Point3;
use repose_networks::SceneContext;
use repose_networks::points::{CloudConfig, Observer};
use repose_proto::{CallError, RigidTransform, Scene};

/// Viewers prepared per scene; requests on a scene nearly always share one.
const VIEWERS: usize = 4;

/// A scene and its clouds in network form, for each viewer that was asked for.
#[derive(Debug)]
pub struct HeldScene {
    scene_id: String,
    scene: Arc<Scene>,
    border_px: Option<f32>,
    prepared: Mutex<Vec<(u64, Arc<SceneContext>)>>,
}

impl HeldScene {
    /// Holds a scene under its id.
    pub fn new(scene_id: String, scene: Arc<Scene>) -> Self {
        Self { scene_id, scene, border_px: None, prepared: Mutex::default() }
    }

    /// The same scene, cleaned with another band around the masks than perception's, pixels.
    pub fn cleaned_by(self, border_px: f32) -> Self {
        Self { border_px: Some(border_px), ..self }
    }

    /// The id.
    pub fn scene_id(&self) -> &str {
        &self.scene_id
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// The scene as the networks see it from a viewing direction; prepared once per direction.
    ///
    /// # Errors
    /// `invalid_argument` when the cloud cannot be prepared.
    pub fn prepared(&self, view_yaw_rad: f64, config: &CloudConfig) -> Result<Arc<SceneContext>, CallError> {
        // The lock is held while preparing, so that concurrent requests on a new scene do the work once.
        let mut prepared = self.prepared.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, context)) = prepared.iter().find(|(bits, _)| *bits == view_yaw_rad.to_bits()) {
            return Ok(context.clone());
        }
        let points: Vec<Point3<f32>> = self.scene.points.iter().map(|p| Point3::from(*p)).collect();
        let config = CloudConfig { border_px: self.border_px.unwrap_or(config.border_px), ..*config };
        let context = SceneContext::new(&points, &self.scene.labels, view_yaw_rad, &observer_of(&self.scene), &config);
        let context = Arc::new(context.map_err(|e| CallError::invalid("scene", e.to_string()))?);
        if prepared.len() == VIEWERS {
            prepared.remove(0);
        }
        prepared.push((view_yaw_rad.to_bits(), context.clone()));
        Ok(context)
    }

    /// Roughly how much memory the scene and its preparations take, bytes.
    fn bytes(&self) -> usize {
        // Points, labels and colors, and about as much again for each preparation.
        self.scene.points.len() * 17 * (1 + VIEWERS)
    }
}

/// The camera that took a scene. A scene's camera always has a pose.
fn observer_of(scene: &Scene) -> Observer {
    let camera = &scene.meta.camera;
    let RigidTransform(world_from_camera) = camera.world_from_camera.unwrap_or(RigidTransform::IDENTITY);
    // Row-major: the last column is where the camera is.
    let eye = [3, 7, 11].map(|entry| world_from_camera[entry] as f32).into();
    Observer { eye, pixel_rad: (2.0 / (camera.fx + camera.fy)) as f32 }
}

/// The scenes that a worker holds.
#[derive(Debug)]
pub struct SceneStore {
    held: Mutex<Held>,
    max_scenes: usize,
    max_bytes: usize,
}

#[derive(Debug)]
struct Held {
    /// Bounded by [`SceneStore::insert`], in number and in bytes.
    scenes: LruCache<String, Arc<HeldScene>>,
    bytes: usize,
}

impl SceneStore {
    /// A store for at most `max_scenes` scenes and about `max_bytes` bytes; the newest scene is always kept.
    pub fn new(max_scenes: usize, max_bytes: usize) -> Self {
        let held = Mutex::new(Held { scenes: LruCache::unbounded(), bytes: 0 });
        Self { held, max_scenes: max_scenes.max(1), max_bytes }
    }

    /// The scene of that id.
    ///
    /// # Errors
    /// `not_found` on `scene_id`: the caller sends it whole.
    pub fn get(&self, scene_id: &str) -> Result<Arc<HeldScene>, CallError> {
        let not_held = || CallError::not_found("scene_id", format!("this worker does not hold scene {scene_id}"));
        self.held().scenes.get(scene_id).cloned().ok_or_else(not_held)
    }

    /// Holds a scene, which must hash to `scene_id`; the one already held under that id is kept.
    ///
    /// # Errors
    /// `invalid_argument` on `scene.scene_id` when the content has another id.
    pub fn insert(&self, scene_id: &str, scene: Scene) -> Result<Arc<HeldScene>, CallError> {
        if let Ok(held) = self.get(scene_id) {
            return Ok(held);
        }
        // Hashed without the lock: other requests go on meanwhile.
        let actual = scene.id();
        if actual != scene_id {
            return Err(CallError::invalid("scene.scene_id", format!("the enclosed scene's id is {actual}, not {scene_id}")));
        }
        let mut held = self.held();
        if let Some(first) = held.scenes.get(scene_id) {
            return Ok(first.clone());
        }
        let scene = Arc::new(HeldScene::new(actual, Arc::new(scene)));
        held.bytes += scene.bytes();
        held.scenes.put(scene_id.to_owned(), scene.clone());
        while held.scenes.len() > 1 && (held.scenes.len() > self.max_scenes || held.bytes > self.max_bytes) {
            let Some((_, gone)) = held.scenes.pop_lru() else { break };
            held.bytes -= gone.bytes();
        }
        Ok(scene)
    }

    fn held(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use repose_proto::scene::WorldFrame;
    use repose_proto::{CameraModel, SceneMeta, Unseen};

    use super::*;

    /// A scene of so many points at one place.
    pub(crate) fn scene(points: usize, x: f32) -> Scene {
        let camera = CameraModel { width: 2, height: 2, fx: 1.0, fy: 1.0, cx: 0.5, cy: 0.5, depth_unit_m: 0.001, world_from_camera: None };
        let meta = SceneMeta {
            objects: Vec::new(),
            surfaces: Vec::new(),
            camera,
            world_frame: WorldFrame::SupportPlane,
            view_yaw_rad: 0.0,
            unseen: Unseen::default(),
        };
        let points_m = vec![[x, 0.0, 0.0]; points];
        Scene { camera_name: "front".to_owned(), stamp_ns: 0, labels: vec![1; points], points: points_m, colors: None, meta }
    }

    #[test]
    fn scenes_leave_by_number_and_by_bytes_the_least_recently_used_first() {
        let scenes = [0.1, 0.2, 0.3].map(|x| scene(100, x));
        let ids = scenes.each_ref().map(Scene::id);
        let store = SceneStore::new(2, usize::MAX);
        let [a, b, c] = scenes;
        store.insert(&ids[0], a.clone()).expect("its id");
        store.insert(&ids[1], b).expect("its id");
        store.get(&ids[0]).expect("held");
        store.insert(&ids[2], c).expect("its id");
        assert!(store.get(&ids[0]).is_ok() && store.get(&ids[1]).is_err() && store.get(&ids[2]).is_ok());
        let huge = scene(5000, 0.4);
        let small = SceneStore::new(10, 1);
        small.insert(&ids[0], a).expect("its id");
        small.insert(&huge.id(), huge.clone()).expect("its id");
        assert!(small.get(&ids[0]).is_err() && small.get(&huge.id()).is_ok(), "the newest is kept whatever its size");
    }

    #[test]
    fn a_scene_under_another_id_is_refused() {
        let error = SceneStore::new(1, 1).insert("00", scene(1, 0.0)).expect_err("another id");
        assert_eq!(error.field.as_deref(), Some("scene.scene_id"));
    }
}
