//! The object to move, set up on another side: the scene as it would be if somebody had turned the object over where it lies.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Translation3};
use repose_proto::CallError;

use crate::scene::moved::with_cloud;
use crate::scene::prepared::PreparedScene;
use crate::scene::traits::solid_of;
use repose_belief::settings::BeliefSettings;
use repose_belief::sides::sides;

/// A side that an object lies on, as observed, within this of upright, radians: it is no other side.
const AS_OBSERVED_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;

/// The scene with the object on another side.
#[derive(Debug)]
pub struct TurnedOver<'a> {
    /// The scene.
    pub prepared: PreparedScene,
    /// How the object was turned over.
    pub turned: Turned<'a>,
}

/// How an object was turned over.
#[derive(Debug, Clone, Copy)]
pub struct Turned<'a> {
    /// The scene before that: how the object lay, and what lay against it.
    pub as_seen: &'a PreparedScene,
    /// Where the centroid of what was observed of the object has come to, world frame, metres: that of the turned object's points is another.
    pub observed_centroid: Point3<f64>,
    /// By which angle, radians.
    pub angle_rad: f64,
    /// Share of what it stands on now that was seen.
    pub seen_base_share: f64,
}

impl Turned<'_> {
    /// The names of what the forecasts read of it.
    pub const MEASURES: [&'static str; 2] = ["turned", "seen_base"];

    /// What they read, in the order of their names: radians, and a share from 0 to 1. Both are 0 as an object lies.
    pub fn measures(turned: Option<&Self>) -> [f64; 2] {
        turned.map_or([0.0; 2], |turned| [turned.angle_rad, turned.seen_base_share])
    }
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

/// The scene after a turn, a motion of world space.
///
/// # Errors
/// As [`PreparedScene::movable`]; `failed_precondition` on `query` where the turned object has no extent seen from above.
pub fn turned_over(prepared: &PreparedScene, id: u16, turned_from_observed: Isometry3<f64>) -> Result<TurnedOver<'_>, CallError> {
    let (object, shape) = prepared.movable(id)?;
    let settings = BeliefSettings::default();
    let solid = solid_of(prepared, id, object, shape).moved(&turned_from_observed);
    let turned_shape = solid.shape_after(&turned_from_observed, shape, &settings.shape);
    let mut turned_shape = turned_shape.ok_or_else(|| CallError::precondition("the turned object has no extent").at("query"))?;
    turned_shape.foot_doubt_m = settings.sides.lower_m;
    let mut known = prepared.belief.shapes();
    known.insert(id, turned_shape);
    let scene = with_cloud(&prepared.scene, id, shape, &solid.points);
    let turned = Turned {
        as_seen: prepared,
        observed_centroid: turned_from_observed * object.centroid,
        angle_rad: turned_from_observed.rotation.angle(),
        seen_base_share: solid.seen_base_share(settings.sides.contact_m),
    };
    let mut after = prepared.after(id, Arc::new(scene), known);
    // Nothing lay on it, so nothing does, even if it has come to be under something.
    after.belief.bare(id);
    after.turned_over = Some(id);
    Ok(TurnedOver { prepared: after, turned })
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;

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

    #[test]
    fn what_was_seen_to_be_free_beside_an_object_stays_so_when_another_is_turned_over() {
        // A pot with one handle, to the right.
        let pot = SceneBuilder::table().object(1, [0.0, 0.0], [0.16, 0.16, 0.08]).object_at(1, [0.15, 0.0], 0.05, [0.14, 0.03, 0.02]);
        let prepared = pot.object(2, [-0.3, -0.2], [0.12, 0.08, 0.06]).prepared();
        let turns = turns(&prepared, 2).unwrap();
        assert!(!turns.is_empty());
        for turn in turns {
            let table = turned_over(&prepared, 2, turn).unwrap().prepared;
            let filled = |x: f32, y: f32| table.belief.columns.at(&Point2::new(x, y)).iter().any(|run| run.object == 1);
            assert!(!filled(0.17, -0.055), "before the handle the table was seen");
            assert!(filled(0.17, 0.055), "behind it nobody knows");
        }
    }

    #[test]
    fn an_object_that_is_turned_over_beneath_something_does_not_carry_it() {
        // A board on its edge beside a pillar, on which something lies: turned flat, it reaches under that.
        for height_m in [0.06, 0.08, 0.1, 0.12] {
            let board = SceneBuilder::table().object(1, [0.0, 0.0], [0.16, 0.04, 0.14]);
            let pillar = board.object(4, [0.0, 0.085], [0.03, 0.03, height_m]);
            let prepared = pillar.object_at(3, [0.0, 0.085], height_m, [0.16, 0.11, 0.04]).prepared();
            let turns = turns(&prepared, 1).unwrap();
            assert!(!turns.is_empty());
            for turn in turns {
                let table = turned_over(&prepared, 1, turn).unwrap().prepared;
                assert!(table.movable(1).is_ok(), "{height_m}: {:?}", table.belief.carried(1));
            }
        }
    }
}
