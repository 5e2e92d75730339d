//! Where an object may be set down for a while: beside something that stands, away from where others must go.

use std::collections::BTreeSet;

use repose_proto::{GoalTerm, Relation, limits};

use crate::scene::prepared::PreparedScene;

/// Sides that are tried, the viewer's near ones first: there the next view sees most.
const SIDES: [Relation; 4] = [Relation::RightOf, Relation::LeftOf, Relation::InFrontOf, Relation::Behind];
/// Objects beside which a place is looked for.
const ANCHORS: usize = 3;

/// Goals to try for an object's place aside, one after the other: a side of something that stands, nearest to it first, and not near what
/// others must still come to.
pub fn places_aside(scene: &PreparedScene, object: u16, unsettled: &BTreeSet<u16>, keep_clear: &BTreeSet<u16>) -> Vec<Vec<GoalTerm>> {
    let Some(from) = scene.belief.objects.get(&object).map(|o| o.centroid) else { return Vec::new() };
    // Of what can be an anchor: a place beside an object of which too little was seen cannot be asked for.
    let others = scene.belief.objects.iter().filter(|(id, _)| **id != object && scene.object(**id, "goal").is_ok());
    // What moves again is an anchor only where nothing else is there.
    let mut anchors: Vec<(bool, f64, u16)> =
        others.map(|(id, other)| (unsettled.contains(id), (other.centroid - from).xy().norm(), *id)).collect();
    anchors.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
    let clear: Vec<GoalTerm> = keep_clear
        .iter()
        .filter(|id| **id != object && scene.belief.objects.contains_key(id))
        .map(|id| GoalTerm { relation: Relation::Near, anchor: *id, holds: false })
        // With the side, as many as a placement may be asked for: to keep clear of most is better than to have no place.
        .take(limits::MAX_GOAL_TERMS - 1)
        .collect();
    let side = |(relation, anchor): (Relation, u16)| [vec![GoalTerm { relation, anchor, holds: true }], clear.clone()].concat();
    anchors.into_iter().take(ANCHORS).flat_map(|(_, _, anchor)| SIDES.map(|relation| (relation, anchor))).map(side).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::synthetic::{Prepared, SceneBuilder};

    #[test]
    fn a_place_aside_is_asked_for_with_no_more_terms_than_a_placement_may_have() {
        let row = (1..=20u16).fold(SceneBuilder::table(), |table, id| table.object(id, [-0.46 + 0.044 * f64::from(id), 0.0], [0.03; 3]));
        let scene = row.prepared();
        let goals = places_aside(&scene, 1, &BTreeSet::new(), &(2..=20).collect());
        assert!(!goals.is_empty() && goals.iter().all(|goal| goal.len() == limits::MAX_GOAL_TERMS), "{goals:?}");
    }
}
