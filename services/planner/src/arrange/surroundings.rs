//! What decides about the places of an object on top of another: where the two stand, and what is near either of them. Tables that differ elsewhere
//! have the same places, so that they are searched for once, whatever was moved before.

use std::collections::BTreeSet;
use std::fmt::Write;

use repose_belief::Shape;
use repose_proto::{GoalTerm, Relation};

use crate::learned::standing::NEAR_M;
use crate::scene::prepared::PreparedScene;

/// A name for the surroundings of an object and of what it is to stand on: the same for two tables whose places for it are the same. None where a
/// goal does not say what it is to stand on.
pub fn surroundings(scene: &PreparedScene, object: u16, terms: &[GoalTerm]) -> Option<String> {
    let carrier = terms.iter().find(|term| term.holds && term.relation == Relation::Above)?.anchor;
    let shape = |id: u16| scene.belief.objects.get(&id)?.shape.as_ref();
    let (own, top) = (shape(object)?, shape(carrier)?);
    let width_m = f64::from(own.corners().map(|c| (c.xy() - own.axis).norm()).fold(0.0, f32::max)) * 2.0;
    // Whether it may be taken away is told of each of its neighbours.
    let is_near = |other: &Shape| own.gap_m(other) <= NEAR_M || other.top_m > top.top_m && top.gap_m(other) < width_m;
    let near = scene.belief.objects.keys().copied().filter(|id| shape(*id).is_none_or(is_near));
    let named: BTreeSet<u16> = terms.iter().map(|term| term.anchor).chain([object]).chain(near).collect();
    let mut name = String::new();
    for id in named {
        let corners = shape(id).map(|shape| (shape.bottom_m, shape.base.corners()));
        write!(name, "{id} {corners:?};").ok()?;
    }
    Some(name)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use nalgebra::Isometry3;
    use repose_proto::place::Variant;

    use super::*;
    use crate::scene::moved::table_after;
    use crate::tests::synthetic::SceneBuilder;

    #[test]
    fn tables_that_differ_elsewhere_have_the_same_surroundings() {
        let scene = SceneBuilder::table()
            .object(1, [0.0, 0.0], [0.12, 0.12, 0.05])
            .object(2, [-0.35, -0.2], [0.05, 0.05, 0.08])
            .object(3, [0.35, 0.2], [0.05, 0.05, 0.12])
            .scene();
        let table = PreparedScene::new(Arc::new(scene));
        let named = |table: &PreparedScene, term: &str| surroundings(table, 2, &[term.parse().unwrap()]);
        let after = |x: f64, y: f64| table_after(&table, 3, &Isometry3::translation(x, y, 0.0), Variant::Full);
        let name = named(&table, "above:1").unwrap();
        assert_eq!(name, named(&after(0.0, -0.4), "above:1").unwrap(), "it stands elsewhere, far from both");
        assert_ne!(name, named(&after(-0.25, -0.2), "above:1").unwrap(), "it is in the way beside the carrier");
        // A centimetre off, and three.
        for x in [-0.64, -0.619] {
            assert_ne!(name, named(&after(x, -0.4), "above:1").unwrap(), "it may lean on what is taken away");
        }
        assert_eq!(named(&table, "left_of:1"), None, "anywhere on the table");
        assert_eq!(named(&table, "not:above:1"), None);
    }
}
