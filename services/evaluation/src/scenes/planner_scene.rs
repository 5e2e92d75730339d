//! One scene of the planner's table: a problem, its true answers, and what each variant makes of it.
//!
//! Ground truth: masks, gravity, meshes, and what a release does. Observed: depth with the sensor model.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

use nalgebra::Isometry3;
use repose_belief::BeliefSettings;
use repose_dataset::Split;
use repose_geometry::transform::from_row_major;
use repose_inference::Engine;
use repose_planner::judge::judged::JudgedCandidate;
use repose_planner::plan::refusal;
use repose_planner::{Forecasts, PlacementModels, PlanReport, PreparedScene, plan, plan_with_report};
use repose_proto::place::{Outcome, Placement, Rejection, Rotation, Variant};
use repose_proto::scoring::{RealismBy, ScoreRequest};
use repose_proto::{CallError, ErrorCode, GoalTerm, PlaceRequest, PlaceResult, SceneRef};
use repose_simulator::release::ReleaseSettings;
use repose_simulator::scene::{KindWeights, SceneKind};
use serde::{Deserialize, Serialize};

use crate::scenes::one_scene::OneScene;
use crate::scenes::outcome::{Release, STABLE_M, judge, release};
use crate::scenes::perturbation::Perturbation;
use crate::scenes::problem::{Problem, ProblemSettings};
use crate::scenes::script::script_placement;
use crate::scenes::standing_samples::stands_alone;
use crate::scenes::true_answers::{PreparedTruth, Support, TrueAnswer, TruthSettings};
use crate::scenes::true_shapes::KnownShapes;

/// What is tried on every scene.
#[derive(Debug, Clone)]
pub struct PlannerSceneSettings {
    /// The variants, in the table's order.
    pub variants: Vec<Variant>,
    /// Whether the object may be turned, and set on another side.
    pub rotation: Rotation,
    /// Distinct answers asked for; the first is the one that counts, all are looked at for what they stand on.
    pub answers: u32,
    /// A fault that is put on what the camera saw.
    pub perturbation: Option<Perturbation>,
    /// Whose true shapes are known.
    pub known_shapes: Option<KnownShapes>,
    /// Whether the network completes the shapes of the others, not the rules.
    pub learned_shapes: bool,
    /// How hard true answers are searched.
    pub truth: TruthSettings,
    /// How a release is simulated.
    pub release: ReleaseSettings,
}

impl Default for PlannerSceneSettings {
    fn default() -> Self {
        Self {
            variants: Variant::ALL.to_vec(),
            rotation: Rotation::Fixed,
            answers: 8,
            perturbation: None,
            known_shapes: None,
            learned_shapes: false,
            truth: TruthSettings::default(),
            release: ReleaseSettings::default(),
        }
    }
}

/// A set of scenes: where they come from, and the kinds that take turns.
#[derive(Debug, Clone)]
pub struct SceneSet {
    /// Its name in the table.
    pub name: String,
    /// The kinds, one a scene, in turn.
    pub kinds: Vec<SceneKind>,
    /// Whose problems.
    pub problem: ProblemSettings,
}

impl SceneSet {
    /// How many slots there are: the next one's first seed is the first slot's second. All of their seeds are of one block of `final`.
    pub const SLOTS: u64 = 1_000_000;

    /// The problem of a slot of the set. A slot's seeds are its own, so that slots can be tried in any order and on any machine: where
    /// a seed gives no scene or no open goal, the slot goes on to its next one. `None` when none of them does.
    pub fn problem(&self, split: Split, slot: u64) -> Option<Problem> {
        const SEEDS: u64 = 40;
        let kind = self.kinds.get(slot as usize % self.kinds.len().max(1)).copied()?;
        let mut settings = self.problem.clone();
        settings.scene.kinds = KindWeights::only(kind);
        (0..SEEDS).find_map(|k| Problem::of_split(split, slot + k * Self::SLOTS, &settings))
    }
}

/// The candidate that the paper's columns are of: the lowest-cost feasible one, or where none is feasible, the one of lowest cost among
/// those in view that violate the constraints least.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct InView {
    /// The predictor's probability of the goal.
    pub relations: f64,
    /// The discriminator's.
    pub realism: f64,
    /// How far the object's centre moved after its release, metres.
    pub moved_m: f64,
}

/// An answer's own estimate of its quality.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SelfAssessment {
    /// The probability that it succeeds.
    pub success: Option<f64>,
    /// The probability that it stays.
    pub realism: Option<f64>,
    /// The least probability of a goal term.
    pub relations: f64,
    /// The least margin of a goal term by rule, metres.
    pub rule_margin_m: f64,
    /// See [`Placement::support_m`].
    pub support_m: Option<f64>,
    /// See [`Placement::clearance_m`].
    pub clearance_m: Option<f64>,
    /// What the forecast of success read of it; empty where it was not asked.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub measures: Vec<f32>,
}

impl SelfAssessment {
    fn by(placement: &Placement, judged: Option<&JudgedCandidate>) -> Self {
        Self {
            success: placement.success,
            realism: placement.realism,
            relations: placement.relations.iter().copied().fold(1.0, f64::min),
            rule_margin_m: placement.geometric.iter().map(|check| check.margin_m).fold(f64::INFINITY, f64::min),
            support_m: placement.support_m,
            clearance_m: placement.clearance_m,
            measures: judged.and_then(|judged| judged.success_measures.clone()).unwrap_or_default(),
        }
    }

    /// How sure it is of itself: its probability of success, or where that was not asked, of staying.
    pub fn sureness(&self) -> Option<f64> {
        self.success.or(self.realism)
    }
}

/// One variant's result on a problem.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct VariantTrial {
    /// Which variant.
    pub variant: Variant,
    /// How its search ended.
    pub outcome: Outcome,
    /// Why the request was refused, if it was: the object carries another, too little of it was seen, or it was not found. Counts as "none".
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
    /// The outcome of the first answer; none without one.
    pub release: Option<Release>,
    /// What the first answer said of itself; none without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub said: Option<SelfAssessment>,
    /// The paper's candidate; none when nothing drawn was in view.
    pub in_view: Option<InView>,
    /// On how many different things its answers stand.
    pub supports: usize,
    /// On how many of them at least one answer succeeds.
    pub good_supports: usize,
    /// What rejected candidates.
    pub rejections: BTreeMap<Rejection, u64>,
    /// Wall-clock time of the search, milliseconds.
    pub plan_ms: f64,
}

impl VariantTrial {
    /// Whether a placement was returned that stayed, with the goal, and left everything else alone.
    pub fn joint(&self) -> bool {
        self.release.is_some_and(|r| r.judged.joint())
    }

    /// A trial whose request was refused.
    fn refused(variant: Variant, why: String) -> Self {
        Self {
            variant,
            outcome: Outcome::None,
            refused: Some(why),
            release: None,
            said: None,
            in_view: None,
            supports: 0,
            good_supports: 0,
            rejections: BTreeMap::new(),
            plan_ms: 0.0,
        }
    }

    /// Whether the release left the paper's candidate where it was.
    pub fn stable(&self) -> bool {
        self.in_view.is_some_and(|c| c.moved_m < STABLE_M)
    }
}

/// What the script of [`crate::scenes::script`] made of a problem.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScriptTrial {
    /// The outcome of its answer; none without one.
    pub release: Option<Release>,
}

impl ScriptTrial {
    fn of(problem: &Problem, settings: &ReleaseSettings) -> Self {
        Self { release: script_placement(problem).and_then(|placed| release(problem, &placed, settings)) }
    }

    /// As [`VariantTrial::joint`].
    pub fn joint(&self) -> bool {
        self.release.is_some_and(|r| r.judged.joint())
    }
}

/// The results of one scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneRecord {
    /// The set's name.
    pub set: String,
    /// The scene's slot in its set.
    pub slot: u64,
    /// The scene's seed.
    pub seed: u64,
    /// What it is about.
    pub kind: SceneKind,
    /// The object to move.
    pub query: u16,
    /// The goal.
    pub goal: GoalTerm,
    /// On how many different things the search with the truth found an answer.
    pub true_supports: usize,
    /// Whether that search finds one that stands with its whole base: nothing else may be set over an edge on purpose.
    #[serde(default)]
    pub whole_based: bool,
    /// Whether the object stands by itself in the attitude in which it was seen: one that leans can, in that attitude, only be set down leaning on something.
    #[serde(default)]
    pub stands_alone: bool,
    /// Why the planner would refuse the answers of that search, by what it believes and before any network is asked: the first constraint that fails, none
    /// where all hold.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub true_refusals: Vec<Option<Rejection>>,
    /// What the bar to clear makes of it.
    pub script: ScriptTrial,
    /// One a variant.
    pub trials: Vec<VariantTrial>,
}

impl SceneRecord {
    /// Whether the scene is known to have an answer: the search with the truth found one, or a variant or the script did.
    pub fn answerable(&self) -> bool {
        self.true_supports > 0 || self.script.joint() || self.trials.iter().any(VariantTrial::joint)
    }

    /// What a variant made of it.
    pub fn trial(&self, variant: Variant) -> Option<&VariantTrial> {
        self.trials.iter().find(|t| t.variant == variant)
    }
}

/// A scene that was tried, for those who want to look at it.
pub struct TriedScene {
    /// The problem.
    pub problem: Problem,
    /// Its true answers.
    pub truth: Vec<TrueAnswer>,
    /// What is kept of it.
    pub record: SceneRecord,
    /// What each variant answered, in their order; `None` where the request was refused.
    pub results: Vec<Option<PlaceResult>>,
}

/// Tries one slot of a set; `None` when it gives no problem.
///
/// # Errors
/// The planner's or the engine's, on a problem that they should have been able to take.
pub fn try_scene(
    set: &SceneSet,
    split: Split,
    slot: u64,
    engine: &Engine,
    forecasts: &Arc<Forecasts>,
    settings: &PlannerSceneSettings,
) -> Result<Option<TriedScene>, CallError> {
    let Some(problem) = set.problem(split, slot) else { return Ok(None) };
    let Some(truth) = PreparedTruth::new(&problem) else { return Ok(None) };
    let answers = truth.answers(&settings.truth, &settings.release);
    // The truth is that of the scene; only what is seen of it changes.
    let seen = match settings.perturbation {
        Some(fault) => Problem { observed: fault.observed(&problem, &set.problem.perception)?, ..problem.clone() },
        None => problem.clone(),
    };
    let scene = Arc::new(seen.observed.clone());
    let models = OneScene::new(engine, scene.clone()).with_forecasts(forecasts);
    let belief = BeliefSettings::of_shapes(settings.learned_shapes);
    let prepared = PreparedScene::with_settings(scene, models.scene_id().to_owned(), &belief);
    let prepared = settings.known_shapes.map(|known| known.in_scene(&prepared, &problem.truth, problem.query)).unwrap_or(prepared);
    let (mut trials, mut results) = (Vec::new(), Vec::new());
    for &variant in &settings.variants {
        let (trial, result) = trial(variant, &seen, &truth, &prepared, &models, settings)?;
        trials.push(trial);
        results.push(result);
    }
    let request = PlaceRequest::new(prepared.scene_id.clone(), problem.query, vec![problem.goal]);
    let true_refusals = match answers.iter().map(|answer| refusal(&prepared, &request, &answer.placed_from_observed)).collect() {
        // Perception has not found the object, or saw too little of it.
        Err(CallError { code: ErrorCode::FailedPrecondition | ErrorCode::NotFound, .. }) => Vec::new(),
        refusals => refusals?,
    };
    let record = SceneRecord {
        set: set.name.clone(),
        slot,
        seed: problem.seed,
        kind: problem.truth.kind,
        query: problem.query,
        goal: problem.goal,
        true_supports: answers.len(),
        whole_based: truth.has_whole_based(&answers, &settings.truth, &settings.release),
        stands_alone: problem.index_of(problem.query).is_some_and(|query| stands_alone(&problem.truth.objects[query])),
        true_refusals,
        script: ScriptTrial::of(&seen, &settings.release),
        trials,
    };
    Ok(Some(TriedScene { truth: answers, record, results, problem: seen }))
}

/// Plans, with the candidates behind the answer where there is a report of them: none covers several sides of an object.
fn reported(prepared: &PreparedScene, request: &PlaceRequest, models: &OneScene<'_>) -> Result<PlanReport, CallError> {
    let go_on = &mut |_| ControlFlow::Continue(());
    if request.rotation == Rotation::Stable {
        return Ok(PlanReport { result: plan(prepared, request, models, go_on)?, answers: Vec::new(), best_in_view: None });
    }
    plan_with_report(prepared, request, models, go_on)
}

fn trial(
    variant: Variant,
    problem: &Problem,
    truth: &PreparedTruth<'_>,
    prepared: &PreparedScene,
    models: &OneScene<'_>,
    settings: &PlannerSceneSettings,
) -> Result<(VariantTrial, Option<PlaceResult>), CallError> {
    let request = PlaceRequest {
        variant,
        seed: problem.seed,
        count: settings.answers,
        rotation: settings.rotation,
        ..PlaceRequest::new(prepared.scene_id.clone(), problem.query, vec![problem.goal])
    };
    let started = Instant::now();
    let report = match reported(prepared, &request, models) {
        // It is believed to carry another object, or perception has not found it.
        Err(error) if matches!(error.code, ErrorCode::FailedPrecondition | ErrorCode::NotFound) => {
            return Ok((VariantTrial::refused(variant, error.message), None));
        }
        answered => answered?,
    };
    let plan_ms = started.elapsed().as_secs_f64() * 1e3;
    let result = report.result;

    let placed: Vec<Isometry3<f64>> = result.placements.iter().filter_map(|p| from_row_major(&p.placed_from_observed.0).ok()).collect();
    let first = placed.first().and_then(|p| release(problem, p, &settings.release));
    // One release a support: the first answer on it that succeeds, or all that fail.
    let mut supports: BTreeMap<Support, bool> = BTreeMap::new();
    for (i, p) in placed.iter().enumerate() {
        let Some(support) = truth.support_of(p) else { continue };
        let good = supports.entry(support).or_default();
        if !*good {
            let came = if i == 0 { first.map(|r| r.judged) } else { judge(problem, p, &settings.release) };
            *good = came.is_some_and(|j| j.joint());
        }
    }
    let in_view = match &report.best_in_view {
        Some(best) => {
            let there = best.candidate.placed_from_observed(&prepared.object(problem.query, "query")?.0.centroid);
            let moved_m = judge(problem, &there, &settings.release).map_or(f64::MAX, |j| j.moved_m);
            let asked = (best.relations.as_ref().map(|p| f64::from(p[0])), best.realism.map(f64::from));
            let (relations, realism) = match asked {
                (Some(relations), Some(realism)) if variant != Variant::Geometric => (relations, realism),
                _ => scores(problem, models, best.candidate.row())?,
            };
            Some(InView { relations, realism, moved_m })
        }
        None => None,
    };
    let trial = VariantTrial {
        variant,
        outcome: result.outcome,
        refused: None,
        release: first,
        said: first.and(result.placements.first()).map(|placement| SelfAssessment::by(placement, report.answers.first())),
        in_view,
        supports: supports.len(),
        good_supports: supports.values().filter(|good| **good).count(),
        rejections: result.rejections.clone(),
        plan_ms,
    };
    Ok((trial, Some(result)))
}

/// What the networks say of a candidate: probability of the goal as asked, and realism.
fn scores(problem: &Problem, models: &OneScene<'_>, candidate: [f32; 4]) -> Result<(f64, f64), CallError> {
    let goal = problem.goal;
    let request = ScoreRequest {
        scene: SceneRef { scene_id: models.scene_id().to_owned() },
        query: problem.query,
        anchors: vec![goal.anchor],
        view_yaw_rad: problem.viewer.yaw_rad(),
        realism: true,
        realism_by: RealismBy::Discriminator,
        relations: true,
        candidates: vec![candidate],
    };
    let reply = models.score(&request, models.scene())?;
    let (Some(realism), Some(relations)) = (reply.realism.first(), reply.relations.first()) else {
        return Err(CallError::internal("the networks left a candidate out"));
    };
    let p = f64::from(relations[goal.relation.index()]);
    Ok((if goal.holds { p } else { 1.0 - p }, f64::from(*realism)))
}
