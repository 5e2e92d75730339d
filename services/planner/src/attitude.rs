//! One search: an object in one attitude, as it lies or set up on another side.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use nalgebra::{Isometry3, Point3};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use repose_belief::learned::{kernel_id, models_hash};
use repose_proto::place::{Outcome, PlaceProgress, PlaceRequest, PlaceResult};
use repose_proto::{CallError, ErrorCode, Message};

use crate::answers::placement::Evidence;
use crate::answers::relaxation::relaxation;
use crate::answers::{Answers, Passed};
use crate::judge::Judge;
use crate::judge::judged::JudgedCandidate;
use crate::judge::problem::{PlacementProblem, posed};
use crate::learned::models::{PlacementModels, Provenance};
use crate::scene::prepared::PreparedScene;
use crate::scene::turned::Turned;
use crate::search::findings::Findings;
use crate::search::search;
use crate::search::source::CandidateSource;
use crate::search::stop::{StopReason, in_time};
use crate::settings::{PlanSettings, Realism};

/// What a search tells its caller, who may stop it.
#[derive(Debug, Clone, PartialEq)]
pub enum SearchStep {
    /// Another batch is about to be drawn.
    Batch,
    /// An iteration is done.
    Iteration(Box<PlaceProgress>),
}

/// A result, and the candidates behind it.
#[derive(Debug, Clone)]
pub struct PlanReport {
    /// The answer.
    pub result: PlaceResult,
    /// The answers' candidates, in order.
    pub answers: Vec<JudgedCandidate>,
    /// The candidate that the paper's Table 1 counts: the lowest-cost feasible candidate (Algorithm 1 is subject to its constraints, of which being in
    /// view is one); where none is feasible, the one of lowest cost among those in view that violate the constraints least.
    pub best_in_view: Option<JudgedCandidate>,
}

/// An object in one attitude.
#[derive(Debug, Clone, Copy)]
pub struct Attitude<'a> {
    /// The scene that it is in.
    pub prepared: &'a PreparedScene,
    /// How it was turned over there.
    pub turned: Option<&'a Turned<'a>>,
    /// What its answers are kept apart from.
    pub taken: Option<Taken<'a>>,
}

/// The places of answers in other attitudes.
#[derive(Debug, Clone, Copy)]
pub struct Taken<'a> {
    /// Where they put the centroid of what was observed of the object, world frame, metres.
    pub places: &'a [Point3<f64>],
    /// Where that centroid is in this attitude's scene.
    pub centroid: Point3<f64>,
}

impl Taken<'_> {
    /// Whether an answer that puts the scene's object somewhere is so far from all of them.
    fn is_apart(&self, placed_from_scene: &Isometry3<f64>, apart_m: f64) -> bool {
        is_apart(&(placed_from_scene * self.centroid), self.places, apart_m)
    }
}

impl<'a> Attitude<'a> {
    /// As the object was seen.
    pub fn as_seen(prepared: &'a PreparedScene) -> Self {
        Self { prepared, turned: None, taken: None }
    }
}

/// Whether a place is at least so far from all others.
pub fn is_apart(place: &Point3<f64>, others: &[Point3<f64>], apart_m: f64) -> bool {
    others.iter().all(|other| (place - other).norm() >= apart_m)
}

/// Plans; `reports` says whether [`PlanReport::best_in_view`] is wanted, for which the networks may have to be asked. Beside the report, what its
/// answers were chosen from.
///
/// # Errors
/// As [`crate::plan::plan`].
pub fn planned(
    attitude: &Attitude<'_>,
    request: &PlaceRequest,
    models: &dyn PlacementModels,
    control: &mut dyn FnMut(SearchStep) -> ControlFlow<StopReason>,
    reports: bool,
) -> Result<(PlanReport, Passed), CallError> {
    let Attitude { prepared, turned, taken } = *attitude;
    request.validate()?;
    prepared.check()?;
    if request.scene.scene_id != prepared.scene_id {
        let message = format!("expected {}, got {}", prepared.scene_id, request.scene.scene_id);
        return Err(CallError::invalid("scene.scene_id", message));
    }
    let settings = PlanSettings::of(request);
    check_demands(request, &settings)?;
    posed(prepared, turned, request, &settings, |problem| searched(problem, taken, models, control, reports))?
}

/// Searches for the answers of a problem that are apart from those `taken`; see [`planned`].
fn searched(
    problem: PlacementProblem<'_>,
    taken: Option<Taken<'_>>,
    models: &dyn PlacementModels,
    control: &mut dyn FnMut(SearchStep) -> ControlFlow<StopReason>,
    reports: bool,
) -> Result<(PlanReport, Passed), CallError> {
    let PlacementProblem { query, request, settings, .. } = problem;
    let evidence = Evidence::new(problem);
    let mut judge = Judge::new(problem, models);
    let mut rng = Pcg64::seed_from_u64(request.seed);

    let started = Instant::now();
    let mut go_on = |step: SearchStep| {
        control(step)?;
        let time_is_up = settings.time_ms.is_some_and(|ms| started.elapsed() >= Duration::from_millis(ms));
        if time_is_up { ControlFlow::Break(StopReason::Deadline) } else { ControlFlow::Continue(()) }
    };
    let source = CandidateSource::new(&mut judge, &mut rng)?;
    judge.learn_standing()?;
    let (mut findings, mut stopped) = search(&mut judge, source, &mut rng, &mut |done| {
        go_on(match done {
            None => SearchStep::Batch,
            Some(findings) => SearchStep::Iteration(Box::new(PlaceProgress {
                iterations: findings.iterations,
                evaluated: findings.evaluated,
                best: findings.best_so_far(settings).map(|best| evidence.placement(best)),
            })),
        })
    })?;
    if stopped == Some(StopReason::Deadline) && findings.iterations == 0 {
        return Err(CallError::new(ErrorCode::DeadlineExceeded, "the time limit passed before the first iteration was complete"));
    }
    let apart = |judged: &JudgedCandidate| {
        let let_go = problem.let_go(&judged.candidate);
        taken.is_none_or(|taken| taken.is_apart(&let_go.placed_from_observed(&query.shape.centroid), settings.min_separation_m))
    };
    let mut answers = Answers::choose(&mut judge, &mut findings, &apart, &mut stopped, &mut || go_on(SearchStep::Batch).break_value())?;
    if stopped == Some(StopReason::Cancelled) {
        return Err(CallError::new(ErrorCode::Cancelled, "cancelled while searching"));
    }
    // After the deadline the networks are not asked again, and what is asked for evidence alone does not make a late answer an error.
    if stopped.is_none() {
        in_time(judge.complete(&mut answers.chosen))?;
    }
    let best_in_view = if reports { best_in_view(&mut judge, &findings, stopped.is_some())? } else { None };
    // Where there are answers in another attitude, nobody asks why there are none in this one.
    let is_none = answers.chosen.is_empty() && taken.is_none_or(|taken| taken.places.is_empty());
    let relaxation = if is_none { in_time(relaxation(&mut judge, &findings, stopped.is_some()))?.flatten() } else { None };
    let outcome = match (stopped, answers.chosen.is_empty()) {
        (Some(_), _) => Outcome::Partial,
        (None, true) => Outcome::None,
        (None, false) => Outcome::Found,
    };
    let placements = answers.chosen.iter().map(|j| evidence.placement(j)).collect();
    let shortfall = answers.passed.shortfall(answers.chosen.len(), request.count, stopped.is_some());
    // Whoever has an answer need not look at what is none.
    let rejected_at_m = if answers.chosen.is_empty() { findings.rejected_at_m() } else { BTreeMap::new() };
    let result = PlaceResult { placements, relaxation, shortfall, rejected_at_m, ..without_answers(&judge, findings, outcome) };
    Ok((PlanReport { result, answers: answers.chosen, best_in_view }, answers.passed))
}

/// Refuses demands that cannot be met whatever is found.
fn check_demands(request: &PlaceRequest, settings: &PlanSettings) -> Result<(), CallError> {
    if request.robot.is_some() && settings.world_from_base.is_none() {
        let message = "where the base of that robot stands is not known; give robot.world_from_base";
        return Err(CallError::precondition(message).at("robot"));
    }
    if request.min_success.is_some_and(|least| least > 0.0) && settings.recipe.realism != Realism::OutcomeRanks {
        let message = format!("the variant {} does not say how likely its placements succeed", request.variant);
        return Err(CallError::precondition(message).at("min_success"));
    }
    Ok(())
}

/// A result that says how the search went and what was used for it.
fn without_answers(judge: &Judge<'_>, findings: Findings, outcome: Outcome) -> PlaceResult {
    let PlacementProblem { prepared, rules, request, settings, .. } = judge.problem();
    let provenance = judge.scorer().provenance();
    let weights_hash = provenance.map_or_else(String::new, |p| p.weights_hash.clone());
    PlaceResult {
        outcome,
        placements: Vec::new(),
        rejections: findings.rejections,
        rejected_at_m: BTreeMap::new(),
        relaxation: None,
        shortfall: None,
        iterations: findings.iterations,
        evaluated: findings.evaluated,
        models_hash: models_hash(&weights_hash),
        weights_hash,
        kernel: kernels(provenance),
        seed: request.seed,
        scene_id: prepared.scene_id.clone(),
        world_from_camera: prepared.scene.meta.camera.world_from_camera,
        query: request.query,
        goal: request.goal.clone(),
        variant: request.variant,
        rotation: request.rotation,
        view_yaw_rad: rules.viewer().yaw_rad(),
        count: request.count,
        min_separation_m: settings.min_separation_m,
        min_clearance_m: settings.min_clearance_m,
        min_success: settings.min_success,
        robot: request.robot.clone(),
        budget: settings.budget(),
        cost_weights: settings.cost_weights(),
        thresholds: settings.thresholds(),
    }
}

/// The kernels that a result was computed with: the one that scored, where one did, and this process's own, on which shapes are completed, where that is
/// another.
fn kernels(scored: Option<&Provenance>) -> String {
    let own = kernel_id();
    match scored {
        Some(scored) if scored.kernel != own => format!("{}+{own}", scored.kernel),
        _ => own.to_owned(),
    }
}

/// The candidate that the paper's columns are of; see [`PlanReport::best_in_view`].
fn best_in_view(judge: &mut Judge<'_>, findings: &Findings, stopped: bool) -> Result<Option<JudgedCandidate>, CallError> {
    if let Some(best) = findings.best() {
        return Ok(Some(best.clone()));
    }
    let mut nearest = findings.nearest.clone();
    if !stopped {
        in_time(judge.complete(&mut nearest))?;
    }
    for j in &mut nearest {
        j.cost = judge.cost(j);
    }
    Ok(nearest.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost)))
}
