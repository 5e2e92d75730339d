//! How much of a placed object would be in space that the camera did not see: behind things, inside them, where readings are missing.
//!
//! Such space may be free or filled. The place where the object itself stood is free once the object is picked up. Where it reaches once it is turned
//! over it never stood: what it filled before that is free in the scene already.

use nalgebra::{Point2, Point3};
use repose_proto::UnseenSpace;

use crate::scene::candidate::CandidatePose;
use crate::scene::query::QueryObject;
use crate::settings::UnseenShareSettings;
use repose_belief::shape::Shape;
use repose_belief::view::ObservedView;

/// The share of the query's volume, placed as a candidate, in space that was not seen; 0 without any such space.
pub fn unseen_share(space: Option<&UnseenSpace>, query: &QueryObject, candidate: &CandidatePose, settings: &UnseenShareSettings) -> f64 {
    let Some(space) = space else { return 0.0 };
    let bottom_m = query.bottom_of(candidate.centroid_m[2]);
    let (mut tried, mut unseen) = (0usize, 0usize);
    let (carry, stood) = (candidate.carrying(), query.stands());
    for prism in &query.prisms {
        let levels = ((prism.high_m - prism.low_m) / settings.step_m).ceil().max(1.0);
        let rise_m = (prism.high_m - prism.low_m) / levels;
        // All places of a prism are tried at the same heights: with the bit of the level that each of these lies in.
        let height_m = |level: usize| bottom_m + prism.low_m + (level as f32 + 0.5) * rise_m;
        let heights = (0..levels as usize).map(height_m);
        let tried_m: Vec<(f32, u32)> = heights.filter_map(|height_m| Some((height_m, 1 << space.level_of(f64::from(height_m))?))).collect();
        let bits = tried_m.iter().fold(0, |bits, (_, bit)| bits | bit);
        tried += prism.sparse.len() * levels as usize;
        for offset in &prism.sparse {
            let place = carry.place(offset);
            let hidden = space.hidden_over(f64::from(place.x), f64::from(place.y)).unwrap_or(0);
            if hidden & bits != 0 {
                let stood_there = |height_m: f32| stood.is_some_and(|shape| fills(shape, &place, height_m));
                let is_unseen = |(height_m, bit): &&(f32, u32)| hidden & bit != 0 && !stood_there(*height_m);
                unseen += tried_m.iter().filter(is_unseen).count();
            }
        }
    }
    unseen as f64 / tried.max(1) as f64
}

/// The share of the query's volume, placed as a candidate, in directions of the picture in which the camera read nothing: holes, what is looked at flatly,
/// and the borders of things.
pub fn unread_share(view: &ObservedView, query: &QueryObject, candidate: &CandidatePose, settings: &UnseenShareSettings) -> f64 {
    let bottom_m = query.bottom_of(candidate.centroid_m[2]);
    let carry = candidate.carrying();
    let (mut tried, mut unread) = (0usize, 0usize);
    for prism in &query.prisms {
        let levels = ((prism.high_m - prism.low_m) / settings.step_m).ceil().max(1.0);
        let rise_m = (prism.high_m - prism.low_m) / levels;
        for at in prism.sparse.iter().map(|offset| carry.place(offset)) {
            let places = (0..levels as usize).map(|level| Point3::new(at.x, at.y, bottom_m + prism.low_m + (level as f32 + 0.5) * rise_m));
            tried += levels as usize;
            unread += places.filter(|place| view.is_unread(place)).count();
        }
    }
    unread as f64 / tried.max(1) as f64
}

/// Whether a place is inside a shape.
fn fills(shape: &Shape, place: &Point2<f32>, height_m: f32) -> bool {
    shape.slabs.iter().any(|s| (s.low_m..=s.high_m).contains(&height_m) && s.outline.contains(place))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::scene::prepared::PreparedScene;
    use crate::scene::turned::{turned_over, turns};
    use crate::settings::Fixed;
    use crate::tests::synthetic::{Prepared, SceneBuilder, standing_at};

    #[test]
    fn behind_a_wall_is_unseen_beside_it_is_seen_and_its_own_place_is_free() {
        let scene = SceneBuilder::table().object(1, [0.0, 0.1], [0.3, 0.04, 0.25]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]).prepared();
        let fixed = Fixed::default();
        let query = QueryObject::new(&scene, 2, 0.0, &fixed).unwrap();
        // Cubes of 2 cm over the table; hidden is what a camera at (0, −0.8, 0.7) does not see for the wall, and what the query filled.
        let (columns, rows) = (50, 40);
        let hidden = (0..rows * columns)
            .map(|k| {
                let (x, y) = (-0.5 + 0.02 * (k % columns) as f64 + 0.01, -0.4 + 0.02 * (k / columns) as f64 + 0.01);
                let wall = x.abs() < 0.15 && y > 0.08;
                let own = (x + 0.3).abs() < 0.04 && (y + 0.2).abs() < 0.05;
                if wall || own { 0b1111_u32 } else { 0 }
            })
            .collect();
        let space = UnseenSpace { origin_m: [-0.5, -0.4, 0.0], cell_m: 0.02, columns, rows, hidden };
        let share = |x: f32, y: f32| unseen_share(Some(&space), &query, &standing_at(&query, x, y, 0.0), &fixed.unseen);
        assert!(share(0.0, 0.2) > 0.9, "{}", share(0.0, 0.2));
        assert_eq!(share(0.3, 0.0), 0.0);
        assert!(share(-0.3, -0.2) < 0.15, "{}", share(-0.3, -0.2));
        assert_eq!(unseen_share(None, &query, &standing_at(&query, 0.0, 0.2, 0.0), &fixed.unseen), 0.0);
    }

    #[test]
    fn where_the_camera_read_nothing_is_unread_and_what_something_hides_is_not() {
        let mut scene = SceneBuilder::table().object(1, [0.0, 0.1], [0.3, 0.04, 0.25]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]).scene();
        // A hole of 20 cm in the table, where nothing was read.
        let is_kept: Vec<bool> =
            scene.points.iter().map(|[x, y, z]| *z > 0.01 || (x - 0.3).abs() > 0.1 || (y + 0.15).abs() > 0.1).collect();
        let mut kept = is_kept.iter();
        scene.points.retain(|_| *kept.next().expect("one a point"));
        let mut kept = is_kept.iter();
        scene.labels.retain(|_| *kept.next().expect("one a point"));
        let table = PreparedScene::new(Arc::new(scene));
        let fixed = Fixed::default();
        let query = QueryObject::new(&table, 2, 0.0, &fixed).unwrap();
        let share = |x: f32, y: f32| unread_share(&table.belief.view, &query, &standing_at(&query, x, y, 0.001), &fixed.unseen);
        assert!(share(0.3, -0.15) > 0.5 && share(0.0, -0.15) < 0.2, "{} {}", share(0.3, -0.15), share(0.0, -0.15));
        assert!(share(0.0, 0.2) < 0.2, "behind the wall: {}", share(0.0, 0.2));
    }

    #[test]
    fn where_an_object_reaches_once_it_is_turned_over_it_never_stood() {
        // Of all space around a tall box nobody has seen anything.
        let mut scene = SceneBuilder::table().object(1, [0.0, 0.0], [0.08, 0.06, 0.2]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]).scene();
        let (columns, rows) = (60, 60);
        let hidden = vec![u32::MAX; columns * rows];
        scene.meta.unseen.space = Some(UnseenSpace { origin_m: [-0.6, -0.6, 0.0], cell_m: 0.02, columns, rows, hidden });
        let (table, fixed) = (PreparedScene::new(Arc::new(scene)), Fixed::default());
        let share = |table: &PreparedScene| {
            let query = table.query(1, 0.0, &fixed).unwrap();
            let as_it_is = CandidatePose::new(&query.shape.centroid, 0.0);
            unseen_share(table.scene.meta.unseen.space.as_ref(), &query, &as_it_is, &fixed.unseen)
        };
        assert!(share(&table) < 0.1, "as it lies it stood there: {}", share(&table));
        let turns = turns(&table, 1).unwrap();
        assert!(!turns.is_empty());
        for turn in turns {
            let turned = turned_over(&table, 1, turn).unwrap().prepared;
            let (query, space) = (turned.query(1, 0.0, &fixed).unwrap(), turned.scene.meta.unseen.space.as_ref().unwrap());
            let (carry, lowest_m) = (CandidatePose::new(&query.shape.centroid, 0.0).carrying(), query.shape.bottom_m);
            let (mut tried, mut hidden) = (0u32, 0u32);
            for prism in &query.prisms {
                let levels = ((prism.high_m - prism.low_m) / fixed.unseen.step_m).ceil().max(1.0);
                let rise_m = (prism.high_m - prism.low_m) / levels;
                for place in prism.sparse.iter().map(|offset| carry.place(offset)) {
                    for level in 0..levels as usize {
                        let height_m = lowest_m + prism.low_m + (level as f32 + 0.5) * rise_m;
                        tried += 1;
                        hidden += u32::from(space.hides([place.x, place.y, height_m].map(f64::from)) == Some(true));
                    }
                }
            }
            let of_grid = f64::from(hidden) / f64::from(tried);
            assert!(of_grid > 0.0 && (share(&turned) - of_grid).abs() < 0.02, "{}, not {of_grid}", share(&turned));
        }
    }
}
