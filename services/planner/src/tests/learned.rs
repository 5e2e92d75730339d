//! The variants with networks, on fakes whose answers are known: a prior around a place, relations and realism by simple formulas.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use nalgebra::Point3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use repose_geometry::{ViewerFrame, cloud, transform};
use repose_proto::place::{Outcome, PlaceRequest, PlaceResult, Rejection, Variant};
use repose_proto::scoring::{MixtureComponent, PriorReply, PriorRequest, ScoreReply, ScoreRequest};
use repose_proto::{CallError, ErrorCode, RELATION_COUNT, Relation, Scene};

use crate::checks::rules::Rules;
use crate::judge::Judge;
use crate::judge::problem::PlacementProblem;
use crate::learned::forecast::{Forecast, ForecastFitData, Forecasts};
use crate::learned::models::PlacementModels;
use crate::learned::{standing, success};
use crate::plan::{SearchStep, plan, plan_with_report};
use crate::scene::prepared::PreparedScene;
use crate::search::stop::StopReason;
use crate::settings::PlanSettings;
use crate::tests::forecasts;
use crate::tests::synthetic::{Prepared, SceneBuilder};
use repose_belief::boosted_trees::{BoostedTrees, Branch, DecisionTree, TreeSplit};

/// A fake whose prior has components at given offsets, whose realism falls with the distance from the nearest of some heights, and
/// whose only relation is `right_of`: likely where x exceeds the anchor's.
pub(crate) struct Fake {
    means_m: Vec<[f64; 3]>,
    real_height_m: f32,
    scored: AtomicUsize,
    /// From this score request on, another worker with other weights answers.
    changes_after: usize,
    /// From this score request on, the deadline passes before an answer comes.
    late_after: usize,
    /// What it says of success.
    pub(crate) success: Option<Forecast>,
    /// What it says of how objects stand: the forecasts of the program's weights where it says nothing of its own.
    pub(crate) stands: Option<Forecast>,
    neighbour_stays: Option<Forecast>,
}

impl Fake {
    pub(crate) fn new(means_m: &[[f64; 3]]) -> Self {
        Self {
            means_m: means_m.to_vec(),
            real_height_m: 0.045,
            scored: AtomicUsize::new(0),
            changes_after: usize::MAX,
            late_after: usize::MAX,
            success: None,
            stands: None,
            neighbour_stays: None,
        }
    }
}

impl PlacementModels for Fake {
    fn prior(&self, request: &PriorRequest, scene: &Arc<Scene>) -> Result<PriorReply, CallError> {
        let anchor: Vec<Point3<f32>> = scene.points_of(request.anchor).map(Point3::from).collect();
        let anchor = cloud::centroid(&anchor).unwrap();
        let weight = 1.0 / self.means_m.len() as f64;
        let component =
            |mean_m: &[f64; 3]| MixtureComponent { weight, mean_m: *mean_m, sigma_m: [0.03; 3], yaw_mean_rad: 0.0, yaw_concentration: 0.0 };
        let mut rng = Pcg64::seed_from_u64(request.seed);
        let (mut candidates, mut components) = (Vec::new(), Vec::new());
        for i in 0..request.count as usize {
            let k = i % self.means_m.len();
            let at: [f32; 3] = std::array::from_fn(|axis| {
                let z: f64 = StandardNormal.sample(&mut rng);
                (anchor[axis] + self.means_m[k][axis] + 0.03 * z) as f32
            });
            candidates.push([at[0], at[1], at[2], 0.0]);
            components.push(k as u8);
        }
        Ok(PriorReply {
            mixture: self.means_m.iter().map(component).collect(),
            weights_hash: "first".to_owned(),
            kernel: "fake".to_owned(),
            candidates,
            components,
        })
    }

    fn score(&self, request: &ScoreRequest, scene: &Arc<Scene>) -> Result<ScoreReply, CallError> {
        let calls = self.scored.fetch_add(1, Ordering::Relaxed);
        if calls >= self.late_after {
            return Err(CallError::new(ErrorCode::DeadlineExceeded, "the deadline passed before an answer came"));
        }
        // Never quite sure, so that what was asked can be told from what was not.
        let realism = |row: &[f32; 4]| 0.99 * (-((row[2] - self.real_height_m) / 0.02).powi(2)).exp();
        let relations = |row: &[f32; 4], anchor: u16| {
            let anchor: Vec<Point3<f32>> = scene.points_of(anchor).map(Point3::from).collect();
            let x = cloud::centroid(&anchor).unwrap().x as f32;
            let mut p = [0.1; RELATION_COUNT];
            p[Relation::RightOf.index()] = 1.0 / (1.0 + (-(row[0] - x - 0.05) / 0.01).exp());
            p
        };
        let rows = || request.candidates.iter();
        Ok(ScoreReply {
            weights_hash: if calls >= self.changes_after { "second" } else { "first" }.to_owned(),
            kernel: "fake".to_owned(),
            realism: if request.realism { rows().map(realism).collect() } else { Vec::new() },
            relations: match request.relations {
                true => rows().flat_map(|row| request.anchors.iter().map(move |a| relations(row, *a))).collect(),
                false => Vec::new(),
            },
            anchors: request.anchors.len(),
        })
    }

    fn forecasts(&self) -> Result<Arc<Forecasts>, CallError> {
        let known = (**forecasts()).clone();
        Ok(Arc::new(Forecasts {
            success: self.success.clone(),
            stands: self.stands.clone().unwrap_or(known.stands),
            neighbour_stays: self.neighbour_stays.clone().unwrap_or(known.neighbour_stays),
            ..known
        }))
    }
}

pub(crate) fn scene() -> PreparedScene {
    SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [-0.25, -0.2], [0.06, 0.05, 0.08]).prepared()
}

/// Has work done with the judge of a request on [`scene`], whose networks believe in places beside the anchor.
pub(crate) fn judging<T>(request: &PlaceRequest, settings: &PlanSettings, work: impl FnOnce(&mut Judge<'_>) -> T) -> T {
    judging_with(&Fake::new(&[BESIDE]), request, settings, work)
}

/// The same with networks of one's own.
pub(crate) fn judging_with<T>(fake: &Fake, request: &PlaceRequest, settings: &PlanSettings, work: impl FnOnce(&mut Judge<'_>) -> T) -> T {
    let prepared = scene();
    let query = prepared.query(request.query, 0.0, &settings.fixed).unwrap();
    let rules = Rules::new(&prepared, request.query, &request.goal, &ViewerFrame::from_yaw(0.0), &settings.fixed.rules).unwrap();
    let problem = PlacementProblem { prepared: &prepared, turned: None, query: &query, rules: &rules, request, settings };
    work(&mut Judge::new(problem, fake))
}

pub(crate) fn request(prepared: &PreparedScene, variant: Variant, goal: &[&str]) -> PlaceRequest {
    let goal = goal.iter().map(|t| t.parse().unwrap()).collect();
    PlaceRequest { variant, ..PlaceRequest::new(prepared.scene_id.clone(), 2, goal) }
}

fn run(prepared: &PreparedScene, request: &PlaceRequest, fake: &Fake) -> PlaceResult {
    plan(prepared, request, fake, &mut |_| ControlFlow::Continue(())).unwrap()
}

fn moved_by(result: &PlaceResult, answer: usize) -> nalgebra::Vector3<f64> {
    transform::from_row_major(&result.placements[answer].placed_from_observed.0).unwrap().translation.vector
}

pub(crate) const BESIDE: [f64; 3] = [0.16, 0.0, 0.0];

#[test]
fn full_ends_where_realism_and_goal_are_highest_and_echoes_who_answered() {
    let prepared = scene();
    let result = run(&prepared, &request(&prepared, Variant::Full, &["right_of:1"]), &Fake::new(&[BESIDE]));
    assert_eq!(result.outcome, Outcome::Found, "{:?}", result.rejections);
    let best = &result.placements[0];
    assert!(best.realism > Some(0.985) && best.relations[0] > 0.95, "{best:?}");
    assert_eq!((result.weights_hash.as_str(), result.kernel.as_str(), result.iterations), ("first", "fake", 5));
    assert_eq!(result.budget.batch, Some(100));
    let rejected: u64 = result.rejections.values().sum();
    assert!(rejected < result.evaluated && result.evaluated <= 5 * 3 * 100);
}

#[test]
fn without_the_discriminator_height_is_left_to_the_prior() {
    let prepared = scene();
    let fake = Fake::new(&[[0.16, 0.0, 0.15]]);
    let full = run(&prepared, &request(&prepared, Variant::Full, &["right_of:1"]), &fake);
    let blind = run(&prepared, &request(&prepared, Variant::NoDiscriminator, &["right_of:1"]), &fake);
    assert_eq!((full.outcome, blind.outcome), (Outcome::None, Outcome::Found), "{:?}", full.rejections);
    assert!(full.rejections[&Rejection::Unrealistic] > 100);
    assert_eq!(blind.placements[0].realism, None, "it is not asked");
    assert_eq!(blind.cost_weights.realism, Some(0.0));
}

#[test]
fn mean_only_tries_the_means_and_mdn_prior_stays_near_them() {
    let prepared = scene();
    let fake = Fake::new(&[BESIDE, [0.25, 0.1, 0.0]]);
    let means = run(&prepared, &request(&prepared, Variant::MeanOnly, &["right_of:1"]), &fake);
    assert_eq!((means.evaluated, means.iterations), (2, 1));
    let mut more = request(&prepared, Variant::MeanOnly, &["right_of:1"]);
    more.budget.iterations = Some(3);
    let more = run(&prepared, &more, &fake);
    assert_eq!((more.evaluated, more.iterations, more.budget.iterations), (2, 1, Some(1)), "no noise, however many are asked for");
    let mdn = run(&prepared, &request(&prepared, Variant::MdnPrior, &["right_of:1"]), &fake);
    assert_eq!(mdn.outcome, Outcome::Found);
    let anchor = prepared.belief.objects[&1].centroid;
    let placed = prepared.belief.objects[&2].centroid + moved_by(&mdn, 0);
    let nearest = fake.means_m.iter().map(|m| (placed - anchor - nalgebra::Vector3::from(*m)).norm()).fold(f64::INFINITY, f64::min);
    assert!(nearest < 0.02, "{nearest}");
}

/// A forecast of success that only looks at how likely the goal is: .9 from a half on, .2 below.
fn by_goal() -> Forecast {
    stepped(&success::names(), "goal", 0.5, [0.2, 0.9])
}

#[test]
fn best_says_how_sure_it_is_and_answers_none_where_that_is_too_little() {
    let prepared = scene();
    let fake = Fake { success: Some(by_goal()), ..Fake::new(&[BESIDE]) };
    let wanted = |goal: &str, min_success: Option<f64>| PlaceRequest { min_success, ..request(&prepared, Variant::Best, &[goal]) };
    // The fake predictor believes in `right_of` only.
    for (goal, said) in [("right_of:1", 0.9), ("left_of:1", 0.2)] {
        let result = run(&prepared, &wanted(goal, Some(0.0)), &fake);
        let success = result.placements[0].success.unwrap();
        assert!((success - said).abs() < 1e-6, "{goal}: {success}");
        let unasked = run(&prepared, &wanted(goal, None), &fake);
        assert_eq!((unasked.outcome == Outcome::Found, unasked.min_success), (said > 0.5, Some(0.5)), "{goal}");
        let enough = run(&prepared, &wanted(goal, Some(said - 0.05)), &fake);
        assert_eq!((enough.outcome, enough.min_success), (Outcome::Found, Some(said - 0.05)));
        let too_much = run(&prepared, &wanted(goal, Some(said + 0.05)), &fake);
        assert_eq!((too_much.outcome, too_much.placements.len()), (Outcome::None, 0));
        assert!(too_much.rejections[&Rejection::Unsure] > 0, "{:?}", too_much.rejections);
    }
    // Weights without the forecast say nothing and limit nothing, and refuse the demand.
    let silent = Fake { success: None, ..Fake::new(&[BESIDE]) };
    assert_eq!(run(&prepared, &wanted("right_of:1", None), &silent).placements[0].success, None);
    let error = plan(&prepared, &wanted("right_of:1", Some(0.5)), &silent, &mut |_| ControlFlow::Continue(())).unwrap_err();
    assert_eq!((error.code, error.field.as_deref()), (ErrorCode::FailedPrecondition, Some("min_success")));
}

/// A forecast that says the same of everything.
pub(crate) fn always(p: f32, names: &[&str]) -> Forecast {
    let leaf = DecisionTree { splits: Vec::new(), leaves: vec![(p / (1.0 - p)).ln()] };
    Forecast::new(names, BoostedTrees { bias: 0.0, trees: vec![leaf] }, ForecastFitData::default()).unwrap()
}

/// A forecast that says one thing where a measure is below a value, and another from there on.
pub(crate) fn stepped(names: &[&str], measure: &str, at: f32, said: [f32; 2]) -> Forecast {
    let number = names.iter().position(|name| *name == measure).unwrap() as u8;
    let splits = vec![TreeSplit(number, at, [Branch::Leaf(0), Branch::Leaf(1)])];
    let tree = DecisionTree { splits, leaves: said.map(|p| (p / (1.0 - p)).ln()).to_vec() };
    Forecast::new(names, BoostedTrees { bias: 0.0, trees: vec![tree] }, ForecastFitData::default()).unwrap()
}

#[test]
fn best_does_not_move_what_would_tip_or_bring_a_neighbour_down_and_says_which() {
    // A neighbour within 3 cm of the query, and the anchor far from both.
    let prepared = SceneBuilder::table()
        .object(1, [0.0, 0.0], [0.1, 0.1, 0.1])
        .object(2, [-0.25, -0.2], [0.06, 0.05, 0.08])
        .object(3, [-0.25, -0.13], [0.05, 0.05, 0.06])
        .prepared();
    let asked = request(&prepared, Variant::Best, &["right_of:1"]);
    let (stands, stays) = (standing::names(), standing::names_of_neighbour());
    let fake = |of_stands: f32, of_neighbour: f32| Fake {
        stands: Some(always(of_stands, &stands)),
        neighbour_stays: Some(always(of_neighbour, &stays)),
        ..Fake::new(&[BESIDE])
    };
    assert_eq!(run(&prepared, &asked, &fake(0.9, 0.9)).outcome, Outcome::Found);
    for (fake, reason) in [(fake(0.05, 0.9), Rejection::Tips), (fake(0.9, 0.05), Rejection::Unsettles)] {
        let refused = run(&prepared, &asked, &fake);
        assert_eq!(refused.outcome, Outcome::None);
        assert_eq!(refused.rejections.keys().collect::<Vec<_>>(), [&reason], "{:?}", refused.rejections);
        // `geometric` asks no network, and goes by its rule.
        let by_rule = run(&prepared, &PlaceRequest { variant: Variant::Geometric, ..asked.clone() }, &fake);
        assert_eq!(by_rule.outcome, Outcome::Found);
    }
    // Without a neighbour nothing can come down.
    let alone = scene();
    assert_eq!(run(&alone, &request(&alone, Variant::Best, &["right_of:1"]), &fake(0.9, 0.05)).outcome, Outcome::Found);
}

#[test]
fn answers_come_from_every_mode_of_the_prior() {
    let prepared = scene();
    let mut wanted = request(&prepared, Variant::Full, &["right_of:1"]);
    (wanted.count, wanted.min_separation_m) = (6, Some(0.08));
    let result = run(&prepared, &wanted, &Fake::new(&[[0.16, -0.12, 0.0], [0.2, 0.15, 0.0]]));
    let y: Vec<f64> = (0..result.placements.len()).map(|i| prepared.belief.objects[&2].centroid.y + moved_by(&result, i).y).collect();
    assert!(y.iter().any(|y| *y < 0.0) && y.iter().any(|y| *y > 0.08), "{y:?}");
}

#[test]
fn best_stands_on_the_table_whatever_the_prior_thinks() {
    let prepared = scene();
    let result = run(&prepared, &request(&prepared, Variant::Best, &["right_of:1"]), &Fake::new(&[[0.16, 0.0, 0.03]]));
    assert_eq!(result.outcome, Outcome::Found, "{:?}", result.rejections);
    let best = &result.placements[0];
    assert!(moved_by(&result, 0).z.abs() < 0.008, "{}", moved_by(&result, 0));
    assert!(best.geometric[0].holds && best.support_m > Some(0.01) && best.relations[0] > 0.5 && best.realism.is_some(), "{best:?}");
}

#[test]
fn what_the_discriminator_would_believe_decides_the_relaxation() {
    let prepared = scene();
    let result = run(&prepared, &request(&prepared, Variant::Full, &["right_of:1", "left_of:1"]), &Fake::new(&[BESIDE]));
    assert_eq!(result.outcome, Outcome::None);
    let relaxation = result.relaxation.unwrap();
    assert_eq!(relaxation.term.relation, Relation::LeftOf, "the fake never believes it");
    let kept_out = result.rejections[&Rejection::Goal];
    assert!((1..kept_out).contains(&relaxation.admits), "{relaxation:?} of {kept_out}");
    // The sample stands for all of them: in five iterations more pass without the term than one batch has.
    assert!(relaxation.admits > 100, "{relaxation:?}");
}

#[test]
fn best_blames_no_term_for_what_would_not_be_believed_anyway() {
    let prepared = scene();
    let mut wanted = request(&prepared, Variant::Best, &["right_of:1", "left_of:1"]);
    let result = run(&prepared, &wanted, &Fake::new(&[BESIDE]));
    assert!(result.outcome == Outcome::None && result.relaxation.is_some_and(|r| r.admits > 10));
    wanted.thresholds.realism = Some(1.0);
    let result = run(&prepared, &wanted, &Fake::new(&[BESIDE]));
    assert_eq!((result.outcome, result.relaxation), (Outcome::None, None));
}

#[test]
fn an_asked_clearance_is_kept_though_collisions_are_left_to_the_discriminator() {
    // Where the prior draws, something stands already.
    let prepared = SceneBuilder::table()
        .object(1, [0.0, 0.0], [0.1, 0.1, 0.1])
        .object(2, [-0.25, -0.2], [0.06, 0.05, 0.08])
        .object(3, [0.16, 0.0], [0.06, 0.08, 0.1])
        .prepared();
    for min_clearance_m in [0.02, 0.13] {
        let mut wanted = request(&prepared, Variant::MdnPrior, &["right_of:1"]);
        let result = run(&prepared, &wanted, &Fake::new(&[BESIDE]));
        assert!(result.placements[0].clearance_m.unwrap() < 0.01, "without it the paper's planner collides");
        wanted.min_clearance_m = Some(min_clearance_m);
        let result = run(&prepared, &wanted, &Fake::new(&[BESIDE]));
        assert!(result.rejections[&Rejection::Clearance] > 50, "{:?}", result.rejections);
        assert!(result.placements.iter().all(|p| p.clearance_m.unwrap() >= min_clearance_m), "{:?}", result.placements);
    }
}

#[test]
fn a_deadline_within_a_batch_is_partial_as_one_between_two_is() {
    let prepared = scene();
    for variant in [Variant::Full, Variant::Best] {
        let wanted = PlaceRequest { count: 4, ..request(&prepared, variant, &["right_of:1"]) };
        let whole = Fake::new(&[BESIDE]);
        run(&prepared, &wanted, &whole);
        let asked = whole.scored.load(Ordering::Relaxed);
        assert!(asked > 2, "{variant}: {asked}");
        for late_after in 0..asked {
            let fake = Fake { late_after, ..Fake::new(&[BESIDE]) };
            let mut iterations = 0;
            let ended = plan(&prepared, &wanted, &fake, &mut |step| {
                iterations += u32::from(step != SearchStep::Batch);
                ControlFlow::Continue(())
            });
            match ended {
                Err(error) => assert_eq!((error.code, iterations), (ErrorCode::DeadlineExceeded, 0), "{variant}: {late_after} of {asked}"),
                Ok(partial) => {
                    assert_eq!(partial.outcome, Outcome::Partial, "{variant}: {late_after} of {asked}");
                    assert!(partial.iterations >= iterations && partial.placements.iter().all(|p| p.realism.is_some()));
                    // One iteration leaves the best so far; where networks only rank, from when they were first asked about it on.
                    assert!(iterations == 0 || !partial.placements.is_empty(), "{variant}: {late_after} of {asked}");
                }
            }
            assert_eq!(fake.scored.load(Ordering::Relaxed), late_after + 1, "{variant}: after the deadline nothing is asked");
        }
    }
}

#[test]
fn a_deadline_while_evidence_is_gathered_leaves_the_answer() {
    let prepared = scene();
    let wanted = request(&prepared, Variant::Full, &["right_of:1", "left_of:1"]);
    let whole = Fake::new(&[BESIDE]);
    let result = run(&prepared, &wanted, &whole);
    let late_after = whole.scored.load(Ordering::Relaxed) - 1;
    let late = run(&prepared, &wanted, &Fake { late_after, ..Fake::new(&[BESIDE]) });
    assert_eq!((late.outcome, &late.rejections), (Outcome::None, &result.rejections));
    assert!(result.relaxation.is_some() && late.relaxation.is_none());
}

#[test]
fn where_networks_only_rank_nothing_is_returned_that_they_were_not_asked_about() {
    // One small batch an iteration: of some seeds the first has no feasible candidate and the second some.
    let prepared = scene();
    let mut unasked = 0;
    for seed in 0..60 {
        let mut wanted = PlaceRequest { seed, ..request(&prepared, Variant::Best, &["right_of:1", "near:1"]) };
        (wanted.budget.batch, wanted.budget.draws_per_batch) = (Some(4), Some(1));
        let (mut iterations, mut batches) = (0, 0);
        let ended = plan(&prepared, &wanted, &Fake::new(&[BESIDE]), &mut |step| {
            match step {
                SearchStep::Iteration(_) => (iterations, batches) = (iterations + 1, 0),
                SearchStep::Batch => batches += 1,
            }
            if iterations == 1 && batches == 2 { ControlFlow::Break(StopReason::Deadline) } else { ControlFlow::Continue(()) }
        });
        let Ok(partial) = ended else { continue };
        assert!(partial.placements.iter().all(|p| p.realism.is_some()), "seed {seed}: {:?}", partial.placements);
        let accepted = partial.evaluated > partial.rejections.values().sum();
        unasked += usize::from(partial.outcome == Outcome::Partial && accepted && partial.placements.is_empty());
    }
    assert!(unasked > 0, "no seed had such a search");
}

#[test]
fn as_many_answers_are_given_as_are_asked_where_there_is_room() {
    let prepared = scene();
    let mut wanted = request(&prepared, Variant::Best, &["right_of:1"]);
    // The fake believes in one height only; here anything goes.
    wanted.thresholds.realism = Some(0.0);
    let one = run(&prepared, &wanted, &Fake::new(&[BESIDE]));
    (wanted.count, wanted.min_separation_m) = (6, Some(0.08));
    let several = run(&prepared, &wanted, &Fake::new(&[BESIDE]));
    assert_eq!(several.placements.len(), 6, "{:?}", several.rejections);
    assert_eq!(several.placements[0], one.placements[0], "the first answer is the same");
    let moved: Vec<_> = (0..6).map(|i| moved_by(&several, i)).collect();
    assert!((1..6).all(|i| (0..i).all(|j| (moved[i] - moved[j]).norm() >= 0.08 - 1e-6)), "{moved:?}");
    assert!(several.placements.iter().all(|p| p.realism.is_some()), "all were asked");
}

#[test]
fn without_an_answer_the_report_still_has_the_lowest_cost_in_view() {
    let prepared = scene();
    let wanted = request(&prepared, Variant::Full, &["right_of:1"]);
    let fake = Fake::new(&[[0.16, 0.0, 0.15]]);
    let report = plan_with_report(&prepared, &wanted, &fake, &mut |_| ControlFlow::Continue(())).unwrap();
    let best = report.best_in_view.unwrap();
    assert!(report.answers.is_empty() && best.cost.is_finite() && best.realism.is_some() && best.relations.is_some());
}

#[test]
fn a_stop_at_any_batch_asks_nothing_more_and_says_what_it_is() {
    let prepared = scene();
    for variant in [Variant::Full, Variant::Best] {
        let wanted = PlaceRequest { count: 4, ..request(&prepared, variant, &["right_of:1"]) };
        let mut batches = 0;
        let whole = plan(&prepared, &wanted, &Fake::new(&[BESIDE]), &mut |step| {
            batches += usize::from(step == SearchStep::Batch);
            ControlFlow::Continue(())
        })
        .unwrap();
        for stop_at in 0..batches {
            for stop in [StopReason::Deadline, StopReason::Cancelled] {
                let fake = Fake::new(&[BESIDE]);
                let (mut seen, mut iterations, mut asked) = (0, 0, 0);
                let ended = plan(&prepared, &wanted, &fake, &mut |step| {
                    let SearchStep::Iteration(_) = step else {
                        seen += 1;
                        asked = fake.scored.load(Ordering::Relaxed);
                        return if seen > stop_at { ControlFlow::Break(stop) } else { ControlFlow::Continue(()) };
                    };
                    iterations += 1;
                    ControlFlow::Continue(())
                });
                assert_eq!(fake.scored.load(Ordering::Relaxed), asked, "{variant}: nothing is asked after the stop at batch {stop_at}");
                match (stop, iterations, ended) {
                    (StopReason::Cancelled, _, ended) => assert_eq!(ended.unwrap_err().code, ErrorCode::Cancelled),
                    (StopReason::Deadline, 0, ended) => assert_eq!(ended.unwrap_err().code, ErrorCode::DeadlineExceeded),
                    (StopReason::Deadline, _, ended) => {
                        let partial = ended.unwrap();
                        assert_eq!((partial.outcome, partial.iterations), (Outcome::Partial, iterations));
                        assert!(partial.evaluated <= whole.evaluated);
                        // What the networks were not asked about is not passed off as believed.
                        assert!(partial.placements.iter().all(|p| p.realism.is_some()), "{variant}: {:?}", partial.placements);
                    }
                }
            }
        }
        assert_eq!(whole.outcome, Outcome::Found);
        assert!(batches >= 4, "{variant}: {batches} batches");
    }
}

#[test]
fn several_answers_are_ranked_with_what_the_networks_say_of_each() {
    // A large box on the asked side: both it and the table are among the answers, and every one was put to the networks.
    let prepared = SceneBuilder::table()
        .object(1, [0.0, 0.0], [0.1, 0.1, 0.1])
        .object(2, [-0.25, -0.2], [0.06, 0.05, 0.08])
        .object(3, [0.28, 0.02], [0.2, 0.25, 0.06])
        .prepared();
    let mut wanted = request(&prepared, Variant::Best, &["right_of:1"]);
    (wanted.count, wanted.min_separation_m) = (4, Some(0.05));
    // The fake believes in one height only; here anything goes.
    wanted.thresholds.realism = Some(0.0);
    let result = run(&prepared, &wanted, &Fake::new(&[[0.25, 0.0, 0.0]]));
    assert_eq!(result.placements.len(), 4, "{:?}", result.rejections);
    assert!(result.placements.windows(2).all(|w| w[0].cost <= w[1].cost));
    assert!(result.placements.iter().all(|p| p.realism.is_some()), "all were asked");
    let heights: Vec<f64> = (0..4).map(|i| moved_by(&result, i).z).collect();
    assert!(heights.iter().any(|z| *z < 0.02) && heights.iter().any(|z| *z > 0.04), "{heights:?}");
}

#[test]
fn what_is_believed_less_than_asked_is_no_answer_though_geometry_would_have_it() {
    let prepared = scene();
    let mut fake = Fake::new(&[BESIDE]);
    let mut wanted = request(&prepared, Variant::Best, &["right_of:1"]);
    let believed = run(&prepared, &wanted, &fake);
    assert_eq!((believed.outcome, believed.thresholds.realism), (Outcome::Found, Some(0.05)));
    let realism = |result: &PlaceResult| result.placements[0].realism.unwrap();
    // The network doubts all of it now; what geometry measures still speaks for it.
    fake.real_height_m = 0.4;
    let doubted = run(&prepared, &wanted, &fake);
    assert_eq!(doubted.outcome, Outcome::Found);
    assert!(realism(&doubted) < realism(&believed) - 0.05, "{doubted:?}");
    wanted.thresholds.realism = Some((realism(&doubted) + realism(&believed)) / 2.0);
    let result = run(&prepared, &wanted, &fake);
    assert_eq!((result.outcome, result.placements.len()), (Outcome::None, 0));
    assert!(result.rejections[&Rejection::Unrealistic] > 5, "{:?}", result.rejections);
    let geometric = run(&prepared, &PlaceRequest { variant: Variant::Geometric, ..wanted }, &fake);
    assert_eq!(geometric.outcome, Outcome::Found);
}

#[test]
fn weights_that_change_half_way_end_the_request() {
    let prepared = scene();
    let fake = Fake { changes_after: 3, ..Fake::new(&[BESIDE]) };
    let wanted = request(&prepared, Variant::Full, &["right_of:1"]);
    let error = plan(&prepared, &wanted, &fake, &mut |_| ControlFlow::Continue(())).unwrap_err();
    assert_eq!(error.code, ErrorCode::Unavailable);
}
