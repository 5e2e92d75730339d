//! A scene prepared once for many requests: everything about it that does not depend on the request, which is what is believed of it. A request
//! only leaves out its query.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::Isometry3;
use repose_belief::{Belief, BeliefSettings, BelievedObject, SeenScene, Shape, TooWide};
use repose_geometry::transform;
use repose_proto::{CallError, Scene};

use crate::scene::kept::Kept;

/// A prepared scene.
#[derive(Debug, Clone)]
pub struct PreparedScene {
    /// The scene itself.
    pub scene: Arc<Scene>,
    /// Its id.
    pub scene_id: String,
    /// What is believed of it.
    pub belief: Belief,
    /// The object that was turned over in thought ([`crate::scene::turned`]): it never was where its points are now.
    pub(crate) turned_over: Option<u16>,
    fault: Option<CallError>,
    min_points: usize,
    /// What earlier requests prepared.
    pub(crate) kept: Arc<Kept>,
}

impl PreparedScene {
    /// Prepares a scene with the default settings. Hashes it for its id.
    ///
    /// A scene that cannot be planned on (an empty cloud, a camera without a rigid pose, objects too far apart) is prepared too: planning
    /// on it is the error.
    pub fn new(scene: Arc<Scene>) -> Self {
        let scene_id = scene.id();
        Self::with_id(scene, scene_id)
    }

    /// Prepares a scene whose id is known.
    pub fn with_id(scene: Arc<Scene>, scene_id: String) -> Self {
        Self::with_settings(scene, scene_id, &BeliefSettings::default())
    }

    /// Prepares a scene with other settings.
    pub fn with_settings(scene: Arc<Scene>, scene_id: String, settings: &BeliefSettings) -> Self {
        Self::believed(scene, scene_id, settings, |seen| Belief::of(seen, settings))
    }

    /// Prepares a scene whose objects' shapes are known from elsewhere: what is believed of an object does not change when it is moved.
    pub fn with_shapes(scene: Arc<Scene>, shapes: BTreeMap<u16, Shape>) -> Self {
        let (scene_id, settings) = (scene.id(), BeliefSettings::default());
        Self::believed(scene, scene_id, &settings, |seen| Belief::with_shapes(seen, shapes, &settings))
    }

    /// Prepares what is left of a scene once an object was taken away or set down elsewhere, with the shapes that are known then.
    pub fn after(&self, moved: u16, left: Arc<Scene>, shapes: BTreeMap<u16, Shape>) -> Self {
        let (scene_id, settings) = (left.id(), BeliefSettings::default());
        Self::believed(left, scene_id, &settings, |seen| self.belief.after(moved, seen, shapes, &settings))
    }

    fn believed(
        scene: Arc<Scene>,
        scene_id: String,
        settings: &BeliefSettings,
        believe: impl FnOnce(&SeenScene<'_>) -> Result<Belief, TooWide>,
    ) -> Self {
        let pose = pose_of(&scene);
        let mut fault = match &pose {
            Err(error) => Some(error.clone()),
            Ok(_) => scene.points.is_empty().then(|| CallError::invalid("points", "the cloud is empty")),
        };
        let world_from_camera = pose.unwrap_or_else(|_| Isometry3::identity());
        let seen = SeenScene::of(&scene, &world_from_camera);
        let belief = believe(&seen).unwrap_or_else(|too_wide| {
            fault.get_or_insert_with(|| CallError::invalid("points", too_wide.to_string()));
            Belief::of_nothing(&seen, settings)
        });
        Self { belief, turned_over: None, fault, scene, scene_id, min_points: settings.min_points, kept: Arc::default() }
    }

    /// Whether the scene can be planned on.
    ///
    /// # Errors
    /// `invalid_argument` when the cloud is empty, its objects are too far apart for a map, or the camera has no rigid pose.
    pub fn check(&self) -> Result<(), CallError> {
        self.fault.clone().map_or(Ok(()), Err)
    }

    /// The object to move, with its completed shape.
    ///
    /// # Errors
    /// As [`PreparedScene::object`] on `query`; `failed_precondition` on `query` when something stands on it: it would fall.
    pub fn movable(&self, id: u16) -> Result<(&BelievedObject, &Shape), CallError> {
        let found = self.object(id, "query")?;
        match self.belief.carried(id) {
            [] => Ok(found),
            carried => {
                let ids: Vec<String> = carried.iter().map(u16::to_string).collect();
                let message = format!("object {id} cannot be moved while it carries {}: move that first", ids.join(", "));
                Err(CallError::precondition(message).at("query"))
            }
        }
    }

    /// An object with its completed shape.
    ///
    /// # Errors
    /// `not_found` on `field` when there is no such object; `failed_precondition` when too little of it was seen.
    pub fn object(&self, id: u16, field: &str) -> Result<(&BelievedObject, &Shape), CallError> {
        let object = self.belief.objects.get(&id).ok_or_else(|| {
            let known: Vec<String> = self.belief.objects.keys().map(u16::to_string).collect();
            CallError::not_found(field, format!("the scene has no object {id}; it has {}", list(&known)))
        })?;
        let enough = object.points.len() >= self.min_points;
        let shape = object.shape.as_ref().filter(|_| enough).ok_or_else(|| {
            CallError::precondition(format!("object {id} has too few points to plan with ({})", object.points.len())).at(field)
        })?;
        Ok((object, shape))
    }
}

fn pose_of(scene: &Scene) -> Result<Isometry3<f64>, CallError> {
    let field = "scene.camera.world_from_camera";
    let pose = scene.meta.camera.world_from_camera.as_ref();
    let pose = pose.ok_or_else(|| CallError::invalid(field, "a scene's camera must have a pose"))?;
    transform::from_row_major(&pose.0).map_err(|e| CallError::invalid(field, e.to_string()))
}

fn list(known: &[String]) -> String {
    if known.is_empty() { "none".to_owned() } else { known.join(", ") }
}

#[cfg(test)]
mod tests {
    use repose_proto::ErrorCode;

    use crate::tests::synthetic::{Prepared, SceneBuilder};

    #[test]
    fn an_unknown_object_is_not_found_and_the_field_is_named() {
        let scene = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).prepared();
        let error = scene.object(9, "goal[1].anchor").unwrap_err();
        assert_eq!((error.code, error.field.as_deref()), (ErrorCode::NotFound, Some("goal[1].anchor")));
        assert!(scene.object(1, "query").is_ok());
    }
}
