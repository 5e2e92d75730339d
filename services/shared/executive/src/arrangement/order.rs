//! Which move of a plan is made now.

use repose_proto::GoalTerm;
use repose_proto::arrange::{ArrangeMove, Purpose};

/// The first move of a plan whose object is not put off and that can be made before those that are: it brings its object to its goal, beside objects
/// that none of them moves. The first of all where there is none such.
pub(super) fn next_possible(moves: &[ArrangeMove], is_put_off: impl Fn(u16) -> bool) -> usize {
    let is_possible = |k: usize| {
        let moves_before = |id: u16| moves[..k].iter().any(|before| before.object == id);
        let ArrangeMove { object, purpose, goal, .. } = &moves[k];
        let is_free = *purpose == Purpose::Goal && !moves_before(*object) && !goal.iter().any(|term| moves_before(term.anchor));
        !is_put_off(*object) && (k == 0 || is_free)
    };
    (0..moves.len()).find(|k| is_possible(*k)).unwrap_or(0)
}

/// A move with other ids; none where one has no other.
pub(super) fn renamed(step: &ArrangeMove, id: impl Fn(u16) -> Option<u16>) -> Option<ArrangeMove> {
    let goal = step.goal.iter().map(|term| Some(GoalTerm { anchor: id(term.anchor)?, ..*term })).collect::<Option<_>>()?;
    Some(ArrangeMove { object: id(step.object)?, goal, ..step.clone() })
}

#[cfg(test)]
mod tests {
    use repose_proto::place::Placement;
    use serde_json::json;

    use super::*;

    fn to(object: u16, purpose: Purpose, anchors: &[u16]) -> ArrangeMove {
        let placement: Placement = serde_json::from_value(json!({
            "placed_from_observed": [1.0, 0.0, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
            "cost": 0.1, "relations": [], "geometric": [], "clearance_m": 0.1, "support_m": 0.05, "realism": 0.9, "success": 0.9,
        }))
        .expect("a placement");
        let goal =
            anchors.iter().map(|anchor| GoalTerm { relation: repose_proto::Relation::LeftOf, anchor: *anchor, holds: true }).collect();
        ArrangeMove { object, purpose, goal, placement }
    }

    #[test]
    fn what_the_robot_cannot_move_is_put_off_for_what_needs_nothing_of_it() {
        let plan = [
            to(1, Purpose::Goal, &[9]),
            to(2, Purpose::Goal, &[1]),
            to(3, Purpose::Aside, &[]),
            to(4, Purpose::Goal, &[8]),
            to(3, Purpose::Goal, &[9]),
        ];
        let next = |put_off: &[u16]| next_possible(&plan, |object| put_off.contains(&object));
        assert_eq!(next(&[]), 0);
        // 2 goes beside 1, and 3 makes room for nobody any more.
        assert_eq!(next(&[1]), 3);
        // 3 must be set aside first; so the first is tried again.
        assert_eq!(next(&[1, 4]), 0);
        assert_eq!(next(&[4]), 0);
    }
}
