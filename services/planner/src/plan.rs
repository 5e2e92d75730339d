//! Answers a placement request: the planner's one entry point.
//!
//! Pure but for the clock that a time budget in the request needs: the same request, weights and kernel give the same result, bit for
//! bit, on any number of threads. "No placement" is an outcome with its reasons, not an error.
//!
//! Where the object may be set on another side, it is planned for as it lies first. Where that gives too few answers, every other side is planned for
//! by itself, each with the object turned over where it was seen; their answers come after the others, ranked by their cost, and apart from those
//! before them.

use std::ops::ControlFlow;
use std::time::Instant;

use nalgebra::{Isometry3, Point3};
use repose_geometry::transform::{from_row_major, to_row_major};
use repose_proto::place::{Outcome, PlaceProgress, PlaceRequest, PlaceResult, Placement, Rejection, Rotation};
use repose_proto::{CallError, ErrorCode, RigidTransform, SceneRef};

use crate::attitude::{Attitude, Taken, is_apart, planned};
use crate::judge::constraints::Constraints;
use crate::judge::problem::posed;
use crate::learned::models::PlacementModels;
use crate::scene::candidate::CandidatePose;
use crate::scene::prepared::PreparedScene;
use crate::scene::turned::{TurnedOver, turned_over, turns};
use crate::search::stop::StopReason;
use crate::settings::PlanSettings;

pub use crate::attitude::{PlanReport, SearchStep};

/// Plans a placement. `control` is asked between batches and told of each iteration; breaking it stops the search. Time that ends while
/// the models are asked stops it as well.
///
/// # Errors
/// `invalid_argument` for a bad request, `not_found` on `query` or `goal[i].anchor`, `failed_precondition` for an object of which too
/// little was seen, `cancelled`, `deadline_exceeded` before the first iteration was done, and what the models answer.
pub fn plan(
    prepared: &PreparedScene,
    request: &PlaceRequest,
    models: &dyn PlacementModels,
    control: &mut dyn FnMut(SearchStep) -> ControlFlow<StopReason>,
) -> Result<PlaceResult, CallError> {
    if request.rotation == Rotation::Stable {
        return on_every_side(prepared, request, models, control);
    }
    planned(&Attitude::as_seen(prepared), request, models, control, false).map(|(report, _)| report.result)
}

/// As [`plan`], with the candidates behind the answer; of an object that is not turned over.
///
/// # Errors
/// As [`plan`]; `invalid_argument` on `rotation` where that may set the object on another side.
pub fn plan_with_report(
    prepared: &PreparedScene,
    request: &PlaceRequest,
    models: &dyn PlacementModels,
    control: &mut dyn FnMut(SearchStep) -> ControlFlow<StopReason>,
) -> Result<PlanReport, CallError> {
    reported(&Attitude::as_seen(prepared), request, models, control)
}

/// As [`plan_with_report`], of an object that was turned over: placements carry the turned object.
///
/// # Errors
/// As that.
pub fn plan_turned_with_report(
    table: &TurnedOver<'_>,
    request: &PlaceRequest,
    models: &dyn PlacementModels,
    control: &mut dyn FnMut(SearchStep) -> ControlFlow<StopReason>,
) -> Result<PlanReport, CallError> {
    let attitude = Attitude { prepared: &table.prepared, turned: Some(&table.turned), taken: None };
    reported(&attitude, &of_side(request, table), models, control)
}

/// Why a search would not answer with a place for the object as it lies: of the constraints that need no network, the first that fails once the object
/// is let down there; none where all hold.
///
/// # Errors
/// `not_found` on `query` or `goal[i].anchor`, `failed_precondition` for an object of which too little was seen.
pub fn refusal(
    prepared: &PreparedScene,
    request: &PlaceRequest,
    placed_from_observed: &Isometry3<f64>,
) -> Result<Option<Rejection>, CallError> {
    posed(prepared, None, request, &PlanSettings::of(request), |problem| {
        let centroid = placed_from_observed * problem.query.shape.centroid;
        let (_, _, yaw_rad) = placed_from_observed.rotation.euler_angles();
        let candidate = CandidatePose { centroid_m: centroid.coords.cast().into(), yaw_rad: yaw_rad as f32 };
        let let_down = problem.settled(&candidate, problem.ceiling_over(&candidate));
        Constraints::new(problem).tried(let_down, 0).rejection
    })
}

fn reported(
    attitude: &Attitude<'_>,
    request: &PlaceRequest,
    models: &dyn PlacementModels,
    control: &mut dyn FnMut(SearchStep) -> ControlFlow<StopReason>,
) -> Result<PlanReport, CallError> {
    if request.rotation == Rotation::Stable {
        return Err(CallError::invalid("rotation", "a report covers one side of the object: expected fixed or yaw"));
    }
    planned(attitude, request, models, control, true).map(|(report, _)| report)
}

/// The answers with the object as it lies, and where that gives fewer than asked, those on each of its other sides after them: who may set it on another
/// side would still have it left as it is. What comes down when it is taken away does so whatever side it is set on.
fn on_every_side(
    prepared: &PreparedScene,
    request: &PlaceRequest,
    models: &dyn PlacementModels,
    control: &mut dyn FnMut(SearchStep) -> ControlFlow<StopReason>,
) -> Result<PlaceResult, CallError> {
    let started = Instant::now();
    let as_it_lies = PlaceRequest { rotation: Rotation::Yaw, ..request.clone() };
    let (report, mut passed) = planned(&Attitude::as_seen(prepared), &as_it_lies, models, control, false)?;
    let mut found = report.result;
    // What comes first in the end, whatever is found on other sides.
    let first = found.placements.first().cloned();
    let centroid = prepared.object(request.query, "query")?.0.centroid;
    let mut taken: Vec<Point3<f64>> = found.placements.iter().map(|placement| carried(placement, &centroid)).collect::<Result<_, _>>()?;
    let lacks = taken.len() < request.count as usize && !found.rejections.contains_key(&Rejection::Unsettles);
    let others = if lacks { turns(prepared, request.query)? } else { Vec::new() };
    for turn in others {
        let left_ms = request.budget.time_ms.map(|ms| ms.saturating_sub(started.elapsed().as_millis() as u64));
        if found.outcome == Outcome::Partial || left_ms == Some(0) {
            found.outcome = Outcome::Partial;
            break;
        }
        let table = turned_over(prepared, request.query, turn)?;
        let mut of_side = of_side(&as_it_lies, &table);
        of_side.budget.time_ms = left_ms;
        let cheapest = found.placements.iter().min_by(|a, b| a.cost.total_cmp(&b.cost));
        let before =
            Before { iterations: found.iterations, evaluated: found.evaluated, first: first.as_ref(), cheapest: cheapest.cloned() };
        let mut told = |step: SearchStep| control(told_of(step, &before, &turn));
        let kept_from = Taken { places: &taken, centroid: turn * centroid };
        let attitude = Attitude { prepared: &table.prepared, turned: Some(&table.turned), taken: Some(kept_from) };
        match planned(&attitude, &of_side, models, &mut told, false) {
            Ok((report, passed_there)) => {
                add(&mut found, report.result, &turn)?;
                passed = passed.and(passed_there);
            }
            Err(error) if error.code == ErrorCode::DeadlineExceeded => found.outcome = Outcome::Partial,
            Err(error) => return Err(error),
        }
    }
    let mut on_other_sides = found.placements.split_off(taken.len());
    on_other_sides.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    for placement in on_other_sides {
        let place = carried(&placement, &centroid)?;
        if taken.len() < request.count as usize && is_apart(&place, &taken, found.min_separation_m) {
            taken.push(place);
            found.placements.push(placement);
        }
    }
    found.shortfall = passed.shortfall(taken.len(), request.count, found.outcome == Outcome::Partial);
    found.rotation = request.rotation;
    Ok(found)
}

/// The request on the scene in which the object was turned over.
fn of_side(request: &PlaceRequest, table: &TurnedOver<'_>) -> PlaceRequest {
    PlaceRequest { scene: SceneRef { scene_id: table.prepared.scene_id.clone() }, ..request.clone() }
}

/// Adds what was found on another side.
fn add(found: &mut PlaceResult, of_side: PlaceResult, turned_from_observed: &Isometry3<f64>) -> Result<(), CallError> {
    if found.weights_hash.is_empty() {
        (found.weights_hash, found.models_hash, found.kernel) = (of_side.weights_hash.clone(), of_side.models_hash, of_side.kernel);
    } else if !of_side.weights_hash.is_empty() && of_side.weights_hash != found.weights_hash {
        return Err(CallError::new(ErrorCode::Unavailable, "the weights changed during the request"));
    }
    for placement in of_side.placements {
        found.placements.push(from_observed(placement, turned_from_observed)?);
    }
    for (reason, count) in of_side.rejections {
        *found.rejections.entry(reason).or_default() += count;
    }
    found.iterations += of_side.iterations;
    found.evaluated += of_side.evaluated;
    if of_side.outcome == Outcome::Partial || found.outcome == Outcome::None {
        found.outcome = of_side.outcome;
    }
    if !found.placements.is_empty() {
        // There is an answer: nobody asks why there is none.
        found.relaxation = None;
        found.rejected_at_m.clear();
        return Ok(());
    }
    for (reason, places) in of_side.rejected_at_m {
        found.rejected_at_m.entry(reason).or_insert(places);
    }
    let relaxations = [found.relaxation.take(), of_side.relaxation].into_iter().flatten();
    found.relaxation = relaxations.reduce(|most, other| if other.admits > most.admits { other } else { most });
    Ok(())
}

/// A placement of the turned object as one of the object as observed.
fn from_observed(placement: Placement, turned_from_observed: &Isometry3<f64>) -> Result<Placement, CallError> {
    let placed_from_turned = rigid(&placement.placed_from_observed)?;
    Ok(Placement { placed_from_observed: RigidTransform(to_row_major(&(placed_from_turned * turned_from_observed))), ..placement })
}

/// Where a placement carries a point.
fn carried(placement: &Placement, point: &Point3<f64>) -> Result<Point3<f64>, CallError> {
    Ok(rigid(&placement.placed_from_observed)? * point)
}

/// The motion of a placement, which the search has made.
///
/// # Errors
/// `internal` where it is not rigid.
pub fn rigid(placed_from_observed: &RigidTransform) -> Result<Isometry3<f64>, CallError> {
    from_row_major(&placed_from_observed.0).map_err(|e| CallError::internal(format!("a placement is no rigid motion: {e}")))
}

/// What was searched before a side is.
struct Before<'a> {
    iterations: u32,
    evaluated: u64,
    /// The best with the object as it lies, which stays the best.
    first: Option<&'a Placement>,
    /// The best on the sides before.
    cheapest: Option<Placement>,
}

/// A step on one side as one of the whole search.
fn told_of(step: SearchStep, before: &Before<'_>, turned_from_observed: &Isometry3<f64>) -> SearchStep {
    let SearchStep::Iteration(progress) = step else { return step };
    let here = progress.best.and_then(|best| from_observed(best, turned_from_observed).ok());
    let cheaper = || here.into_iter().chain(before.cheapest.clone()).min_by(|a, b| a.cost.total_cmp(&b.cost));
    SearchStep::Iteration(Box::new(PlaceProgress {
        iterations: before.iterations + progress.iterations,
        evaluated: before.evaluated + progress.evaluated,
        best: before.first.cloned().or_else(cheaper),
    }))
}
