//! Where an object may be set down for a while: beside something that stands, away from where others must go.

use std::collections::BTreeSet;

use repose_proto::{GoalTerm, Relation};

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
        .collect();
    let side = |(relation, anchor): (Relation, u16)| [vec![GoalTerm { relation, anchor, holds: true }], clear.clone()].concat();
    anchors.into_iter().take(ANCHORS).flat_map(|(_, _, anchor)| SIDES.map(|relation| (relation, anchor))).map(side).collect()
}
