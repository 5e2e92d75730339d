//! Many goals at once: which objects must move, in which order, and where to, so that all goals hold together at the end.
//!
//! The paper leaves rearrangement to future work; its appendix's mug and bowl show why order and room matter. Here it is a search over moves,
//! each of which is a placement planned as any other on the scene as it would be then ([`crate::scene::moved`]). An object's place is chosen by
//! its own terms and, turned about, those of others about it, as far as the others stand already ([`goals`]); so whatever the order, all terms
//! hold when the last object stands. Fewest moves first: no object is set down aside before every order and alternative without that has failed,
//! and goals that contradict each other are refused before anything is searched ([`contradiction`](mod@contradiction)).

pub mod contradiction;
mod dead_end;
mod follow;
pub mod goals;
pub mod parking;
mod places;
mod search;
mod stacks;
mod surroundings;
mod tables;
mod uncover;

use std::ops::ControlFlow;
use std::sync::Arc;

use repose_geometry::ViewerFrame;
use repose_proto::arrange::{ArrangeMove, ArrangeRequest, ArrangeResult, Conflict, ObjectGoal, Proof};
use repose_proto::place::Outcome;
use repose_proto::{CallError, Message};

use crate::arrange::contradiction::contradiction;
use crate::arrange::goals::Goals;
use crate::arrange::places::PlacesEnd;
use crate::arrange::search::Search;
use crate::learned::models::PlacementModels;
use crate::plan::SearchStep;
use crate::scene::prepared::PreparedScene;
use crate::search::stop::StopReason;

/// Plans an arrangement. `control` is asked between batches of every placement that is searched, and before every table that is prepared; breaking it
/// stops the search. Time that ends leaves a `partial` result, with the moves found until then, if any.
///
/// # Errors
/// `invalid_argument` for a bad request, `not_found` on `goals[i].object` or `goals[i].terms[k].anchor`, `failed_precondition` on one of which too
/// little was seen, `cancelled`, and what the models answer.
pub fn arrange(
    prepared: &Arc<PreparedScene>,
    request: &ArrangeRequest,
    models: &dyn PlacementModels,
    control: &mut dyn FnMut(SearchStep) -> ControlFlow<StopReason>,
) -> Result<ArrangeResult, CallError> {
    request.validate()?;
    prepared.check()?;
    if request.scene.scene_id != prepared.scene_id {
        let message = format!("expected {}, got {}", prepared.scene_id, request.scene.scene_id);
        return Err(CallError::invalid("scene.scene_id", message));
    }
    known(prepared, &request.goals)?;
    let viewer = ViewerFrame::from_yaw(request.view_yaw_rad.unwrap_or(prepared.scene.meta.view_yaw_rad));
    let goals = Goals::new(&request.goals);
    let unmet = goals.unmet(prepared, &viewer, request.variant);
    let satisfied: Vec<u16> = request.goals.iter().map(|goal| goal.object).filter(|object| !unmet.contains(object)).collect();
    let mut result = ArrangeResult {
        outcome: Outcome::Found,
        moves: Vec::new(),
        satisfied,
        open: Vec::new(),
        needs_view: Vec::new(),
        probability: None,
        conflict: None,
        searches: 0,
        weights_hash: String::new(),
        scene_id: prepared.scene_id.clone(),
        view_yaw_rad: viewer.yaw_rad(),
        goals: request.goals.clone(),
        seed: request.seed,
    };
    if let Some(goals) = contradiction(&request.goals) {
        result.outcome = Outcome::None;
        result.open = unmet.into_iter().collect();
        result.conflict = Some(Conflict { goals, proof: Proof::Contradiction, smallest: true });
        return Ok(result);
    }
    let mut search = Search::new(&goals, request, viewer, models, control);
    let found = search.arranged(prepared, unmet.clone())?;
    let ended = search.asked().ended().map(|_| search.best_so_far());
    match (found, search.before_a_view().or(ended).cloned()) {
        (Some(moves), _) => result.moves = moves,
        (None, Some(part)) => {
            result.outcome = Outcome::Partial;
            (result.moves, result.open, result.needs_view) = (part.moves, part.open, part.needs_view);
        }
        (None, None) => {
            result.outcome = Outcome::None;
            result.open = unmet.into_iter().collect();
            result.conflict = Some(conflict(prepared, request, &mut search)?);
        }
    }
    (result.searches, result.weights_hash) = (search.asked().searches(), search.asked().weights_hash().to_owned());
    result.satisfied.retain(|object| is_left_satisfied(*object, &result.moves, &result.open));
    result.probability = probability(&result.moves);
    Ok(result)
}

/// Refuses objects that the scene does not have, before anything is searched.
fn known(prepared: &PreparedScene, goals: &[ObjectGoal]) -> Result<(), CallError> {
    for (i, goal) in goals.iter().enumerate() {
        prepared.object(goal.object, &format!("goals[{i}].object"))?;
        for (k, term) in goal.terms.iter().enumerate() {
            prepared.object(term.anchor, &format!("goals[{i}].terms[{k}].anchor"))?;
        }
    }
    Ok(())
}

/// A smallest set of goals for which nothing is found: each is left out in turn, and stays out where nothing is found without it either.
fn conflict(scene: &Arc<PreparedScene>, request: &ArrangeRequest, search: &mut Search<'_>) -> Result<Conflict, CallError> {
    let mut kept = request.goals.clone();
    let mut smallest = true;
    let mut next = 0;
    while kept.len() > 1 && next < kept.len() {
        let mut without = kept.clone();
        without.remove(next);
        let goals = Goals::new(&without);
        let unmet = goals.unmet(scene, search.asked().viewer(), request.variant);
        let found = search.with_goals(&goals, |search| search.arranged(scene, unmet))?;
        match search.asked().ended() {
            Some(PlacesEnd::Budget | PlacesEnd::Time) => {
                smallest = false;
                break;
            }
            // Without a view nobody knows.
            None if found.is_none() && search.before_a_view().is_none() => kept = without,
            None => next += 1,
        }
    }
    Ok(Conflict { goals: kept, proof: Proof::NotFound, smallest })
}

/// Whether the goal of an object holds still, that held before these moves: the object stays where it is, and none of what it is placed by was moved
/// so that its goal is open now.
fn is_left_satisfied(object: u16, moves: &[ArrangeMove], open: &[u16]) -> bool {
    !open.contains(&object) && moves.iter().all(|step| step.object != object)
}

/// Null without moves and where nobody said of one of them how likely it succeeds: realism is another question.
fn probability(moves: &[ArrangeMove]) -> Option<f64> {
    let each: Option<Vec<f64>> = moves.iter().map(|m| m.placement.success).collect();
    each.filter(|each| !each.is_empty()).map(|each| each.iter().product())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(success: Option<f64>) -> ArrangeMove {
        let placement = serde_json::json!({
            "placed_from_observed": repose_proto::RigidTransform::IDENTITY, "cost": 0.1, "relations": [], "geometric": [],
            "clearance_m": 0.1, "support_m": 0.05, "realism": 0.9, "success": success,
        });
        serde_json::from_value(serde_json::json!({"object": 2, "purpose": "goal", "goal": [], "placement": placement})).unwrap()
    }

    #[test]
    fn what_was_satisfied_is_so_no_more_once_it_is_moved_or_what_it_is_placed_by_is() {
        // 2 was set aside, and 3 is placed by it.
        assert_eq!([1, 2, 3].map(|object| is_left_satisfied(object, &[step(None)], &[3, 4])), [true, false, false]);
    }

    #[test]
    fn only_where_every_move_tells_its_success_do_all_of_them() {
        assert_eq!(probability(&[step(Some(0.5)), step(Some(0.5))]), Some(0.25));
        assert_eq!(probability(&[step(Some(0.5)), step(None)]), None, "realism is not success");
        assert_eq!(probability(&[]), None);
    }
}
