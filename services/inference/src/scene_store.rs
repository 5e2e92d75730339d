//! Scenes held by id, with what the networks need of them; bounded, least recently used out.

use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::Point3;
use repose_networks::SceneContext;
use repose_networks::points::CloudConfig;
use repose_proto::{CallError, Scene};

/// Viewers prepared per scene; requests on a scene nearly always share one.
const VIEWERS: usize = 4;

/// A scene and, for each viewer that was asked for, its clouds in network form.
#[derive(Debug)]
pub struct HeldScene {
    scene_id: String,
    scene: Arc<Scene>,
    prepared: Mutex<Vec<(u64, Arc<SceneContext>)>>,
}

impl HeldScene {
    /// Holds a scene under its id.
    pub fn new(scene_id: String, scene: Arc<Scene>) -> Self {
        Self { scene_id, scene, prepared: Mutex::default() }
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
        let context = SceneContext::new(&points, &self.scene.labels, view_yaw_rad, config);
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

/// The scenes that a worker holds.
#[derive(Debug)]
pub struct SceneStore {
    held: Mutex<Vec<Arc<HeldScene>>>,
    max_scenes: usize,
    max_bytes: usize,
}

impl SceneStore {
    /// A store for at most `max_scenes` scenes and about `max_bytes` bytes; the newest scene is always kept.
    pub fn new(max_scenes: usize, max_bytes: usize) -> Self {
        Self { held: Mutex::default(), max_scenes: max_scenes.max(1), max_bytes }
    }

    /// The scene of that id.
    ///
    /// # Errors
    /// `not_found` on `scene_id`: the caller sends it whole.
    pub fn get(&self, scene_id: &str) -> Result<Arc<HeldScene>, CallError> {
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(at) = held.iter().position(|s| s.scene_id == scene_id) else {
            return Err(CallError::not_found("scene_id", format!("this worker does not hold scene {scene_id}")));
        };
        let scene = held.remove(at);
        held.push(scene.clone());
        Ok(scene)
    }

    /// Holds a scene, which must hash to `scene_id`; the one already held under that id is kept.
    ///
    /// # Errors
    /// `invalid_argument` on `scene.scene_id` when the content has another id.
    pub fn insert(&self, scene_id: &str, scene: Scene) -> Result<Arc<HeldScene>, CallError> {
        if let Ok(held) = self.get(scene_id) {
            return Ok(held);
        }
        let actual = scene.id();
        if actual != scene_id {
            return Err(CallError::invalid("scene.scene_id", format!("the enclosed scene's id is {actual}, not {scene_id}")));
        }
        let scene = Arc::new(HeldScene::new(actual, Arc::new(scene)));
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        held.push(scene.clone());
        while held.len() > 1 && (held.len() > self.max_scenes || held.iter().map(|s| s.bytes()).sum::<usize>() > self.max_bytes) {
            held.remove(0);
        }
        Ok(scene)
    }
}
