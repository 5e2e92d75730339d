//! Answers a placement request: the planner's one entry point.
//!
//! Pure but for the clock that a time budget in the request needs: the same request, weights and kernel give the same result, bit for
//! bit, on any number of threads. "No placement" is an outcome with its reasons, not an error.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use rand::SeedableRng;
use rand_pcg::Pcg64;
use repose_geometry::ViewerFrame;
use repose_proto::place::{Outcome, PlaceProgress, PlaceRequest, PlaceResult, Placement, Relaxation};
use repose_proto::scoring::PriorRequest;
use repose_proto::{CallError, ErrorCode, Message, SceneRef, limits};

use crate::answers;
use crate::candidate::Candidate;
use crate::judge::{Asked, Judge};
use crate::judged::Judged;
use crate::mixture::Mixture;
use crate::models::Models;
use crate::prepared::Prepared;
use crate::proposals::Proposer;
use crate::query::Query;
use crate::ranking::{fill, rank};
use crate::rules::Rules;
use crate::search::{Findings, Source, Stop, in_time, search};
use crate::settings::{Proposals, Realism, Settings};

/// What a search tells its caller, who may stop it.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// Another batch is about to be drawn.
    Batch,
    /// An iteration is done.
    Iteration(Box<PlaceProgress>),
}

/// A result, and what stands behind it.
#[derive(Debug, Clone)]
pub struct Report {
    /// The answer.
    pub result: PlaceResult,
    /// The answers' candidates, in order.
    pub answers: Vec<Judged>,
    /// What the paper's Table 1 counts: the lowest-cost feasible candidate (Algorithm 1 is subject to its constraints, of which being in
    /// view is one); where none is feasible, the one of lowest cost among those in view that violate the constraints least.
    pub best_in_view: Option<Judged>,
}

/// Plans a placement. `control` is asked between batches and told of each iteration; breaking it stops the search. Time that ends while
/// the models are asked stops it as well.
///
/// # Errors
/// `invalid_argument` for a bad request, `not_found` on `query` or `goal[i].anchor`, `failed_precondition` for an object of which too
/// little was seen, `cancelled`, `deadline_exceeded` before the first iteration was done, and what the models answer.
pub fn plan(
    prepared: &Prepared,
    request: &PlaceRequest,
    models: &dyn Models,
    control: &mut dyn FnMut(Step) -> ControlFlow<Stop>,
) -> Result<PlaceResult, CallError> {
    planned(prepared, request, models, control, false).map(|report| report.result)
}

/// As [`plan`], with the candidates behind the answer.
///
/// # Errors
/// As [`plan`].
pub fn plan_with_report(
    prepared: &Prepared,
    request: &PlaceRequest,
    models: &dyn Models,
    control: &mut dyn FnMut(Step) -> ControlFlow<Stop>,
) -> Result<Report, CallError> {
    planned(prepared, request, models, control, true)
}

/// Plans; `reports` says whether somebody wants to know of [`Report::best_in_view`], which the networks may have to be asked about.
fn planned(
    prepared: &Prepared,
    request: &PlaceRequest,
    models: &dyn Models,
    control: &mut dyn FnMut(Step) -> ControlFlow<Stop>,
    reports: bool,
) -> Result<Report, CallError> {
    request.validate()?;
    prepared.check()?;
    if request.scene.scene_id != prepared.scene_id {
        let message = format!("expected {}, got {}", prepared.scene_id, request.scene.scene_id);
        return Err(CallError::invalid("scene.scene_id", message));
    }
    let settings = Settings::of(request);
    let viewer = ViewerFrame::from_yaw(request.view_yaw_rad.unwrap_or(prepared.scene.meta.view_yaw_rad));
    let query = Query::new(prepared, request.query, settings.min_clearance_m, &settings.fixed)?;
    let rules = Rules::new(prepared, &query, &request.goal, &viewer)?;
    let mut judge = Judge::new(prepared, &query, &rules, request, &settings, models);
    let mut rng = Pcg64::seed_from_u64(request.seed);

    let started = Instant::now();
    let mut go_on = |step: Step| {
        control(step)?;
        let time_is_up = settings.time_ms.is_some_and(|ms| started.elapsed() >= Duration::from_millis(ms));
        if time_is_up { ControlFlow::Break(Stop::Deadline) } else { ControlFlow::Continue(()) }
    };
    let source = source(&mut judge, &mut rng)?;
    let (mut findings, mut stopped) = search(&mut judge, source, &mut rng, &mut |done, judge| {
        go_on(match done {
            None => Step::Batch,
            Some(findings) => Step::Iteration(Box::new(PlaceProgress {
                iterations: findings.iterations,
                evaluated: findings.evaluated,
                best: findings.appraised.as_ref().or_else(|| findings.best()).map(|best| answers::placement(best, judge)),
            })),
        })
    })?;
    if stopped == Some(Stop::Deadline) && findings.iterations == 0 {
        return Err(CallError::new(ErrorCode::DeadlineExceeded, "time ended before the first iteration was done"));
    }
    let mut chosen = choose(&mut judge, &mut findings, &mut stopped, &mut || go_on(Step::Batch).break_value())?;
    if stopped == Some(Stop::Cancelled) {
        return Err(CallError::new(ErrorCode::Cancelled, "cancelled while searching"));
    }
    // After the deadline the networks are not asked again, and what is asked for evidence alone does not make a late answer an error.
    if stopped.is_none() {
        in_time(judge.complete(&mut chosen))?;
    }
    let best_in_view = if reports { best_in_view(&mut judge, &findings, stopped.is_some())? } else { None };
    let relaxation = if chosen.is_empty() { in_time(relaxation(&mut judge, &findings, stopped.is_some()))?.flatten() } else { None };
    let outcome = match (stopped, chosen.is_empty()) {
        (Some(_), _) => Outcome::Partial,
        (None, true) => Outcome::None,
        (None, false) => Outcome::Found,
    };
    let placements = chosen.iter().map(|j| answers::placement(j, &judge)).collect();
    let result = result(&judge, findings, outcome, placements, relaxation);
    Ok(Report { result, answers: chosen, best_in_view })
}

/// The answers, once the search is over. Where networks only rank, they do so now; `control` is asked before each of their batches, and
/// `stopped` is told.
fn choose(
    judge: &mut Judge<'_>,
    findings: &mut Findings,
    stopped: &mut Option<Stop>,
    control: &mut dyn FnMut() -> Option<Stop>,
) -> Result<Vec<Judged>, CallError> {
    let (settings, count) = (judge.settings, judge.request.count as usize);
    let distinct =
        |accepted: &[Judged]| answers::distinct(accepted, count, settings.min_separation_m, settings.fixed.surrogate.level_gap_m);
    if settings.recipe.realism != Realism::OutcomeRanks {
        return Ok(distinct(&findings.accepted));
    }
    let mut rest = Vec::new();
    if stopped.is_none() && !findings.accepted.is_empty() {
        // The shortlist is a batch like any other.
        *stopped = control();
        if stopped.is_none() {
            match in_time(rank(judge, findings, count))? {
                Some(unasked) => rest = unasked,
                None => *stopped = Some(Stop::Deadline),
            }
        }
    }
    if stopped.is_some() {
        // Time ended before the networks ranked: what they have seen is one candidate at most, which they may not believe.
        let believed = |j: &&Judged| j.realism.is_some_and(|f| f64::from(f) > settings.realism_threshold);
        return Ok(findings.appraised.iter().filter(believed).cloned().collect());
    }
    let mut chosen = distinct(&findings.accepted);
    if !chosen.is_empty() {
        *stopped = fill(judge, findings, &mut chosen, rest, control)?;
    }
    Ok(chosen)
}

/// The answer, with what was used for it.
fn result(
    judge: &Judge<'_>,
    findings: Findings,
    outcome: Outcome,
    placements: Vec<Placement>,
    relaxation: Option<Relaxation>,
) -> PlaceResult {
    let (request, settings) = (judge.request, judge.settings);
    PlaceResult {
        outcome,
        placements,
        rejections: findings.rejections,
        relaxation,
        iterations: findings.iterations,
        evaluated: findings.evaluated,
        weights_hash: judge.provenance.weights_hash.clone(),
        kernel: judge.provenance.kernel.clone(),
        seed: request.seed,
        scene_id: judge.prepared.scene_id.clone(),
        query: request.query,
        goal: request.goal.clone(),
        variant: request.variant,
        rotation: request.rotation,
        view_yaw_rad: judge.rules.viewer().yaw_rad(),
        count: request.count,
        min_separation_m: settings.min_separation_m,
        min_clearance_m: settings.min_clearance_m,
        budget: settings.budget(),
        cost_weights: settings.cost_weights(),
        thresholds: settings.thresholds(),
    }
}

/// Iteration 0's candidates.
fn source<'a>(judge: &mut Judge<'a>, rng: &mut Pcg64) -> Result<Source<'a>, CallError> {
    let (settings, request) = (judge.settings, judge.request);
    let proposals = settings.recipe.proposals;
    let proposer = matches!(proposals, Proposals::Geometric | Proposals::Both).then_some(Proposer {
        prepared: judge.prepared,
        query: judge.query,
        rules: judge.rules,
        region: &request.region,
        rotation: settings.rotation,
        settings: &settings.fixed.proposals,
    });
    let needs_prior = proposals != Proposals::Geometric || settings.recipe.realism == Realism::PriorDensity;
    let drawn = if needs_prior { ask_prior(judge, rng)? } else { Vec::new() };
    Ok(Source { drawn: drawn.into_iter(), proposer, proposed: 0 })
}

/// Asks the prior; keeps its mixture, and returns its draws (or means) with their modes.
fn ask_prior(judge: &mut Judge<'_>, rng: &mut Pcg64) -> Result<Vec<(Candidate, usize)>, CallError> {
    let (settings, request) = (judge.settings, judge.request);
    let anchor = request.main_anchor().ok_or_else(|| CallError::invalid("goal", "at least one term must hold"))?;
    let mut goal = [0i8; repose_proto::RELATION_COUNT];
    for term in request.goal.iter().filter(|t| t.anchor == anchor) {
        goal[term.relation.index()] = if term.holds { 1 } else { -1 };
    }
    let means_only = settings.recipe.proposals == Proposals::PriorMeans;
    let count = if means_only { 0 } else { (settings.batch * settings.draws_per_batch).min(limits::MAX_CANDIDATES) };
    let prior = PriorRequest {
        scene: SceneRef { scene_id: judge.prepared.scene_id.clone() },
        query: request.query,
        anchor,
        goal,
        view_yaw_rad: judge.rules.viewer().yaw_rad(),
        rotation: settings.rotation,
        count: count as u32,
        seed: rand::RngExt::random(rng),
    };
    let reply = judge.models.prior(&prior, &judge.prepared.scene)?;
    judge.note(&reply.weights_hash, &reply.kernel)?;
    let (object, _) = judge.prepared.object(anchor, "goal")?;
    let mixture = Mixture::new(reply.mixture, object.centroid, *judge.rules.viewer(), settings.rotation);
    let modes = mixture.modes(settings.min_separation_m);
    let drawn = if means_only {
        mixture.means().into_iter().enumerate().map(|(i, c)| (c, i)).collect()
    } else {
        let mode = |component: &u8| modes.get(usize::from(*component)).copied().unwrap_or(0);
        reply.candidates.iter().zip(&reply.components).map(|(row, component)| (Candidate::from_row(*row), mode(component))).collect()
    };
    judge.mixture = Some(mixture);
    Ok(drawn)
}

/// The candidate that the paper's columns are of; see [`Report::best_in_view`].
fn best_in_view(judge: &mut Judge<'_>, findings: &Findings, stopped: bool) -> Result<Option<Judged>, CallError> {
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

/// The goal term whose removal would have admitted the most candidates; never the only one that must hold, which offsets are taken from.
///
/// Where networks decide what is realistic, a sample of each term's candidates is put to them, and stands for all; once time has ended
/// they cannot be asked, and no term is named.
fn relaxation(judge: &mut Judge<'_>, findings: &Findings, stopped: bool) -> Result<Option<Relaxation>, CallError> {
    let (goal, settings) = (&judge.request.goal, judge.settings);
    let asks = matches!(settings.recipe.realism, Realism::Discriminator | Realism::OutcomeRanks);
    if asks && stopped {
        return Ok(None);
    }
    let positive = goal.iter().filter(|t| t.holds).count();
    let mut best: Option<Relaxation> = None;
    for (position, kept_out) in &findings.kept_out {
        let term = goal[*position];
        if term.holds && positive == 1 {
            continue;
        }
        let mut admits = kept_out.count;
        if asks {
            let mut sample = kept_out.sample.clone();
            let all: Vec<usize> = (0..sample.len()).collect();
            judge.ask(Asked::Realism, &mut sample, &all)?;
            let believed = sample.iter().filter(|j| j.realism.is_some_and(|f| f64::from(f) > settings.realism_threshold)).count();
            admits = (kept_out.count as f64 * believed as f64 / sample.len().max(1) as f64).round() as u64;
        }
        if admits > best.as_ref().map_or(0, |b| b.admits) {
            best = Some(Relaxation { term, admits });
        }
    }
    Ok(best)
}
