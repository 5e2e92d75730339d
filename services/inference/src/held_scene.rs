//! A scene as it is held for scoring: with its clouds in network form, for each viewing direction asked for.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::Point3;
use repose_networks::SceneContext;
use repose_networks::points::{CloudConfig, Observer};
use repose_proto::{CallError, RigidTransform, Scene};
use repose_relations::rectangle::rectangle_yaw_rad;

/// Viewers prepared per scene; requests on a scene nearly always share one.
const VIEWERS: usize = 4;

/// A scene and its clouds in network form, for each viewer that was asked for.
#[derive(Debug)]
pub struct HeldScene {
    scene_id: String,
    scene: Arc<Scene>,
    border_px: Option<f32>,
    prepared: Mutex<Vec<(u64, Arc<SceneContext>)>>,
    yaws_rad: Mutex<BTreeMap<u16, Option<f64>>>,
}

impl HeldScene {
    /// Holds a scene under its id.
    pub fn new(scene_id: String, scene: Arc<Scene>) -> Self {
        Self { scene_id, scene, border_px: None, prepared: Mutex::default(), yaws_rad: Mutex::default() }
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

    /// The orientation of an object's observed cloud, seen from above; none without one. Found once per object.
    pub fn yaw_rad(&self, id: u16) -> Option<f64> {
        let found = || rectangle_yaw_rad(&self.scene.points_of(id).map(Point3::from).collect::<Vec<_>>());
        *self.yaws_rad.lock().unwrap_or_else(PoisonError::into_inner).entry(id).or_insert_with(found)
    }

    /// Roughly how much memory the scene, its preparations and what these keep come to take, bytes.
    pub fn bytes(&self) -> usize {
        // Points, labels and colors, and about as much again for each preparation.
        let (points, said) = (self.scene.points.len(), self.scene.as_sent.as_ref().map_or(0, |text| text.len()));
        points * 17 * (1 + VIEWERS) + VIEWERS * SceneContext::kept_bytes(points) + said
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
            left_out: Vec::new(),
            warnings: Vec::new(),
        };
        let points_m = vec![[x, 0.0, 0.0]; points];
        Scene { camera_name: "front".to_owned(), stamp_ns: 0, labels: vec![1; points], points: points_m, colors: None, meta, as_sent: None }
    }

    #[test]
    fn what_is_kept_of_the_queries_that_are_asked_about_counts_too() {
        let bytes = |points| HeldScene::new("scene".to_owned(), Arc::new(scene(points, 0.0))).bytes();
        let of_points = 2048 * 17 * (1 + VIEWERS);
        // For each viewer, the features of four queries, about 2 MB each.
        assert!((of_points + VIEWERS * 4 * 1_600_000..of_points + VIEWERS * 4 * 2_400_000).contains(&bytes(2048)), "{}", bytes(2048));
        assert!(bytes(10) < 200_000, "a scene of few points has few centroids");
    }
}
