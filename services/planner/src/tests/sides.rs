//! Objects that are set on another side than the one on which they were seen.

use std::ops::ControlFlow;

use nalgebra::{Translation3, Vector2};
use repose_belief::settings::SideSettings;
use repose_geometry::transform;
use repose_proto::place::{Outcome, PlaceRequest, Placement, RegionBox, Rejection, Rotation, ShortfallReason, Variant};

use crate::judge::constraints::Constraints;
use crate::judge::problem::PlacementProblem;
use crate::learned::models::NoModels;
use crate::learned::{standing, success};
use crate::plan::{PlanReport, SearchStep, plan, plan_turned_with_report, plan_with_report};
use crate::scene::moved::table_after;
use crate::scene::turned::{turned_over, turns};
use crate::settings::PlanSettings;
use crate::tests::fake::{self, BESIDE, Fake, always, scene, stepped};
use crate::tests::plan::{request, run};
use crate::tests::synthetic::{Prepared, SceneBuilder, posed, standing_at};

#[test]
fn an_object_that_may_be_set_on_another_side_stands_on_the_table_by_one_of_its_faces() {
    let (middle, size) = ([-0.25, -0.2, 0.03], [0.12, 0.08, 0.06]);
    let prepared = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [-0.25, -0.2], size).prepared();
    // So far apart that there is no room for all of them on one side of the object.
    let request =
        PlaceRequest { rotation: Rotation::Stable, count: 12, min_separation_m: Some(0.15), ..request(&prepared, 2, &["right_of:1"]) };
    let result = run(&prepared, &request);
    assert_eq!((result.outcome, result.rotation), (Outcome::Found, Rotation::Stable), "{:?}", result.rejections);
    let is_turned_over = |placement: &Placement| placement.placed_from_observed.0[10] < 0.9;
    let (as_it_lies, others) = result.placements.split_at(result.placements.iter().take_while(|p| !is_turned_over(p)).count());
    assert!(!as_it_lies.is_empty() && others.iter().all(is_turned_over), "as it lies comes first");
    assert!([as_it_lies, others].iter().all(|answers| answers.windows(2).all(|pair| pair[0].cost <= pair[1].cost)));
    let centroid = prepared.belief.objects[&2].centroid;
    let place = |placement: &Placement| transform::from_row_major(&placement.placed_from_observed.0).unwrap() * centroid;
    let places: Vec<_> = result.placements.iter().map(place).collect();
    for (i, at) in places.iter().enumerate() {
        assert!(places[..i].iter().all(|other| (at - other).norm() >= 0.15), "whatever sides it is set on: {places:?}");
    }
    let one = run(&prepared, &PlaceRequest { count: 1, ..request.clone() });
    assert!(
        !is_turned_over(&one.placements[0]) && one.evaluated < result.evaluated,
        "no other side is tried where it can be left as it lies"
    );
    assert_eq!(serde_json::to_vec(&result).unwrap(), serde_json::to_vec(&run(&prepared, &request)).unwrap());
    let mut upright = [0; 3];
    for placement in &result.placements {
        let placed_from_observed = transform::from_row_major(&placement.placed_from_observed.0).unwrap();
        let axes = placed_from_observed.rotation.to_rotation_matrix();
        // Which edge of the box is upright now, and is it level?
        let up: [f64; 3] = std::array::from_fn(|k| axes[(2, k)].abs());
        let k = (0..3).max_by(|a, b| up[*a].total_cmp(&up[*b])).unwrap();
        assert!(up[k] > 0.995, "{up:?}");
        upright[k] += 1;
        let at = placed_from_observed * nalgebra::Point3::from(middle);
        // Most of another side was not seen: it is let go higher by what it may reach lower.
        let rise_m = if is_turned_over(placement) { f64::from(SideSettings::default().lower_m) } else { 0.0 };
        assert!((at.z - rise_m - size[k] / 2.0).abs() < 0.013 && at.x > 0.05, "{at}, edge {k} upright");
        let after = table_after(&prepared, 2, &placed_from_observed, Variant::Geometric);
        let bottom_m = after.belief.objects[&2].shape.as_ref().unwrap().bottom_m;
        assert!(bottom_m.abs() < 0.01, "it comes to rest {bottom_m} m over the table");
        assert!(placement.geometric[0].holds);
    }
    assert!(upright.iter().filter(|count| **count > 0).count() >= 2, "{upright:?}");
}

#[test]
fn what_was_set_on_another_side_is_as_solid_as_it_was() {
    let table = SceneBuilder::table().object(1, [0.0, 0.0], [0.12, 0.1, 0.08]).object(2, [-0.3, 0.2], [0.05; 3]).prepared();
    for turn in turns(&table, 1).unwrap() {
        let bottom_m = turned_over(&table, 1, turn).unwrap().prepared.belief.objects[&1].shape.as_ref().unwrap().bottom_m;
        let motion = Translation3::new(0.25, -0.1, -f64::from(bottom_m)) * turn;
        let after = table_after(&table, 1, &motion, Variant::Full);
        let object = &after.belief.objects[&1];
        let shape = object.shape.as_ref().unwrap();
        assert!((object.centroid - shape.centroid).norm() < 1e-6 && shape.bottom_m.abs() < 1e-3, "{} {shape:?}", object.centroid);
        let inside_m = shape.bottom_m + 0.45 * (shape.top_m - shape.bottom_m);
        let is_filled = |offset: &Vector2<f32>| {
            let runs = after.belief.columns.at(&(shape.axis + offset));
            runs.iter().any(|run| run.object == 1 && run.low_m < inside_m && run.high_m > inside_m)
        };
        // A few cells of a face may show no point of it.
        let offsets: Vec<Vector2<f32>> = (0..49).map(|k| Vector2::new((k % 7 - 3) as f32, (k / 7 - 3) as f32) * 0.008).collect();
        let filled = offsets.iter().filter(|offset| is_filled(offset)).count();
        assert!(filled > 30, "{filled} of 49 cells, turned by {} degrees", turn.rotation.angle().to_degrees());
    }
}

#[test]
fn answers_on_other_sides_that_are_too_close_are_told() {
    let prepared = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [-0.25, -0.2], [0.12, 0.08, 0.06]).prepared();
    // There is room for one answer, whatever side it is on.
    let wanted =
        PlaceRequest { rotation: Rotation::Stable, count: 3, min_separation_m: Some(5.0), ..request(&prepared, 2, &["right_of:1"]) };
    let as_it_lies = run(&prepared, &PlaceRequest { rotation: Rotation::Yaw, ..wanted.clone() });
    let result = run(&prepared, &wanted);
    assert_eq!((&result.placements, result.outcome), (&as_it_lies.placements, Outcome::Found));
    let (of_one, of_all) = (as_it_lies.shortfall.unwrap(), result.shortfall.unwrap());
    assert_eq!((of_all.reason, of_all.too_close), (ShortfallReason::Separation, of_all.passed - 1));
    assert!(of_all.passed > of_one.passed + 100, "{of_all:?} after {of_one:?}");
}

#[test]
fn what_is_told_as_the_best_so_far_is_not_forgotten_on_another_side() {
    let prepared = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [-0.25, -0.2], [0.12, 0.08, 0.06]).prepared();
    let wanted =
        PlaceRequest { rotation: Rotation::Stable, count: 3, min_separation_m: Some(5.0), ..request(&prepared, 2, &["right_of:1"]) };
    let as_it_lies = run(&prepared, &PlaceRequest { rotation: Rotation::Yaw, ..wanted.clone() });
    let mut told = Vec::new();
    let result = plan(&prepared, &wanted, &NoModels, &mut |step| {
        if let SearchStep::Iteration(progress) = step {
            told.push(*progress);
        }
        ControlFlow::Continue(())
    });
    let result = result.unwrap();
    let on_other_sides: Vec<_> = told.iter().filter(|progress| progress.iterations > as_it_lies.iterations).collect();
    assert!(!on_other_sides.is_empty());
    assert!(on_other_sides.iter().all(|progress| progress.best.as_ref() == Some(&result.placements[0])));
}

#[test]
fn a_region_is_asked_about_the_centroid_of_what_was_seen_where_an_answer_lets_go_of_it() {
    let prepared = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [-0.25, -0.2], [0.12, 0.08, 0.06]).prepared();
    let settings = PlanSettings::of(&request(&prepared, 2, &["right_of:1"]));
    for turn in turns(&prepared, 2).unwrap() {
        let table = turned_over(&prepared, 2, turn).unwrap();
        let query = table.prepared.query(2, 0.0, &settings.fixed).unwrap();
        let candidate = standing_at(&query, 0.25, 0.1, settings.fixed.support.release_m);
        let rise = Translation3::new(0.0, 0.0, f64::from(SideSettings::default().lower_m));
        let placed_from_observed = rise * candidate.placed_from_observed(&query.shape.centroid) * turn;
        let placed = placed_from_observed * prepared.belief.objects[&2].centroid;
        let rejection = |[x, y, z]: [f64; 3]| {
            let around = RegionBox { min_m: [x, y, z].map(|v| v - 0.001), max_m: [x, y, z].map(|v| v + 0.001), inside: true };
            let wanted = PlaceRequest { region: vec![around], ..request(&table.prepared, 2, &["right_of:1"]) };
            posed(&table.prepared, &wanted, &settings, |as_it_lies| {
                let problem = PlacementProblem { turned: Some(&table.turned), ..as_it_lies };
                Constraints::new(problem).tried(candidate, 0).rejection
            })
        };
        assert_ne!(rejection(placed.into()), Some(Rejection::Region));
        assert_eq!(rejection(candidate.centroid().into()), Some(Rejection::Region), "the middle of its whole surface, where it is judged");
    }
}

#[test]
fn why_there_is_no_answer_is_told_of_all_sides() {
    let prepared = scene();
    let mut wanted = fake::request(&prepared, Variant::Best, &["left_of:1", "right_of:1"]);
    (wanted.rotation, wanted.thresholds.realism) = (Rotation::Stable, Some(0.0));
    // As it lies it tips.
    let stands = Some(stepped(&standing::names(), "turned", 0.5, [0.1, 0.9]));
    let result = fake::run(&prepared, &wanted, &Fake { stands, ..Fake::new(&[BESIDE]) });
    assert_eq!(result.outcome, Outcome::None);
    assert!([Rejection::Tips, Rejection::Goal].iter().all(|reason| result.rejections.contains_key(reason)), "{:?}", result.rejections);
    assert!(result.rejected_at_m.keys().eq(result.rejections.keys()), "{:?}", result.rejected_at_m.keys());
    assert!(result.relaxation.is_some_and(|relaxation| result.goal.contains(&relaxation.term)));
}

#[test]
fn of_an_object_on_another_side_success_is_told_by_how_it_lay_too() {
    let prepared = scene();
    let mut wanted = fake::request(&prepared, Variant::Best, &["right_of:1"]);
    wanted.thresholds.realism = Some(0.0);
    let mut fake = Fake::new(&[BESIDE]);
    fake.success = Some(always(0.9, &success::names()));
    fake.stands = Some(stepped(&standing::names(), "turned", 0.5, [0.9, 0.6]));
    let go_on = &mut |_| ControlFlow::Continue(());
    let measures = |report: PlanReport| {
        let of = report.answers[0].success_measures.clone().unwrap();
        move |name: &str| of[success::names().iter().position(|n| *n == name).unwrap()]
    };
    let as_it_lies = measures(plan_with_report(&prepared, &wanted, &fake, go_on).unwrap());
    assert_eq!([as_it_lies("turned"), as_it_lies("seen_base")], [0.0, 0.0]);
    let is = |value: f32, expected: f32| assert!((value - expected).abs() < 1e-6, "{value}, not {expected}");
    is(as_it_lies("stands"), 0.9);
    assert_eq!(as_it_lies("stood"), as_it_lies("stands"));
    let turns = turns(&prepared, 2).unwrap();
    let seen_shares = turns.iter().map(|turn| turned_over(&prepared, 2, *turn).unwrap().turned.seen_base_share);
    assert!(seen_shares.fold(1.0, f64::min) < 0.1, "its back was not seen");
    // Upside down, on the top that was seen; what is completed repeats it.
    let over = turns.into_iter().max_by(|a, b| a.rotation.angle().total_cmp(&b.rotation.angle())).unwrap();
    let table = turned_over(&prepared, 2, over).unwrap();
    let turned = measures(plan_turned_with_report(&table, &wanted, &fake, go_on).unwrap());
    assert!(
        (turned("turned") - std::f32::consts::PI).abs() < 0.05 && turned("seen_base") > 0.4,
        "{} {}",
        turned("turned"),
        turned("seen_base")
    );
    is(turned("stands"), 0.6);
    for seen in ["stood", "neighbour_stays", "seen_gap", "cut_off", "hidden"] {
        assert_eq!(turned(seen), as_it_lies(seen), "{seen}");
    }
}
