//! The variants with networks, on fakes whose answers are known.

use std::ops::ControlFlow;

use repose_belief::learned::{kernel_id, models_hash};
use repose_proto::place::{Outcome, PlaceRequest, PlaceResult, Rejection, Variant};
use repose_proto::{ErrorCode, Relation};

use crate::learned::forecast::Forecast;
use crate::learned::{neighbours, standing, success};
use crate::plan::{SearchStep, plan, plan_with_report};
use crate::tests::fake::{BESIDE, Fake, always, moved_by, request, run, scene, stepped};
use crate::tests::synthetic::{Prepared, SceneBuilder};

#[test]
fn full_ends_where_realism_and_goal_are_highest_and_echoes_who_answered() {
    let prepared = scene();
    let result = run(&prepared, &request(&prepared, Variant::Full, &["right_of:1"]), &Fake::new(&[BESIDE]));
    assert_eq!(result.outcome, Outcome::Found, "{:?}", result.rejections);
    let best = &result.placements[0];
    assert!(best.realism > Some(0.985) && best.relations[0] > 0.95, "{best:?}");
    assert_eq!((result.weights_hash.as_str(), result.iterations), ("first", 5));
    assert_eq!(result.budget.batch, Some(100));
    let rejected: u64 = result.rejections.values().sum();
    assert!(rejected < result.evaluated && result.evaluated <= 5 * 3 * 100);
}

#[test]
fn a_result_says_what_beliefs_were_learned_with_and_completed_on_beside_the_networks_that_were_asked() {
    let prepared = scene();
    let full = run(&prepared, &request(&prepared, Variant::Full, &["right_of:1"]), &Fake::new(&[BESIDE]));
    let geometric = run(&prepared, &request(&prepared, Variant::Geometric, &["right_of:1"]), &Fake::new(&[BESIDE]));
    let own = kernel_id();
    assert_eq!((full.models_hash, full.kernel), (models_hash("first"), format!("fake+{own}")));
    assert_eq!((geometric.weights_hash.as_str(), geometric.models_hash, geometric.kernel.as_str()), ("", models_hash(""), own));
    assert!(!models_hash("").is_empty() && models_hash("first") != models_hash("second"));
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

#[test]
fn what_is_shown_on_the_way_is_nothing_that_could_be_no_answer() {
    let prepared = scene();
    let fake = Fake { success: Some(always(0.1, &success::names())), ..Fake::new(&[BESIDE]) };
    let shown = |min_success: Option<f64>| {
        let wanted = PlaceRequest { min_success, ..request(&prepared, Variant::Best, &["right_of:1"]) };
        let mut shown = Vec::new();
        plan(&prepared, &wanted, &fake, &mut |step| {
            if let SearchStep::Iteration(progress) = step {
                shown.extend(progress.best);
            }
            ControlFlow::Continue(())
        })
        .unwrap();
        shown
    };
    assert!(shown(None).is_empty(), "less sure than is wanted where a request does not say");
    let unsure = shown(Some(0.0));
    assert!(!unsure.is_empty() && unsure.iter().all(|best| best.realism > Some(0.05) && best.success.is_some()), "{unsure:?}");
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
    let (stands, stays) = (standing::names(), neighbours::names());
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
