//! How much of a placed object would be in space that the camera did not see: behind things, inside them, where readings are missing.
//!
//! Such space may be free or filled. The place where the object itself stood is free once the object is picked up.

use nalgebra::Point2;
use repose_proto::UnseenSpace;

use crate::scene::candidate::CandidatePose;
use crate::scene::query::QueryObject;
use crate::settings::UnseenShareSettings;

/// The share of the query's volume, placed as a candidate, in space that was not seen; 0 without any such space.
pub fn unseen_share(space: Option<&UnseenSpace>, query: &QueryObject, candidate: &CandidatePose, settings: &UnseenShareSettings) -> f64 {
    let Some(space) = space else { return 0.0 };
    let bottom_m = query.bottom_of(candidate.centroid_m[2]);
    let (mut tried, mut unseen) = (0usize, 0usize);
    let carry = candidate.carrying();
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
                let is_unseen = |(height_m, bit): &&(f32, u32)| hidden & bit != 0 && !stood_there(query, &place, *height_m);
                unseen += tried_m.iter().filter(is_unseen).count();
            }
        }
    }
    unseen as f64 / tried.max(1) as f64
}

/// Whether a place is inside the query where it was observed.
fn stood_there(query: &QueryObject, place: &Point2<f32>, height_m: f32) -> bool {
    query.shape.slabs.iter().any(|s| (s.low_m..=s.high_m).contains(&height_m) && s.outline.contains(place))
}

#[cfg(test)]
mod tests {
    use super::*;
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
}
