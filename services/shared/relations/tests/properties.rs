//! What must be true of the rules whatever the objects: exchange, the viewer's turn, rigid motion, scale, and how margins change.
//!
//! What turning the viewer by 180° does: rules 5 and 6 of `left(i, j)` become rules 6 and 5 of `right(i, j)`, so the two agree on
//! everything but the trapezoid, which is j's on one side and i's on the other. So left becomes right *exactly* when the two boxes are
//! as much wider than long as each other (equal boxes, cubes, any two things as deep as they are wide and high), and whenever each
//! centre lies level with the other box; in between, a thing that is left from here may be on neither side from there
//! (`testdata/cases.toml` has one), but never left again.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use repose_geometry::{OrientedBox, ViewerFrame};
use repose_relations::margins::index::*;
use repose_relations::{
    Margins, ObservedObject, RELATIONS, TrueBounds, ViewerExtents, ground_truth, ground_truth_margins, observed_margins,
};

const OPPOSITES: [(usize, usize); 3] = [(LEFT_OF, RIGHT_OF), (IN_FRONT_OF, BEHIND), (ABOVE, BELOW)];
const SYMMETRIC: [usize; 4] = [NEAR, TOUCHING, CENTERED, ALIGNED];
const LEVEL: [usize; 4] = [LEFT_OF, RIGHT_OF, IN_FRONT_OF, BEHIND];

fn any_object() -> impl Strategy<Value = TrueBounds> {
    (prop::array::uniform3(-0.4..0.4f64), prop::array::uniform3(0.01..0.15f64), prop::array::uniform3(-3.1..3.1f64)).prop_map(
        |(center, half, euler)| {
            let rotation = UnitQuaternion::from_euler_angles(euler[0], euler[1], euler[2]);
            let world_from_box = Isometry3::from_parts(Translation3::from(Vector3::from(center)), rotation);
            TrueBounds { bounds: OrientedBox { world_from_box, half_extents: Vector3::from(half) } }
        },
    )
}

fn moved(object: &TrueBounds, to_from: &Isometry3<f64>) -> TrueBounds {
    TrueBounds { bounds: object.bounds.transformed(to_from) }
}

/// Points of a blob: a few dozen, anywhere in a box of 10 cm about `center`.
fn any_cloud() -> impl Strategy<Value = Vec<Point3<f32>>> {
    let point = prop::array::uniform3(-0.05..0.05f32);
    (prop::array::uniform3(-0.15..0.15f32), prop::collection::vec(point, 8..60))
        .prop_map(|(center, raw)| raw.into_iter().map(|p| Point3::from(p) + Vector3::from(center)).collect())
}

fn seen(cloud: &[Point3<f32>], viewer: &ViewerFrame) -> ObservedObject {
    ObservedObject::new(cloud, viewer).expect("points")
}

fn clouds_margins(a: &[Point3<f32>], b: &[Point3<f32>], viewer: &ViewerFrame) -> Margins {
    observed_margins(&seen(a, viewer), &seen(b, viewer))
}

fn close(a: &Margins, b: &Margins, tolerance: f64) -> Result<(), TestCaseError> {
    for i in 0..RELATIONS {
        prop_assert!((a.0[i] - b.0[i]).abs() <= tolerance, "margin {i}: {} and {}", a.0[i], b.0[i]);
    }
    Ok(())
}

proptest! {
    #[test]
    fn exchanging_the_objects_mirrors_the_directions(
        a in any_object(), b in any_object(), clouds in (any_cloud(), any_cloud()), yaw in -3.1..3.1f64, gap in 0.0..0.2f64,
    ) {
        let viewer = ViewerFrame::from_yaw(yaw);
        let truth = [ground_truth_margins(&a, &b, gap, &viewer), ground_truth_margins(&b, &a, gap, &viewer)];
        let observed = [clouds_margins(&clouds.0, &clouds.1, &viewer), clouds_margins(&clouds.1, &clouds.0, &viewer)];
        for [ab, ba] in [truth, observed] {
            for (one, other) in OPPOSITES {
                prop_assert_eq!(ab.0[one], ba.0[other]);
                prop_assert_eq!(ab.0[other], ba.0[one]);
            }
            for i in SYMMETRIC {
                prop_assert!((ab.0[i] - ba.0[i]).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn a_query_is_on_one_side_at_most_and_never_in_two_trapezoids_of_the_anchor(
        a in any_object(), b in any_object(), yaw in -3.1..3.1f64,
    ) {
        let holds = ground_truth(&a, &b, 1.0, &ViewerFrame::from_yaw(yaw));
        for (one, other) in OPPOSITES {
            prop_assert!(!(holds[one] && holds[other]));
        }
        prop_assert!([LEFT_OF, IN_FRONT_OF, BELOW].iter().filter(|i| holds[**i]).count() <= 1, "the anchor's trapezoids");
        prop_assert!([RIGHT_OF, BEHIND, ABOVE].iter().filter(|i| holds[**i]).count() <= 1, "the query's trapezoids");
    }

    #[test]
    fn a_viewer_on_the_other_side_sees_nothing_on_the_same_side_and_the_same_above_and_below(
        a in any_object(), b in any_object(), yaw in -3.1..3.1f64,
    ) {
        let [here, there] = [0.0, std::f64::consts::PI].map(|turn| ground_truth_margins(&a, &b, 1.0, &ViewerFrame::from_yaw(yaw + turn)));
        for i in LEVEL {
            prop_assert!(!(here.holds()[i] && there.holds()[i]));
        }
        for i in [ABOVE, BELOW, CENTERED, ALIGNED] {
            prop_assert!((here.0[i] - there.0[i]).abs() < 1e-9);
        }
    }

    #[test]
    fn boxes_of_one_proportion_exchange_left_and_right_when_the_viewer_goes_to_the_other_side(
        a in any_object(), offset in prop::array::uniform3(-0.4..0.4f64), yaw in -3.1..3.1f64,
    ) {
        let b = moved(&a, &Isometry3::translation(offset[0], offset[1], offset[2]));
        let [here, there] = [0.0, std::f64::consts::PI].map(|turn| ground_truth_margins(&a, &b, 1.0, &ViewerFrame::from_yaw(yaw + turn)));
        for (one, other) in [(LEFT_OF, RIGHT_OF), (IN_FRONT_OF, BEHIND)] {
            prop_assert!((here.0[one] - there.0[other]).abs() < 1e-9);
            prop_assert!((here.0[other] - there.0[one]).abs() < 1e-9);
        }
    }

    #[test]
    fn things_level_with_each_other_exchange_left_and_right_when_the_viewer_goes_to_the_other_side(
        a in any_object(), b in any_object(), away in -0.9..0.9f64, up in -0.9..0.9f64, yaw in -3.1..3.1f64,
    ) {
        let viewer = ViewerFrame::from_yaw(yaw);
        let [of_a, of_b] = [&a, &b].map(|o| ViewerExtents::of_box(&o.bounds, &viewer));
        let [half_a, half_b] = [&of_a, &of_b].map(|e| (e.high - e.low) / 2.0);
        let half = half_a.inf(&half_b);
        // Puts a's centre level with b's, up to `away` and `up` of the lesser half extent.
        let step = Vector3::new(0.0, of_b.center.y - of_a.center.y + away * half.y, of_b.center.z - of_a.center.z + up * half.z);
        let a = moved(&a, &Translation3::from(viewer.world_from_viewer() * step).into());
        let here = ground_truth(&a, &b, 1.0, &viewer);
        let there = ground_truth(&a, &b, 1.0, &ViewerFrame::from_yaw(yaw + std::f64::consts::PI));
        prop_assert_eq!((here[LEFT_OF], here[RIGHT_OF]), (there[RIGHT_OF], there[LEFT_OF]));
    }

    #[test]
    fn turning_and_moving_the_scene_with_its_viewer_changes_nothing(
        a in any_object(), b in any_object(), clouds in (any_cloud(), any_cloud()),
        yaw in -3.1..3.1f64, turn in -3.1..3.1f64, step in prop::array::uniform3(-1.0..1.0f64), gap in 0.0..0.2f64,
    ) {
        let motion = Isometry3::new(Vector3::from(step), Vector3::z() * turn);
        let [before, after] = [yaw, yaw + turn].map(ViewerFrame::from_yaw);
        let truth = ground_truth_margins(&a, &b, gap, &before);
        close(&truth, &ground_truth_margins(&moved(&a, &motion), &moved(&b, &motion), gap, &after), 1e-9)?;
        let [moved_a, moved_b] = [&clouds.0, &clouds.1].map(|c| repose_geometry::cloud::transformed(c, &motion));
        let (was, is) = (clouds_margins(&clouds.0, &clouds.1, &before), clouds_margins(&moved_a, &moved_b, &after));
        // Without the last: of two smallest rectangles with all but the same area, rounding chooses.
        for i in 0..ALIGNED {
            prop_assert!((was.0[i] - is.0[i]).abs() < 1e-5, "margin {i}: {} and {}", was.0[i], is.0[i]);
        }
    }

    #[test]
    fn a_viewer_who_turns_changes_nothing_but_directions(
        a in any_object(), b in any_object(), yaw in -3.1..3.1f64, gap in 0.0..0.2f64,
    ) {
        let [one, other] = [0.0, yaw].map(|yaw| ground_truth_margins(&a, &b, gap, &ViewerFrame::from_yaw(yaw)));
        for i in SYMMETRIC {
            prop_assert!((one.0[i] - other.0[i]).abs() < 1e-12);
        }
    }

    #[test]
    fn directions_scale_with_the_scene(a in any_object(), b in any_object(), yaw in -3.1..3.1f64, scale in 0.1..10.0f64) {
        let viewer = ViewerFrame::from_yaw(yaw);
        let scaled = |o: &TrueBounds| {
            let mut bounds = o.bounds;
            bounds.half_extents *= scale;
            bounds.world_from_box.translation.vector *= scale;
            TrueBounds { bounds }
        };
        let (small, large) = (ground_truth_margins(&a, &b, 1.0, &viewer), ground_truth_margins(&scaled(&a), &scaled(&b), 1.0, &viewer));
        for i in 0..NEAR {
            prop_assert!((small.0[i] * scale - large.0[i]).abs() < 1e-9);
        }
    }

    #[test]
    fn moving_an_object_changes_no_margin_by_more_than_it_moved(
        a in any_object(), b in any_object(), clouds in (any_cloud(), any_cloud()), step in prop::array::uniform3(-0.1..0.1f64), yaw in -3.1..3.1f64,
    ) {
        let viewer = ViewerFrame::from_yaw(yaw);
        let step = Isometry3::translation(step[0], step[1], step[2]);
        let length = step.translation.vector.norm();
        let truth = ground_truth_margins(&a, &b, 0.03, &viewer);
        close(&truth, &ground_truth_margins(&moved(&a, &step), &b, 0.03, &viewer), length + 1e-12)?;
        close(&truth, &ground_truth_margins(&a, &moved(&b, &step), 0.03, &viewer), length + 1e-12)?;
        let observed = clouds_margins(&clouds.0, &clouds.1, &viewer);
        let after = clouds_margins(&repose_geometry::cloud::transformed(&clouds.0, &step), &clouds.1, &viewer);
        for i in 0..ALIGNED {
            prop_assert!((observed.0[i] - after.0[i]).abs() <= length + 1e-5, "margin {i}");
        }
    }

    #[test]
    fn turning_an_object_changes_the_margin_of_aligned_by_no_more_than_the_turn(
        a in any_object(), b in any_object(), axis_angle in prop::array::uniform3(-0.3..0.3f64),
    ) {
        let viewer = ViewerFrame::from_yaw(0.0);
        let mut turned = a;
        let turn = UnitQuaternion::new(Vector3::from(axis_angle));
        turned.bounds.world_from_box.rotation = turn * turned.bounds.world_from_box.rotation;
        let [before, after] = [a, turned].map(|o| ground_truth_margins(&o, &b, 1.0, &viewer).0[ALIGNED]);
        prop_assert!((before - after).abs() <= turn.angle() + 1e-9);
    }

    #[test]
    fn moving_further_to_a_side_only_strengthens_it(
        a in any_object(), b in any_object(), clouds in (any_cloud(), any_cloud()), step_m in 0.0..0.5f64, yaw in -3.1..3.1f64,
    ) {
        let viewer = ViewerFrame::from_yaw(yaw);
        let directions = [-Vector3::x(), Vector3::x(), -Vector3::y(), Vector3::y(), Vector3::z(), -Vector3::z()];
        for (i, direction) in directions.into_iter().enumerate() {
            let step = Translation3::from(viewer.world_from_viewer() * direction * step_m).into();
            let before = ground_truth_margins(&a, &b, 1.0, &viewer).0[i];
            let after = ground_truth_margins(&moved(&a, &step), &b, 1.0, &viewer).0[i];
            prop_assert!(after >= before + step_m * std::f64::consts::FRAC_1_SQRT_2 - 1e-9);
            let before = clouds_margins(&clouds.0, &clouds.1, &viewer).0[i];
            let after = clouds_margins(&repose_geometry::cloud::transformed(&clouds.0, &step), &clouds.1, &viewer).0[i];
            prop_assert!(after >= before + step_m * std::f64::consts::FRAC_1_SQRT_2 - 1e-5);
        }
    }

    #[test]
    fn everything_comes_to_lie_on_the_side_that_it_is_moved_to(a in any_object(), b in any_object(), yaw in -3.1..3.1f64) {
        // Three metres are past any trapezoid's border for offsets up to 0.8 m and boxes up to 0.52 m.
        let viewer = ViewerFrame::from_yaw(yaw);
        let step: Isometry3<f64> = Translation3::from(viewer.world_from_viewer() * -Vector3::x() * 3.0).into();
        let holds = ground_truth(&moved(&a, &step), &b, 1.0, &viewer);
        prop_assert!(holds[LEFT_OF] && !holds[RIGHT_OF] && !holds[IN_FRONT_OF] && !holds[BELOW]);
    }
}
