//! The object to move, set up on another side: the scene as it would be if somebody had turned the object over where it lies.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Translation3};
use repose_geometry::{Aabb, cloud};
use repose_proto::{CallError, Scene};

use crate::scene::moved::{GREY, without};
use crate::scene::prepared::PreparedScene;
use crate::scene::traits::solid_of;
use repose_belief::settings::BeliefSettings;
use repose_belief::sides::sides;

/// A side that an object lies on, as observed, within this of upright, radians: it is no other side.
const AS_OBSERVED_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;

/// The scene with the object on another side.
#[derive(Debug)]
pub struct TurnedOver {
    /// The scene.
    pub prepared: PreparedScene,
    /// The motion of world space that has turned the object: about the middle of what was seen of it.
    pub turned_from_observed: Isometry3<f64>,
}

/// The turns that set an object up on its other sides, the widest first.
///
/// # Errors
/// As [`PreparedScene::movable`].
pub fn turns(prepared: &PreparedScene, id: u16) -> Result<Vec<Isometry3<f64>>, CallError> {
    let (object, shape) = prepared.movable(id)?;
    let settings = BeliefSettings::default();
    let middle = Translation3::from(object.centroid.coords);
    let others = sides(&solid_of(prepared, id, object, shape), &settings.sides, &settings.crown).into_iter();
    let others = others.filter(|side| side.standing_from_observed.angle() > AS_OBSERVED_RAD);
    Ok(others.map(|side| middle * side.standing_from_observed * middle.inverse()).collect())
}

/// The scene after a turn.
///
/// # Errors
/// As [`PreparedScene::movable`]; `failed_precondition` on `query` where the turned object has no extent seen from above.
pub fn turned_over(prepared: &PreparedScene, id: u16, turned_from_observed: Isometry3<f64>) -> Result<TurnedOver, CallError> {
    let (object, shape) = prepared.movable(id)?;
    let solid = solid_of(prepared, id, object, shape).moved(&turned_from_observed);
    let turned = solid
        .shape(&BeliefSettings::default().shape)
        .ok_or_else(|| CallError::precondition("the turned object has no extent").at("query"))?;
    let mut known = prepared.belief.shapes();
    known.insert(id, turned);
    let scene = with_cloud(&prepared.scene, id, &solid.points);
    Ok(TurnedOver { prepared: PreparedScene::with_shapes(Arc::new(scene), known), turned_from_observed })
}

/// The scene with other points of an object.
fn with_cloud(scene: &Scene, object: u16, points: &[Point3<f32>]) -> Scene {
    let mut after = without(scene, object);
    after.points.extend(points.iter().map(|p| <[f32; 3]>::from(p.coords)));
    after.labels.extend(points.iter().map(|_| object));
    if let Some(colors) = &mut after.colors {
        colors.extend(points.iter().map(|_| GREY));
    }
    let place = scene.meta.objects.iter().position(|o| o.id == object);
    if let (Some(place), Some(bounds), Some(middle)) = (place, Aabb::of(points), cloud::centroid(points)) {
        let mut summary = scene.meta.objects[place].clone();
        summary.points = points.len();
        summary.centroid_m = middle.coords.into();
        summary.extent_m = (bounds.max - bounds.min).cast::<f64>().into();
        after.meta.objects.insert(place, summary);
    }
    after
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::synthetic::{Prepared, SceneBuilder};

    #[test]
    fn a_box_can_be_set_up_on_its_five_other_sides_and_then_is_as_high_as_it_was_long() {
        let prepared = SceneBuilder::table().object(1, [0.0, 0.0], [0.16, 0.09, 0.06]).object(2, [-0.3, 0.1], [0.05; 3]).prepared();
        let turns = turns(&prepared, 1).unwrap();
        assert_eq!(turns.len(), 5);
        let mut heights_mm: Vec<i32> = turns
            .into_iter()
            .map(|turn| {
                let table = turned_over(&prepared, 1, turn).unwrap().prepared;
                let shape = table.belief.objects[&1].shape.as_ref().unwrap();
                assert!(table.check().is_ok() && table.belief.objects[&2].shape == prepared.belief.objects[&2].shape);
                ((shape.top_m - shape.bottom_m) * 1000.0).round() as i32
            })
            .collect();
        heights_mm.sort_unstable();
        for (found, expected) in heights_mm.iter().zip([60, 90, 90, 160, 160]) {
            assert!((found - expected).abs() <= 8, "{heights_mm:?}");
        }
    }
}
