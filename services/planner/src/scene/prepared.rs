//! A scene prepared once for many requests: everything about it that does not depend on the request.
//!
//! The points by object, the objects' completed shapes and supports, the map of runs above the floor plan, the support surfaces, and the
//! camera's picture rebuilt from the points. A request only leaves out its query.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use nalgebra::{Isometry3, Point2, Point3};
use repose_geometry::{Aabb, cloud, transform};
use repose_proto::{CallError, Scene};

use crate::belief::columns::{ColumnMap, ColumnRun, bounds_around, cells_of, cells_of_map};
use crate::belief::crown::is_crowned;
use crate::belief::plane::SupportPlane;
use crate::belief::settings::BeliefSettings;
use crate::belief::shape::Shape;
use crate::belief::standing::{Seen, carried_by};
use crate::belief::view::ObservedView;

/// One object.
#[derive(Debug, Clone)]
pub struct PreparedObject {
    /// Its points, world frame.
    pub points: Vec<Point3<f32>>,
    /// Their mean.
    pub centroid: Point3<f64>,
    /// Its completed shape; none when its points have no extent seen from above.
    pub shape: Option<Shape>,
}

/// A prepared scene.
#[derive(Debug, Clone)]
pub struct PreparedScene {
    /// The scene itself.
    pub scene: Arc<Scene>,
    /// Its id.
    pub scene_id: String,
    /// Its objects by id.
    pub objects: BTreeMap<u16, PreparedObject>,
    /// Its support surfaces, as perception ranked them.
    pub planes: Vec<SupportPlane>,
    /// What stands above each cell of the floor plan.
    pub columns: ColumnMap,
    /// What the camera saw.
    pub view: ObservedView,
    carried: BTreeMap<u16, Vec<u16>>,
    /// Objects whose tops carry nothing.
    crowned: BTreeSet<u16>,
    fault: Option<CallError>,
    min_points: usize,
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
        Self::with_known(scene, scene_id, settings, None)
    }

    /// Prepares a scene whose objects' shapes are known from elsewhere: what is believed of an object does not change when it is moved.
    pub fn with_shapes(scene: Arc<Scene>, shapes: BTreeMap<u16, Shape>) -> Self {
        let scene_id = scene.id();
        Self::with_known(scene, scene_id, &BeliefSettings::default(), Some(shapes))
    }

    fn with_known(scene: Arc<Scene>, scene_id: String, settings: &BeliefSettings, known: Option<BTreeMap<u16, Shape>>) -> Self {
        let pose = pose_of(&scene);
        let mut fault = match &pose {
            Err(error) => Some(error.clone()),
            Ok(_) => scene.points.is_empty().then(|| CallError::invalid("points", "the cloud is empty")),
        };
        let world_from_camera = pose.unwrap_or_else(|_| Isometry3::identity());

        let mut clouds: BTreeMap<u16, Vec<Point3<f32>>> = BTreeMap::new();
        for (p, label) in scene.points.iter().zip(&scene.labels).filter(|(_, label)| **label != 0) {
            clouds.entry(*label).or_default().push(Point3::from(*p));
        }
        let of_objects: Vec<Point3<f32>> = clouds.values().flatten().copied().collect();
        let nowhere = Aabb { min: Point3::origin(), max: Point3::origin() };
        // Without objects the map is around the origin: planning then names the object that is missing.
        let mut bounds = bounds_around(&of_objects, &scene.points, settings.reach_m)
            .or_else(|| bounds_around(&[Point3::origin()], &scene.points, settings.reach_m))
            .unwrap_or(nowhere);
        let [columns, rows] = cells_of_map(&bounds, settings.cell_m);
        if columns.saturating_mul(rows) > settings.max_cells {
            let (side_m, span_m) = ((settings.max_cells as f32).sqrt() * settings.cell_m, (bounds.max - bounds.min).xy());
            let message = format!("the objects spread over {:.0} m by {:.0} m, expected about {side_m:.0} m at most", span_m.x, span_m.y);
            fault.get_or_insert_with(|| CallError::invalid("points", message));
            clouds.clear();
            bounds = nowhere;
        }
        let seen = ColumnMap::of_points(&scene.points, &scene.labels, &bounds, settings.cell_m, settings.gap_m);
        let planes: Vec<SupportPlane> = scene.meta.surfaces.iter().filter_map(SupportPlane::of).collect();

        let camera = world_from_camera.translation.vector.xy().cast::<f32>().into();
        let view = ObservedView::new(&scene.points, &scene.labels, &scene.meta.camera, &world_from_camera, settings.view_columns);
        let before = Seen { clouds: &clouds, columns: &seen, planes: &planes, view: &view, settings };
        let mut shapes = known.unwrap_or_else(|| completed(&before, &camera));
        let hidden: Vec<(Point2<f32>, ColumnRun)> = shapes.iter().flat_map(|(id, shape)| unseen_runs(*id, shape, &seen)).collect();
        let columns = seen.with(hidden);
        let carried = carried_by(&shapes, &columns, &settings.stack);
        let crowned = clouds.iter().filter(|(_, points)| is_crowned(points, &settings.crown)).map(|(id, _)| *id).collect();
        let prepared = clouds.into_iter().filter_map(|(id, points)| {
            let centroid = cloud::centroid(&points)?;
            Some((id, PreparedObject { points, centroid, shape: shapes.remove(&id) }))
        });
        let objects: BTreeMap<u16, PreparedObject> = prepared.collect();
        Self { columns, fault, scene, scene_id, objects, planes, view, carried, crowned, min_points: settings.min_points }
    }

    /// Whether the scene can be planned on.
    ///
    /// # Errors
    /// `invalid_argument` when the cloud is empty, its objects are too far apart for a map, or the camera has no rigid pose.
    pub fn check(&self) -> Result<(), CallError> {
        self.fault.clone().map_or(Ok(()), Err)
    }

    /// The objects that stand on an object or in it.
    pub fn carried(&self, id: u16) -> &[u16] {
        self.carried.get(&id).map_or(&[], Vec::as_slice)
    }

    /// Whether something can stand on an object's top: not on a ball or on a tube that lies. Furniture (0) carries.
    pub fn carries(&self, id: u16) -> bool {
        !self.crowned.contains(&id)
    }

    /// The object to move, with its completed shape.
    ///
    /// # Errors
    /// As [`PreparedScene::object`] on `query`; `failed_precondition` on `query` when something stands on it: it would fall.
    pub fn movable(&self, id: u16) -> Result<(&PreparedObject, &Shape), CallError> {
        let found = self.object(id, "query")?;
        match self.carried(id) {
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
    pub fn object(&self, id: u16, field: &str) -> Result<(&PreparedObject, &Shape), CallError> {
        let object = self.objects.get(&id).ok_or_else(|| {
            let known: Vec<String> = self.objects.keys().map(u16::to_string).collect();
            CallError::not_found(field, format!("the scene has no object {id}; it has {}", list(&known)))
        })?;
        let enough = object.points.len() >= self.min_points;
        let shape = object.shape.as_ref().filter(|_| enough).ok_or_else(|| {
            CallError::precondition(format!("object {id} has too few points to plan with ({})", object.points.len())).at(field)
        })?;
        Ok((object, shape))
    }
}

/// The completed shapes of all objects.
fn completed(seen: &Seen<'_>, camera: &Point2<f32>) -> BTreeMap<u16, Shape> {
    let complete = |id: u16, bottom_m: f32| Some((id, Shape::complete(&seen.clouds[&id], bottom_m, camera, &seen.settings.shape)?));
    let mut shapes: BTreeMap<u16, Shape> = seen.clouds.keys().filter_map(|id| complete(*id, seen.bottom_m(*id)?)).collect();
    // Some supports are known only from a carrier's completed shape.
    let covering: Vec<(u16, Shape)> = shapes.keys().filter_map(|id| complete(*id, seen.covered_top_m(*id, &shapes)?)).collect();
    shapes.extend(covering);
    shapes
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

/// The parts of a shape that must be there though no point shows them: under its tops, and behind its front.
///
/// What is hidden looks like what was seen of the object, turned by half a turn: the far side of a bowl's inside tells how deep the near side is.
fn unseen_runs(id: u16, shape: &Shape, seen: &ColumnMap) -> Vec<(Point2<f32>, ColumnRun)> {
    let mut runs = Vec::new();
    let own_top_m = |place: &Point2<f32>| seen.at(place).iter().filter(|r| r.object == id).map(|r| r.high_m).reduce(f32::max);
    for slab in &shape.slabs {
        for center in cells_of(&slab.outline, 0.0, seen) {
            // A hollow that was looked into is as deep as it was seen to be.
            let own_m = own_top_m(&center).or_else(|| own_top_m(&(shape.axis + (shape.axis - center))));
            let high_m = own_m.unwrap_or(slab.high_m).min(slab.high_m);
            if high_m > slab.low_m {
                runs.push((center, ColumnRun { low_m: slab.low_m, high_m, object: id, seen: false }));
            }
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use repose_proto::ErrorCode;

    use super::*;
    use crate::tests::synthetic::SceneBuilder;

    #[test]
    fn an_object_fills_the_space_behind_its_front_and_under_its_top() {
        let scene = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).prepared();
        let inside = scene.columns.at(&Point2::new(0.0, 0.02));
        assert!(inside.iter().any(|r| !r.seen && r.object == 1 && r.low_m < 0.01 && r.high_m > 0.09), "{inside:?}");
        assert!(scene.columns.at(&Point2::new(0.2, 0.0)).iter().all(|r| r.object == 0));
    }

    #[test]
    fn an_unknown_object_is_not_found_and_the_field_is_named() {
        let scene = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).prepared();
        let error = scene.object(9, "goal[1].anchor").unwrap_err();
        assert_eq!((error.code, error.field.as_deref()), (ErrorCode::NotFound, Some("goal[1].anchor")));
        assert!(scene.object(1, "query").is_ok());
    }
}
