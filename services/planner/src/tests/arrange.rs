//! Arrangements on tables of boxes, by geometry alone but where `best` asks for more: what moves, in which order, and where things stand at the end.

use std::ops::ControlFlow;

use repose_geometry::ViewerFrame;
use repose_geometry::transform::from_row_major;
use repose_proto::Scene;
use repose_proto::arrange::{ArrangeMove, ArrangeRequest, ArrangeResult, ObjectGoal, Proof, Purpose};
use repose_proto::place::{Outcome, Variant};

use super::synthetic::SceneBuilder;
use crate::arrange::arrange;
use crate::arrange::goals::all_hold;
use crate::learned::models::NoModels;
use crate::learned::{neighbours, standing};
use crate::scene::moved::table_after;
use crate::scene::prepared::PreparedScene;
use crate::tests::fake::{BESIDE, Fake, always};

fn goals(texts: &[(u16, &[&str])]) -> Vec<ObjectGoal> {
    texts.iter().map(|(object, terms)| ObjectGoal { object: *object, terms: terms.iter().map(|t| t.parse().unwrap()).collect() }).collect()
}

fn arranged(scene: &Scene, texts: &[(u16, &[&str])]) -> ArrangeResult {
    arranged_with(scene, texts, 1)
}

fn arranged_with(scene: &Scene, texts: &[(u16, &[&str])], max_parkings: u32) -> ArrangeResult {
    let prepared = std::sync::Arc::new(PreparedScene::new(std::sync::Arc::new(scene.clone())));
    let request =
        ArrangeRequest { variant: Variant::Geometric, max_parkings, ..ArrangeRequest::new(prepared.scene_id.clone(), goals(texts)) };
    arrange(&prepared, &request, &NoModels, &mut |_| ControlFlow::Continue(())).unwrap()
}

/// Whether all goals hold on the scene that the moves lead to.
fn hold_at_the_end(scene: &Scene, result: &ArrangeResult) -> bool {
    hold_after(&result.moves, scene, result, Variant::Geometric)
}

/// Whether all goals of a result hold after some moves, as a variant has them.
fn hold_after(moves: &[ArrangeMove], scene: &Scene, result: &ArrangeResult, variant: Variant) -> bool {
    let carried = |table: PreparedScene, m: &ArrangeMove| {
        let motion = from_row_major(&m.placement.placed_from_observed.0).unwrap();
        table_after(&table, m.object, &motion, variant)
    };
    let end = moves.iter().fold(PreparedScene::new(std::sync::Arc::new(scene.clone())), carried);
    let viewer = ViewerFrame::from_yaw(result.view_yaw_rad);
    result.goals.iter().all(|goal| all_hold(&end, &viewer, variant, goal.object, &goal.terms))
}

const SMALL: [f64; 3] = [0.06, 0.06, 0.08];

#[test]
fn what_holds_already_stays_where_it_is() {
    let scene = SceneBuilder::table().object(1, [0.0, 0.0], SMALL).object(2, [0.25, 0.0], SMALL).object(3, [-0.3, -0.2], SMALL).scene();
    let result = arranged(&scene, &[(2, &["right_of:1"]), (3, &["behind:1"])]);
    assert_eq!((result.outcome, result.satisfied.as_slice()), (Outcome::Found, [2].as_slice()));
    assert_eq!(result.moves.iter().map(|m| m.object).collect::<Vec<_>>(), [3]);
    assert!(hold_at_the_end(&scene, &result));
}

#[test]
fn what_others_are_placed_by_moves_first() {
    let scene = SceneBuilder::table().object(1, [0.3, 0.0], SMALL).object(2, [-0.1, -0.1], SMALL).object(3, [-0.3, 0.1], SMALL).scene();
    // 2 goes left of where 3 will be, not of where it is.
    let result = arranged(&scene, &[(2, &["left_of:3", "near:3"]), (3, &["left_of:1", "near:1"])]);
    assert_eq!(result.outcome, Outcome::Found, "{result:?}");
    assert_eq!(result.moves.iter().map(|m| m.object).collect::<Vec<_>>(), [3, 2]);
    assert!(hold_at_the_end(&scene, &result));
}

#[test]
fn what_stands_on_an_object_is_set_down_first() {
    let scene = SceneBuilder::table()
        .object(1, [0.2, 0.0], SMALL)
        .object(2, [-0.2, 0.0], [0.12, 0.12, 0.06])
        .object_at(3, [-0.2, 0.0], 0.06, [0.05, 0.05, 0.05])
        .scene();
    let result = arranged(&scene, &[(2, &["right_of:1"])]);
    assert_eq!(result.outcome, Outcome::Found, "{result:?}");
    let moves: Vec<_> = result.moves.iter().map(|m| (m.object, m.purpose)).collect();
    assert_eq!(moves, [(3, Purpose::Aside), (2, Purpose::Goal)]);
    assert!(hold_at_the_end(&scene, &result));
}

#[test]
fn what_is_set_aside_is_not_placed_by_an_object_of_which_too_little_was_seen() {
    // A crumb is the nearest thing to 3 that stays where it is.
    let scene = SceneBuilder::table()
        .object(1, [0.2, 0.0], SMALL)
        .object(2, [-0.2, 0.0], [0.12, 0.12, 0.06])
        .object_at(3, [-0.2, 0.0], 0.06, [0.05, 0.05, 0.05])
        .object(9, [-0.2, -0.15], [0.006; 3])
        .scene();
    let result = arranged(&scene, &[(2, &["right_of:1"])]);
    assert_eq!(result.outcome, Outcome::Found, "{result:?}");
    assert!(result.moves.iter().all(|m| m.goal.iter().all(|term| term.anchor != 9)), "{result:?}");
}

#[test]
fn a_stack_is_taken_down_from_its_top_for_what_stands_lowest() {
    let scene = SceneBuilder::table()
        .object(1, [0.1, 0.0], SMALL)
        .object(2, [-0.2, 0.0], [0.12, 0.12, 0.06])
        .object_at(3, [-0.2, 0.0], 0.06, [0.08, 0.08, 0.06])
        .object_at(4, [-0.2, 0.0], 0.12, [0.05, 0.05, 0.05])
        .scene();
    let result = arranged_with(&scene, &[(2, &["right_of:1"])], 2);
    assert_eq!(result.outcome, Outcome::Found, "{result:?}");
    let moves: Vec<_> = result.moves.iter().map(|m| (m.object, m.purpose)).collect();
    assert_eq!(moves, [(4, Purpose::Aside), (3, Purpose::Aside), (2, Purpose::Goal)], "{result:?}");
    assert!(hold_at_the_end(&scene, &result));
}

#[test]
fn nothing_is_set_down_on_a_stack_that_must_be_taken_down() {
    // 3 is to stand on 4, which stands on 5, which must go behind 1.
    let scene = SceneBuilder::table()
        .object(1, [0.1, -0.15], SMALL)
        .object(5, [-0.2, 0.0], [0.16, 0.16, 0.05])
        .object_at(4, [-0.2, 0.0], 0.05, [0.12, 0.12, 0.05])
        .object(3, [-0.2, -0.25], [0.05, 0.05, 0.05])
        .scene();
    let result = arranged_with(&scene, &[(3, &["above:4"]), (5, &["behind:1"])], 2);
    assert_eq!(result.outcome, Outcome::Found, "{result:?}");
    assert_eq!(result.moves.iter().filter(|m| m.object == 3).count(), 1, "{result:?}");
    assert!(hold_at_the_end(&scene, &result));
}

#[test]
fn what_comes_to_stand_right_as_another_moves_keeps_what_it_carries() {
    // 1 stands left of 2 once that has gone right of 4, and 3 stands on 1.
    let scene = SceneBuilder::table()
        .object(1, [-0.2, 0.0], [0.12, 0.12, 0.06])
        .object(2, [-0.38, -0.1], SMALL)
        .object_at(3, [-0.2, 0.0], 0.06, [0.05, 0.05, 0.05])
        .object(4, [0.2, 0.0], SMALL)
        .scene();
    for max_parkings in [0, 1] {
        let result = arranged_with(&scene, &[(1, &["left_of:2"]), (2, &["right_of:4"])], max_parkings);
        assert_eq!(result.outcome, Outcome::Found, "{result:?}");
        assert_eq!(result.moves.iter().map(|m| m.object).collect::<Vec<_>>(), [2], "3 need not be set aside: {result:?}");
        assert!(hold_at_the_end(&scene, &result));
    }
}

#[test]
fn what_is_in_the_way_is_set_aside_though_something_else_stands_on_what_may_stay() {
    // 1, which carries 3, stands left of 2 once that is on 4, where a post leaves no room for it.
    let scene = SceneBuilder::table()
        .object(1, [-0.2, 0.0], [0.12, 0.12, 0.06])
        .object(2, [-0.36, -0.2], [0.14, 0.14, 0.06])
        .object_at(3, [-0.2, 0.0], 0.06, [0.05, 0.05, 0.05])
        .object(4, [0.2, 0.0], [0.18, 0.18, 0.05])
        .object_at(5, [0.2, 0.0], 0.05, [0.05, 0.05, 0.2])
        .scene();
    let result = arranged_with(&scene, &[(1, &["left_of:2"]), (2, &["above:4"])], 1);
    let moves: Vec<_> = result.moves.iter().map(|m| (m.object, m.purpose)).collect();
    assert_eq!((result.outcome, moves.as_slice()), (Outcome::Found, [(5, Purpose::Aside), (2, Purpose::Goal)].as_slice()), "{result:?}");
    assert!(hold_at_the_end(&scene, &result));
}

#[test]
fn of_objects_that_wait_for_each_other_the_one_that_carries_something_stays() {
    let scene = SceneBuilder::table()
        .object(1, [-0.2, 0.0], [0.12, 0.12, 0.06])
        .object(2, [-0.38, -0.1], SMALL)
        .object_at(3, [-0.2, 0.0], 0.06, [0.05, 0.05, 0.05])
        .scene();
    let orders: [[(u16, &[&str]); 2]; 2] = [[(2, &["near:1"]), (1, &["left_of:2"])], [(1, &["left_of:2"]), (2, &["near:1"])]];
    for wanted in &orders {
        let result = arranged(&scene, wanted);
        assert_eq!(result.outcome, Outcome::Found, "{result:?}");
        assert_eq!(result.moves.iter().map(|m| m.object).collect::<Vec<_>>(), [2], "3 need not be set aside: {result:?}");
        assert!(hold_at_the_end(&scene, &result));
    }
}

#[test]
fn what_stands_right_by_an_object_that_must_go_far_away_follows_it() {
    // 3 is near 2, which must go near 1: no place is near both.
    let scene = SceneBuilder::table().object(1, [0.1, 0.0], SMALL).object(2, [-0.35, -0.1], SMALL).object(3, [-0.26, -0.1], SMALL).scene();
    for max_parkings in [0, 1] {
        let result = arranged_with(&scene, &[(2, &["right_of:1", "near:1"]), (3, &["near:2"])], max_parkings);
        let moves: Vec<_> = result.moves.iter().map(|m| (m.object, m.purpose)).collect();
        assert_eq!((result.outcome, moves.as_slice()), (Outcome::Found, [(2, Purpose::Goal), (3, Purpose::Goal)].as_slice()), "{result:?}");
        assert!(result.satisfied.is_empty() && hold_at_the_end(&scene, &result), "{result:?}");
    }
}

#[test]
fn what_stands_over_an_object_follows_it_where_that_goes_from_beneath_it() {
    // 2 is over 1, on a board of the furniture. To the right of 3 no place is beneath it, though by the rule all near ones are below it.
    let scene = SceneBuilder::table()
        .object(1, [-0.1, 0.1], [0.08, 0.08, 0.08])
        .object_at(0, [-0.1, 0.1], 0.2, [0.12, 0.12, 0.02])
        .object_at(2, [-0.1, 0.1], 0.22, [0.05, 0.05, 0.05])
        .object(3, [0.0, 0.1], [0.05; 3])
        .scene();
    let prepared = std::sync::Arc::new(PreparedScene::new(std::sync::Arc::new(scene.clone())));
    let fake = Fake {
        real_height_m: 0.09,
        stands: Some(always(0.9, &standing::names())),
        neighbour_stays: Some(always(0.9, &neighbours::names())),
        ..Fake::new(&[BESIDE])
    };
    let request = ArrangeRequest::new(prepared.scene_id.clone(), goals(&[(1, &["right_of:3"]), (2, &["above:1"])]));
    let result = arrange(&prepared, &request, &fake, &mut |_| ControlFlow::Continue(())).unwrap();
    let moves: Vec<_> = result.moves.iter().map(|m| (m.object, m.purpose)).collect();
    assert_eq!((result.outcome, moves.as_slice()), (Outcome::Found, [(1, Purpose::Goal), (2, Purpose::Goal)].as_slice()), "{result:?}");
    assert!(result.satisfied.is_empty() && hold_after(&result.moves, &scene, &result, Variant::Best), "{result:?}");
    assert!(!hold_after(&result.moves[..1], &scene, &result, Variant::Best), "2 is not over it any more");
}

#[test]
fn objects_that_stand_where_the_other_must_go_change_places() {
    // Beside the block there is room for one at each side, with a post at its end, and before the block for one more.
    let scene = SceneBuilder::table_within([-0.215, -0.4, 0.215, 0.13])
        .object(1, [0.0, 0.0], [0.2, 0.14, 0.05])
        .object(2, [-0.155, 0.0], [0.09, 0.24, 0.06])
        .object(3, [0.155, 0.0], [0.09, 0.24, 0.06])
        .object(4, [-0.16, -0.19], [0.03, 0.03, 0.15])
        .object(5, [0.16, -0.19], [0.03, 0.03, 0.15])
        .scene();
    let result = arranged(&scene, &[(2, &["right_of:1", "not:above:1"]), (3, &["left_of:1", "not:above:1"])]);
    assert_eq!(result.outcome, Outcome::Found, "{result:?}");
    assert!(result.moves.len() == 3 && result.moves[0].purpose == Purpose::Aside, "{result:?}");
    assert!(hold_at_the_end(&scene, &result));
}

#[test]
fn objects_on_tops_that_the_other_must_go_to_change_places_after_one_is_set_aside() {
    // Each is as wide as leaves no room for the other beside it.
    let scene = SceneBuilder::table()
        .object(1, [-0.2, 0.0], [0.14, 0.14, 0.05])
        .object(2, [0.2, 0.0], [0.14, 0.14, 0.05])
        .object_at(3, [-0.2, 0.0], 0.05, [0.1, 0.1, 0.06])
        .object_at(4, [0.2, 0.0], 0.05, [0.11, 0.11, 0.05])
        .scene();
    let result = arranged(&scene, &[(3, &["above:2"]), (4, &["above:1"])]);
    assert_eq!(result.outcome, Outcome::Found, "{result:?}");
    assert!(result.moves.len() == 3 && result.moves[0].purpose == Purpose::Aside && result.needs_view.is_empty(), "{result:?}");
    assert!(result.searches <= 12, "what covers a top is set aside before other orders are tried: {}", result.searches);
    assert!(hold_at_the_end(&scene, &result));
}

#[test]
fn where_even_the_bare_top_has_no_place_what_covers_it_is_set_aside_and_a_view_is_asked_for() {
    // Between two posts there is no room for something as wide as 3, whatever stands on 2.
    let table = SceneBuilder::table()
        .object(2, [0.2, 0.0], [0.12, 0.12, 0.05])
        .object(3, [-0.2, 0.0], [0.25, 0.08, 0.06])
        .object(5, [0.095, 0.0], [0.03, 0.16, 0.3])
        .object(6, [0.305, 0.0], [0.03, 0.16, 0.3]);
    let covered = table.clone().object_at(4, [0.2, 0.0], 0.05, [0.07, 0.07, 0.1]).scene();
    let wanted: &[(u16, &[&str])] = &[(3, &["above:2", "not:above:4", "not:above:5", "not:above:6"])];
    let result = arranged(&covered, wanted);
    let moves: Vec<_> = result.moves.iter().map(|m| (m.object, m.purpose)).collect();
    assert_eq!((result.outcome, moves.as_slice()), (Outcome::Partial, [(4, Purpose::Aside)].as_slice()), "{result:?}");
    assert_eq!((result.open.as_slice(), result.needs_view.as_slice()), ([3].as_slice(), [2].as_slice()), "{result:?}");
    assert!(result.searches <= 12 && result.conflict.is_none(), "{result:?}");
    assert_eq!(arranged(&covered, wanted), result, "the same bytes");
    // Where nothing may be set aside there is nothing to wait for; and the view that shows the top says that there is no place.
    let uncovered = table.object(4, [0.0, -0.25], [0.07, 0.07, 0.1]).scene();
    for end in [arranged_with(&covered, wanted, 0), arranged(&uncovered, wanted)] {
        assert!(end.outcome == Outcome::None && end.needs_view.is_empty() && end.conflict.is_some(), "{end:?}");
    }
}

#[test]
fn a_contradiction_is_proven_and_nothing_is_searched() {
    let scene = SceneBuilder::table().object(1, [0.0, 0.0], SMALL).object(2, [0.25, 0.0], SMALL).object(3, [-0.3, -0.2], SMALL).scene();
    let result = arranged(&scene, &[(1, &["left_of:2"]), (2, &["left_of:3"]), (3, &["left_of:1", "near:1"])]);
    let conflict = result.conflict.expect("a conflict");
    assert_eq!((result.outcome, conflict.proof, conflict.goals.len(), result.searches), (Outcome::None, Proof::Contradiction, 3, 0));
    assert_eq!(conflict.goals[2].terms.len(), 1, "{conflict:?}");
}

#[test]
fn the_smallest_part_without_a_place_is_named() {
    // Nothing of this size stands on the small box.
    let scene = SceneBuilder::table()
        .object(1, [0.0, 0.1], [0.03, 0.03, 0.05])
        .object(2, [0.3, 0.0], [0.15, 0.15, 0.2])
        .object(3, [-0.3, -0.2], SMALL)
        .scene();
    let result = arranged_with(&scene, &[(3, &["right_of:1"]), (2, &["above:1", "centered:1"])], 0);
    let conflict = result.conflict.clone().unwrap_or_else(|| panic!("{result:?}"));
    assert_eq!((result.outcome, conflict.proof, conflict.smallest), (Outcome::None, Proof::NotFound, true), "{result:?}");
    assert_eq!(conflict.goals.iter().map(|g| g.object).collect::<Vec<_>>(), [2]);
}

#[test]
fn orders_of_moves_that_have_nothing_to_do_with_each_other_are_not_all_gone_through() {
    // Seven that find their place wherever the others are, and one that finds none: thousands of orders, and as many tables to prepare.
    let mut scene = SceneBuilder::table().object(1, [0.0, 0.1], [0.03, 0.03, 0.05]).object(2, [0.3, 0.0], [0.15, 0.15, 0.2]);
    let mut wanted: Vec<(u16, &[&str])> = vec![(2, &["above:1", "centered:1"])];
    for id in 3..10 {
        scene = scene.object(id, [-0.4 + 0.08 * f64::from(id), -0.3], [0.03; 3]);
        wanted.push((id, &["behind:1"]));
    }
    let result = arranged_with(&scene.scene(), &wanted, 1);
    assert!(result.outcome != Outcome::Found && result.open.contains(&2), "{result:?}");
}

#[test]
fn the_same_request_gives_the_same_answer_and_a_small_budget_a_part_of_it() {
    let scene = SceneBuilder::table().object(1, [0.3, 0.0], SMALL).object(2, [-0.1, -0.1], SMALL).object(3, [-0.3, 0.1], SMALL).scene();
    let wanted: &[(u16, &[&str])] = &[(2, &["left_of:3", "near:3"]), (3, &["left_of:1", "near:1"])];
    assert_eq!(arranged(&scene, wanted), arranged(&scene, wanted));
    let prepared = std::sync::Arc::new(PreparedScene::new(std::sync::Arc::new(scene)));
    let request =
        ArrangeRequest { variant: Variant::Geometric, max_searches: 1, ..ArrangeRequest::new(prepared.scene_id.clone(), goals(wanted)) };
    let partial = arrange(&prepared, &request, &NoModels, &mut |_| ControlFlow::Continue(())).unwrap();
    assert_eq!((partial.outcome, partial.open.as_slice(), partial.moves.len()), (Outcome::Partial, [2].as_slice(), 1));
}
