//! What the planner answers on scenes whose answer is known.

use std::ops::ControlFlow;

use nalgebra::{Isometry3, Translation3};
use repose_geometry::transform;
use repose_proto::place::{
    Outcome, PlaceRequest, PlaceResult, ReachingRobot, RegionBox, Rejection, Rotation, Shortfall, ShortfallReason, Variant,
};
use repose_proto::{ErrorCode, GoalTerm, RigidTransform};

use crate::checks::clearance::Clearance;
use crate::judge::constraints::Constraints;
use crate::learned::models::NoModels;
use crate::plan::{SearchStep, plan, refusal};
use crate::scene::moved::table_after;
use crate::scene::prepared::PreparedScene;
use crate::search::stop::StopReason;
use crate::settings::PlanSettings;
use crate::tests::synthetic::{Prepared, SceneBuilder, posed, standing_at};

/// A table with a box in the middle (1) and a small box in front on the left (2).
fn table() -> SceneBuilder {
    SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [-0.25, -0.2], [0.06, 0.05, 0.08])
}

pub(crate) fn request(prepared: &PreparedScene, query: u16, goal: &[&str]) -> PlaceRequest {
    let goal: Vec<GoalTerm> = goal.iter().map(|t| t.parse().unwrap()).collect();
    PlaceRequest { variant: Variant::Geometric, ..PlaceRequest::new(prepared.scene_id.clone(), query, goal) }
}

pub(crate) fn run(prepared: &PreparedScene, request: &PlaceRequest) -> PlaceResult {
    plan(prepared, request, &NoModels, &mut |_| ControlFlow::Continue(())).unwrap()
}

fn most_frequent(result: &PlaceResult) -> Rejection {
    *result.rejections.iter().max_by_key(|(_, count)| **count).unwrap().0
}

/// Where the middle of the query's box ends up: observed centroids are not middles.
fn placed(result: &PlaceResult, answer: usize, middle: [f64; 3]) -> [f64; 3] {
    let placed_from_observed = transform::from_row_major(&result.placements[answer].placed_from_observed.0).unwrap();
    (placed_from_observed * nalgebra::Point3::from(middle)).into()
}

const QUERY_MIDDLE: [f64; 3] = [-0.25, -0.2, 0.04];

#[test]
fn every_direction_is_found_on_an_open_table_and_stands_on_it() {
    let prepared = table().prepared();
    for (term, axis, sign) in [("left_of:1", 0, -1.0), ("right_of:1", 0, 1.0), ("in_front_of:1", 1, -1.0), ("behind:1", 1, 1.0)] {
        let result = run(&prepared, &request(&prepared, 2, &[term]));
        assert_eq!(result.outcome, Outcome::Found, "{term}: {:?}", result.rejections);
        let at = placed(&result, 0, QUERY_MIDDLE);
        assert!(sign * at[axis] > 0.05 && at[1 - axis].abs() < 0.25, "{term}: {at:?}");
        assert!((at[2] - 0.04).abs() < 0.008, "{term}: {at:?}");
        let best = &result.placements[0];
        assert!(
            best.geometric[0].holds
                && best.geometric[0].margin_m > 0.01
                && best.support_m.unwrap() > 0.015
                && best.clearance_m.unwrap() > 0.005
        );
        assert_eq!((best.realism, &best.relations[..]), (None, &[1.0][..]), "no network was asked");
        assert_eq!(result.world_from_camera, prepared.scene.meta.camera.world_from_camera);
    }
}

#[test]
fn what_may_reach_lower_than_is_believed_is_let_go_higher_and_is_believed_to_come_down() {
    let with_doubt = |foot_doubt_m: f32| {
        let sure = table().prepared();
        let mut shapes = sure.belief.shapes();
        shapes.get_mut(&2).unwrap().foot_doubt_m = foot_doubt_m;
        PreparedScene::with_shapes(sure.scene.clone(), shapes)
    };
    let (sure, doubted) = (with_doubt(0.0), with_doubt(0.015));
    let let_go = |table: &PreparedScene| {
        let result = run(table, &request(table, 2, &["right_of:1"]));
        transform::from_row_major(&result.placements[0].placed_from_observed.0).unwrap()
    };
    let rise_m = let_go(&doubted).translation.z - let_go(&sure).translation.z;
    assert!((rise_m - 0.015).abs() < 1e-6, "{rise_m}");
    let rest_m = |table: &PreparedScene| {
        let after = table_after(table, 2, &let_go(table), Variant::Geometric);
        after.belief.objects[&2].shape.as_ref().unwrap().bottom_m
    };
    assert!((rest_m(&doubted) - rest_m(&sure)).abs() < 1e-6);
}

#[test]
fn a_small_box_is_stacked_in_the_middle_of_a_larger_one() {
    let prepared = table().prepared();
    let result = run(&prepared, &request(&prepared, 2, &["above:1", "near:1"]));
    assert_eq!(result.outcome, Outcome::Found, "{:?}", result.rejections);
    let at = placed(&result, 0, QUERY_MIDDLE);
    assert!((at[2] - 0.14).abs() < 0.008 && at[0].abs() < 0.03 && at[1].abs() < 0.03, "{at:?}");
    let result = run(&prepared, &request(&prepared, 2, &["centered:1", "touching:1"]));
    let at = placed(&result, 0, QUERY_MIDDLE);
    assert!((at[2] - 0.14).abs() < 0.008, "{at:?} {:?}", result.rejections);
}

#[test]
fn below_is_found_beside_something_that_stands_higher() {
    let prepared = SceneBuilder::table()
        .object(3, [0.1, 0.05], [0.12, 0.12, 0.16])
        .object_at(1, [0.1, 0.05], 0.16, [0.08, 0.08, 0.08])
        .object(2, [-0.25, -0.2], [0.05, 0.05, 0.05])
        .prepared();
    let result = run(&prepared, &request(&prepared, 2, &["below:1"]));
    assert_eq!(result.outcome, Outcome::Found, "{:?}", result.rejections);
    assert!(result.placements[0].geometric[0].holds);
}

#[test]
fn negated_terms_and_several_anchors_hold_together() {
    let prepared = table().object(3, [0.25, 0.1], [0.08, 0.08, 0.12]).prepared();
    let result = run(&prepared, &request(&prepared, 2, &["right_of:1", "not:near:1", "in_front_of:3"]));
    assert_eq!(result.outcome, Outcome::Found, "{:?}", result.rejections);
    assert!(result.placements[0].geometric.iter().all(|c| c.holds && c.margin_m > 0.0), "{:?}", result.placements[0]);
}

#[test]
fn touching_beside_comes_to_rest_against_the_anchor() {
    let prepared = table().prepared();
    let result = run(&prepared, &request(&prepared, 2, &["touching:1", "right_of:1"]));
    assert_eq!(result.outcome, Outcome::Found, "{:?}", result.rejections);
    let at = placed(&result, 0, QUERY_MIDDLE);
    assert!((0.07..0.09).contains(&at[0]), "{at:?}");
}

#[test]
fn a_turn_aligns_the_query_with_its_anchor() {
    let prepared = table().prepared();
    let mut aligned = request(&prepared, 2, &["left_of:1", "aligned:1"]);
    aligned.rotation = Rotation::Yaw;
    let result = run(&prepared, &aligned);
    assert_eq!(result.outcome, Outcome::Found, "{:?}", result.rejections);
    assert!(result.placements[0].geometric[1].holds);
}

#[test]
fn a_place_is_refused_by_what_a_search_refuses_it_by_and_an_answer_is_not() {
    let prepared = table().prepared();
    let mut wanted = request(&prepared, 2, &["right_of:1"]);
    (wanted.count, wanted.rotation) = (4, Rotation::Yaw);
    let result = run(&prepared, &wanted);
    assert!(result.placements.len() > 1, "{:?}", result.rejections);
    let why = |placed: &Isometry3<f64>| refusal(&prepared, &wanted, placed).unwrap();
    for placement in &result.placements {
        let placed = transform::from_row_major(&placement.placed_from_observed.0).unwrap();
        assert_eq!(why(&placed), None);
        assert_eq!(why(&(Translation3::new(0.0, 5.0, 0.0) * placed)), Some(Rejection::OutOfView));
    }
    assert_eq!(why(&Isometry3::translation(-0.12, 0.0, 0.0)), Some(Rejection::Goal), "there it stands free, to the left");
}

#[test]
fn several_answers_keep_their_distance_and_use_both_table_and_box() {
    // A large box that is furniture to the goal, on the asked side.
    let prepared = table().object(3, [0.28, 0.02], [0.2, 0.25, 0.06]).prepared();
    let mut wanted = request(&prepared, 2, &["right_of:1"]);
    (wanted.count, wanted.min_separation_m) = (8, Some(0.05));
    let result = run(&prepared, &wanted);
    assert_eq!(result.placements.len(), 8, "{:?}", result.rejections);
    let all: Vec<[f64; 3]> = (0..8).map(|i| placed(&result, i, QUERY_MIDDLE)).collect();
    for i in 0..8 {
        assert!((0..i).all(|j| (nalgebra::Point3::from(all[i]) - nalgebra::Point3::from(all[j])).norm() >= 0.05 - 1e-6));
    }
    assert!(result.placements.windows(2).all(|w| w[0].cost <= w[1].cost));
    assert!(all.iter().any(|p| p[2] > 0.08), "none on the box: {all:?}");
    assert!(all.iter().any(|p| p[2] < 0.06), "none on the table: {all:?}");
}

#[test]
fn nothing_is_put_over_an_edge_however_few_places_there_are() {
    let prepared = table().prepared();
    let mut wanted = request(&prepared, 2, &["right_of:1"]);
    // The table ends at x = 0.5, and the query is 6 cm wide.
    wanted.region = vec![RegionBox { min_m: [0.4, -0.3, -1.0], max_m: [0.6, 0.3, 1.0], inside: true }];
    (wanted.count, wanted.min_separation_m) = (16, Some(0.02));
    let result = run(&prepared, &wanted);
    assert!(!result.placements.is_empty(), "{:?}", result.rejections);
    for answer in 0..result.placements.len() {
        let [x, ..] = placed(&result, answer, QUERY_MIDDLE);
        assert!(x + 0.03 < 0.508, "answer {answer} hangs over: {x}");
    }
}

#[test]
fn places_beyond_the_reach_of_the_robot_that_is_named_are_no_answers() {
    let prepared = table().prepared();
    let with_base = |x: f64| {
        let mut wanted = request(&prepared, 2, &["right_of:1"]);
        let mut pose = RigidTransform::IDENTITY;
        pose.0[3] = x;
        wanted.robot = Some(ReachingRobot { name: "arm".to_owned(), world_from_base: Some(pose) });
        wanted
    };
    let near = run(&prepared, &with_base(-0.35));
    assert_eq!((near.outcome, &near.robot), (Outcome::Found, &with_base(-0.35).robot), "{:?}", near.rejections);
    let far = run(&prepared, &with_base(-1.6));
    assert_eq!(far.outcome, Outcome::None, "{:?}", far.placements);
    assert!(far.rejections[&Rejection::OutOfReach] > 20, "{:?}", far.rejections);
    let mut unknown = with_base(0.0);
    unknown.robot = Some(ReachingRobot { name: "arm".to_owned(), world_from_base: None });
    let error = plan(&prepared, &unknown, &NoModels, &mut |_| ControlFlow::Continue(())).unwrap_err();
    assert_eq!((error.code, error.field.as_deref()), (ErrorCode::FailedPrecondition, Some("robot")));
}

#[test]
fn a_variant_that_does_not_say_how_sure_it_is_refuses_the_demand() {
    let prepared = table().prepared();
    let demanding = PlaceRequest { min_success: Some(0.9), ..request(&prepared, 2, &["right_of:1"]) };
    let error = plan(&prepared, &demanding, &NoModels, &mut |_| ControlFlow::Continue(())).unwrap_err();
    assert_eq!((error.code, error.field.as_deref()), (ErrorCode::FailedPrecondition, Some("min_success")));
    let undemanding = PlaceRequest { min_success: Some(0.0), ..demanding };
    assert_eq!(run(&prepared, &undemanding).min_success, None, "nobody was asked");
}

#[test]
fn fewer_answers_than_asked_come_with_the_reason() {
    let prepared = table().prepared();
    let mut wanted = request(&prepared, 2, &["right_of:1"]);
    wanted.count = 3;
    assert_eq!(run(&prepared, &wanted).shortfall, None);
    // Nothing on the table is three metres from anything else on it.
    wanted.min_separation_m = Some(3.0);
    let result = run(&prepared, &wanted);
    let shortfall = result.shortfall.unwrap();
    assert_eq!((result.placements.len(), shortfall.reason), (1, ShortfallReason::Separation));
    assert!(shortfall.passed > 100 && shortfall.too_close == shortfall.passed - 1, "{shortfall:?}");
    (wanted.budget.iterations, wanted.budget.batch, wanted.budget.draws_per_batch) = (Some(1), Some(1), Some(1));
    let alone = (0..50).map(|seed| run(&prepared, &PlaceRequest { seed, ..wanted.clone() })).find(|r| r.placements.len() == 1).unwrap();
    assert_eq!(alone.shortfall, Some(Shortfall { reason: ShortfallReason::Constraints, passed: 1, too_close: 0 }));
}

#[test]
fn a_forbidden_region_is_the_reason() {
    let prepared = table().prepared();
    let mut blocked = request(&prepared, 2, &["right_of:1"]);
    blocked.region = vec![RegionBox { min_m: [-2.0; 3], max_m: [2.0; 3], inside: false }];
    let result = run(&prepared, &blocked);
    assert_eq!((result.outcome, most_frequent(&result)), (Outcome::None, Rejection::Region));
    assert_eq!(result.rejections.values().sum::<u64>(), result.evaluated);
    for (reason, places) in &result.rejected_at_m {
        let most = result.rejections[reason].min(48) as usize;
        assert!(places.len() >= most / 2 && places.len() <= most, "{reason:?}: {} of {most}", places.len());
    }
    assert!(result.rejected_at_m.keys().eq(result.rejections.keys()));
    let found = run(&prepared, &request(&prepared, 2, &["right_of:1"]));
    assert!(found.outcome == Outcome::Found && found.rejected_at_m.is_empty(), "whoever has an answer is not sent them");
}

#[test]
fn a_small_asked_region_is_found() {
    let prepared = table().prepared();
    let mut asked = request(&prepared, 2, &["right_of:1"]);
    asked.region = vec![RegionBox { min_m: [0.3, -0.1, -0.1], max_m: [0.34, -0.06, 0.5], inside: true }];
    let result = run(&prepared, &asked);
    assert_eq!(result.outcome, Outcome::Found, "{:?}", result.rejections);
}

#[test]
fn what_is_drawn_first_is_drawn_over_the_region_that_is_asked_for() {
    let prepared = table().prepared();
    let mut asked = request(&prepared, 2, &["right_of:1"]);
    asked.budget.iterations = Some(1);
    asked.region = vec![RegionBox { min_m: [0.2, -0.3, -1.0], max_m: [0.5, 0.3, 1.0], inside: true }];
    let result = run(&prepared, &asked);
    let outside = result.rejections.get(&Rejection::Region).copied().unwrap_or_default();
    assert!(outside * 20 <= result.evaluated, "{outside} of {}", result.evaluated);
}

#[test]
fn off_the_table_nothing_supports_it() {
    // The anchor stands at the table's left edge, and nothing is beyond.
    let prepared = SceneBuilder::table_within([-0.2, -0.4, 0.5, 0.4])
        .object(1, [-0.14, 0.0], [0.1, 0.1, 0.1])
        .object(2, [0.3, -0.2], [0.06, 0.05, 0.08])
        .prepared();
    let result = run(&prepared, &request(&prepared, 2, &["left_of:1"]));
    assert_eq!((result.outcome, most_frequent(&result)), (Outcome::None, Rejection::Unsupported), "{:?}", result.rejections);
}

#[test]
fn out_of_the_picture_it_would_not_be_seen() {
    // The camera sees to about 0.6 m on either side; the anchor stands at the right end of a long table.
    let prepared = SceneBuilder::table_within([-1.5, -0.4, 1.5, 0.4])
        .object(1, [0.5, 0.0], [0.1, 0.1, 0.1])
        .object(2, [0.0, -0.2], [0.06, 0.05, 0.08])
        .prepared();
    let result = run(&prepared, &request(&prepared, 2, &["right_of:1", "not:near:1"]));
    assert_eq!((result.outcome, most_frequent(&result)), (Outcome::None, Rejection::OutOfView), "{:?}", result.rejections);
}

#[test]
fn behind_a_wall_it_would_be_hidden() {
    let prepared = SceneBuilder::table().object(1, [0.0, -0.1], [0.7, 0.04, 0.35]).object(2, [0.1, -0.3], [0.05, 0.05, 0.05]).prepared();
    let mut hidden = request(&prepared, 2, &["behind:1"]);
    hidden.region = vec![RegionBox { min_m: [-0.4, -0.07, -0.1], max_m: [0.4, 0.15, 0.3], inside: true }];
    let result = run(&prepared, &hidden);
    assert_eq!((result.outcome, most_frequent(&result)), (Outcome::None, Rejection::OutOfView), "{:?}", result.rejections);
}

#[test]
fn contradictory_terms_are_named_with_the_one_to_give_up() {
    let prepared = table().prepared();
    let result = run(&prepared, &request(&prepared, 2, &["left_of:1", "right_of:1"]));
    assert_eq!((result.outcome, most_frequent(&result)), (Outcome::None, Rejection::Goal), "{:?}", result.rejections);
    let relaxation = result.relaxation.unwrap();
    assert!(relaxation.admits > 10 && result.goal.contains(&relaxation.term));
}

#[test]
fn the_asked_clearance_is_kept() {
    // The tallest is on the other side: on top of it nothing would be in the way.
    let prepared = table().object(3, [0.25, 0.0], [0.08, 0.1, 0.1]).object(4, [-0.35, 0.25], [0.06, 0.06, 0.3]).prepared();
    let mut wide = request(&prepared, 2, &["right_of:1"]);
    wide.min_clearance_m = Some(0.06);
    let result = run(&prepared, &wide);
    assert_eq!(result.outcome, Outcome::Found, "{:?}", result.rejections);
    assert!(result.placements[0].clearance_m.unwrap() >= 0.06, "{:?}", result.placements[0].clearance_m);
    wide.min_clearance_m = Some(0.14);
    let result = run(&prepared, &wide);
    assert_eq!(result.outcome, Outcome::Found, "{:?}", result.rejections);
    assert!(result.placements[0].clearance_m.unwrap() >= 0.14, "{:?}", result.placements[0].clearance_m);
    wide.min_clearance_m = Some(0.9);
    let result = run(&prepared, &wide);
    assert_eq!((result.outcome, most_frequent(&result)), (Outcome::None, Rejection::Clearance), "{:?}", result.rejections);
    wide.min_clearance_m = Some(5.0);
    let error = plan(&prepared, &wide, &NoModels, &mut |_| ControlFlow::Continue(())).unwrap_err();
    assert_eq!((error.code, error.field.as_deref()), (ErrorCode::InvalidArgument, Some("min_clearance_m")));
}

#[test]
fn places_are_too_near_where_their_clearance_is_less_than_was_asked_and_nowhere_else() {
    let prepared = table().prepared();
    for wanted_m in [0.01, 0.03, 0.052] {
        let request = PlaceRequest { min_clearance_m: Some(wanted_m), ..request(&prepared, 2, &["right_of:1"]) };
        let settings = PlanSettings::of(&request);
        posed(&prepared, &request, &settings, |problem| {
            let query = problem.query;
            let (constraints, clearance) = (Constraints::new(problem), Clearance::new(&prepared, query, &settings.fixed, Vec::new()));
            // Beside the anchor, and off its corner.
            let beside = |away_m: f32| [[0.1 + away_m, 0.0], [0.095 + away_m, -0.09 - away_m]];
            for [x, y] in (0..80).flat_map(|k| beside(0.001 * k as f32)) {
                let candidate = standing_at(query, x, y, settings.fixed.support.release_m);
                let (clear_m, rejection) = (clearance.of(&candidate).unwrap(), constraints.tried(candidate, 0).rejection);
                assert_eq!(rejection == Some(Rejection::Clearance), clear_m < wanted_m, "{clear_m} m, {wanted_m} asked: {rejection:?}");
            }
        });
    }
}

#[test]
fn a_larger_clearance_is_never_easier_to_keep() {
    // Both are seen from the front only: what is behind that front counts for every clearance alike.
    let prepared = SceneBuilder::table().object(1, [0.0, 0.05], [0.12, 0.16, 0.1]).object(2, [-0.25, -0.2], [0.06, 0.06, 0.2]).prepared();
    for goal in [&["near:1"][..], &["touching:1"]] {
        let kept = |min_clearance_m: f64| -> Vec<bool> {
            let request = PlaceRequest { min_clearance_m: Some(min_clearance_m), ..request(&prepared, 2, goal) };
            let settings = PlanSettings::of(&request);
            posed(&prepared, &request, &settings, |problem| {
                let constraints = Constraints::new(problem);
                let place = |i: i32| standing_at(problem.query, -0.38 + 0.04 * (i % 20) as f32, -0.38 + 0.04 * (i / 20) as f32, 0.004);
                let in_way = |r: Option<Rejection>| matches!(r, Some(Rejection::Clearance | Rejection::Collision));
                (0..400).map(|i| !in_way(constraints.tried(place(i), 0).rejection)).collect()
            })
        };
        let clearances = [0.0, 0.01, 0.05, 0.1, 0.115, 0.125, 0.14, 0.2, 0.3];
        let all: Vec<Vec<bool>> = clearances.iter().map(|c| kept(*c)).collect();
        for (k, pair) in all.windows(2).enumerate() {
            let easier = pair[0].iter().zip(&pair[1]).filter(|(less, more)| **more && !**less).count();
            assert_eq!(easier, 0, "{goal:?}: places that keep {} m but not {} m", clearances[k + 1], clearances[k]);
        }
        let counts: Vec<usize> = all.iter().map(|kept| kept.iter().filter(|k| **k).count()).collect();
        if goal[0] == "near:1" {
            assert!(counts[0] > counts[3] && counts[3] > counts[5] && counts[5] > counts[8], "{counts:?}");
        } else {
            assert!(counts[8] == counts[1], "what is to be touched is in nobody's way: {counts:?}");
        }
    }
}

#[test]
fn the_only_term_that_must_hold_is_not_the_one_to_give_up() {
    let prepared = table().prepared();
    let result = run(&prepared, &request(&prepared, 2, &["left_of:1", "not:left_of:1"]));
    assert_eq!(result.outcome, Outcome::None);
    assert_eq!(result.relaxation.map(|r| r.term.holds), Some(false));
    let mut blocked = request(&prepared, 2, &["right_of:1"]);
    blocked.region = vec![RegionBox { min_m: [-2.0, -2.0, -2.0], max_m: [-0.06, 2.0, 2.0], inside: true }];
    let result = run(&prepared, &blocked);
    assert!(result.rejections[&Rejection::Goal] > 10 && result.relaxation.is_none(), "{result:?}");
}

#[test]
fn a_scene_in_millimetres_is_refused_before_a_map_is_made_of_it() {
    let mut scene = table().scene();
    scene.points.iter_mut().flatten().for_each(|v| *v *= 1000.0);
    let prepared = PreparedScene::new(std::sync::Arc::new(scene));
    let error = plan(&prepared, &request(&prepared, 2, &["left_of:1"]), &NoModels, &mut |_| ControlFlow::Continue(())).unwrap_err();
    assert_eq!((error.code, error.field.as_deref()), (ErrorCode::InvalidArgument, Some("points")), "{error}");
}

#[test]
fn a_seed_gives_the_same_bytes_and_another_seed_another_placement() {
    let prepared = table().prepared();
    let bytes = |seed: u64| {
        let request = PlaceRequest { seed, rotation: Rotation::Yaw, count: 3, ..request(&prepared, 2, &["right_of:1"]) };
        serde_json::to_vec(&run(&prepared, &request)).unwrap()
    };
    assert_eq!(bytes(5), bytes(5));
    assert_ne!(bytes(5), bytes(6));
}

#[test]
fn a_stop_after_an_iteration_is_partial_and_before_it_an_error() {
    let prepared = table().prepared();
    let wanted = request(&prepared, 2, &["right_of:1"]);
    let mut iterations = 0;
    let result = plan(&prepared, &wanted, &NoModels, &mut |step| match step {
        SearchStep::Batch => ControlFlow::Continue(()),
        SearchStep::Iteration(progress) => {
            iterations += 1;
            assert_eq!(progress.iterations, iterations);
            assert!(progress.best.is_some());
            if iterations == 2 { ControlFlow::Break(StopReason::Deadline) } else { ControlFlow::Continue(()) }
        }
    })
    .unwrap();
    assert_eq!((result.outcome, result.iterations), (Outcome::Partial, 2));
    assert!(!result.placements.is_empty());
    for (stop, code) in [(StopReason::Deadline, ErrorCode::DeadlineExceeded), (StopReason::Cancelled, ErrorCode::Cancelled)] {
        let error = plan(&prepared, &wanted, &NoModels, &mut |_| ControlFlow::Break(stop)).unwrap_err();
        assert_eq!(error.code, code);
    }
}

#[test]
fn what_carries_another_is_not_moved_and_the_other_is_named() {
    let prepared = table().object_at(3, [-0.25, -0.2], 0.08, [0.04, 0.04, 0.05]).prepared();
    let error = plan(&prepared, &request(&prepared, 2, &["right_of:1"]), &NoModels, &mut |_| ControlFlow::Continue(())).unwrap_err();
    assert_eq!((error.code, error.field.as_deref()), (ErrorCode::FailedPrecondition, Some("query")));
    assert!(error.message.contains("carries 3"), "{error}");
    // What stands on it can be moved, and it can be an anchor.
    let result = run(&prepared, &request(&prepared, 3, &["right_of:1"]));
    assert_eq!(result.outcome, Outcome::Found, "{:?}", result.rejections);
    let result = run(&prepared, &request(&prepared, 1, &["right_of:2"]));
    assert_eq!(result.outcome, Outcome::Found, "{:?}", result.rejections);
}

#[test]
fn where_nobody_looked_nothing_is_put() {
    // All space to the right of the anchor, beyond the table's edge too, is said to be unseen.
    let mut scene = table().scene();
    let (columns, rows) = (60, 40);
    let hidden = (0..columns * rows).map(|k| if k % columns >= 25 { u32::MAX } else { 0 }).collect();
    let unseen = repose_proto::UnseenSpace { origin_m: [-0.5, -0.4, 0.0], cell_m: 0.02, columns, rows, hidden };
    let seen = PreparedScene::new(std::sync::Arc::new(scene.clone()));
    scene.meta.unseen.space = Some(unseen);
    let dark = PreparedScene::new(std::sync::Arc::new(scene));
    assert_eq!(run(&seen, &request(&seen, 2, &["right_of:1"])).outcome, Outcome::Found);
    let result = run(&dark, &request(&dark, 2, &["right_of:1"]));
    assert_eq!((result.outcome, most_frequent(&result)), (Outcome::None, Rejection::OutOfView), "{:?}", result.rejections);
    assert_eq!(run(&dark, &request(&dark, 2, &["left_of:1"])).outcome, Outcome::Found);
}

#[test]
fn what_the_scene_lacks_is_named() {
    let prepared = table().prepared();
    let error = |request: &PlaceRequest| plan(&prepared, request, &NoModels, &mut |_| ControlFlow::Continue(())).unwrap_err();
    let unknown_query = error(&request(&prepared, 9, &["left_of:1"]));
    assert_eq!((unknown_query.code, unknown_query.field.as_deref()), (ErrorCode::NotFound, Some("query")));
    let unknown_anchor = error(&request(&prepared, 2, &["left_of:1", "not:near:9"]));
    assert_eq!((unknown_anchor.code, unknown_anchor.field.as_deref()), (ErrorCode::NotFound, Some("goal[1].anchor")));
    let no_models = error(&PlaceRequest { variant: Variant::Full, ..request(&prepared, 2, &["left_of:1"]) });
    assert_eq!(no_models.code, ErrorCode::FailedPrecondition);
    let tiny = table().object(4, [0.3, 0.3], [0.006, 0.006, 0.006]).prepared();
    let too_few = plan(&tiny, &request(&tiny, 4, &["left_of:1"]), &NoModels, &mut |_| ControlFlow::Continue(())).unwrap_err();
    assert_eq!((too_few.code, too_few.field.as_deref()), (ErrorCode::FailedPrecondition, Some("query")));
    assert!(too_few.message.contains("object 4"), "{too_few}");
    let mut adrift = table().scene();
    adrift.meta.camera.world_from_camera = None;
    let adrift = PreparedScene::new(std::sync::Arc::new(adrift));
    let no_pose = plan(&adrift, &request(&adrift, 2, &["left_of:1"]), &NoModels, &mut |_| ControlFlow::Continue(())).unwrap_err();
    assert_eq!((no_pose.code, no_pose.field.as_deref()), (ErrorCode::InvalidArgument, Some("scene.camera.world_from_camera")));
}
