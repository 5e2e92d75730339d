//! Relations between objects whose pose and shape are known: the labels.

use repose_geometry::{OrientedBox, ViewerFrame};

use crate::directional::{ViewerExtents, directional_margins};
use crate::margins::{Margins, RELATIONS, TOUCHING_MESHES_M};

/// What the rules need to know of a simulated object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrueObject {
    /// The object's own box in the world: centre and corners for the directions, and, since its axes are the object's, its
    /// orientation for `aligned`.
    pub bounds: OrientedBox,
}

/// Which relations hold from `query` to `anchor` for the viewer; `surface_distance_m` is the distance between the two meshes, 0 when
/// they overlap.
pub fn ground_truth(query: &TrueObject, anchor: &TrueObject, surface_distance_m: f64, viewer: &ViewerFrame) -> [bool; RELATIONS] {
    ground_truth_margins(query, anchor, surface_distance_m, viewer).holds()
}

/// By how much each relation holds; see [`ground_truth`].
pub fn ground_truth_margins(query: &TrueObject, anchor: &TrueObject, surface_distance_m: f64, viewer: &ViewerFrame) -> Margins {
    let query_extents = ViewerExtents::of_box(&query.bounds, viewer);
    let anchor_extents = ViewerExtents::of_box(&anchor.bounds, viewer);
    Margins::new(
        directional_margins(&query_extents, &anchor_extents),
        surface_distance_m,
        TOUCHING_MESHES_M,
        query_extents.center_offset_m(&anchor_extents),
        query.bounds.world_from_box.rotation.angle_to(&anchor.bounds.world_from_box.rotation),
    )
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
    use proptest::prelude::*;

    use super::*;
    use crate::margins::index::*;

    fn object(center: [f64; 3], half: [f64; 3], euler: [f64; 3]) -> TrueObject {
        let rotation = UnitQuaternion::from_euler_angles(euler[0], euler[1], euler[2]);
        let world_from_box = Isometry3::from_parts(Translation3::new(center[0], center[1], center[2]), rotation);
        TrueObject { bounds: OrientedBox { world_from_box, half_extents: Vector3::from(half) } }
    }

    fn any_object() -> impl Strategy<Value = TrueObject> {
        (prop::array::uniform3(-0.4..0.4f64), prop::array::uniform3(0.01..0.15f64), prop::array::uniform3(-3.1..3.1f64))
            .prop_map(|(center, half, euler)| object(center, half, euler))
    }

    proptest! {
        #[test]
        fn exchanging_the_objects_mirrors_the_directions(a in any_object(), b in any_object(), yaw in -3.1..3.1f64, gap in 0.0..0.2f64) {
            let viewer = ViewerFrame::from_yaw(yaw);
            let (ab, ba) = (ground_truth(&a, &b, gap, &viewer), ground_truth(&b, &a, gap, &viewer));
            for (one, other) in [(LEFT_OF, RIGHT_OF), (IN_FRONT_OF, BEHIND), (ABOVE, BELOW)] {
                prop_assert_eq!(ab[one], ba[other]);
                prop_assert_eq!(ab[other], ba[one]);
            }
            for symmetric in [NEAR, TOUCHING, CENTERED, ALIGNED] {
                prop_assert_eq!(ab[symmetric], ba[symmetric]);
            }
        }

        #[test]
        fn a_query_is_on_one_side_at_most(a in any_object(), b in any_object(), yaw in -3.1..3.1f64) {
            let holds = ground_truth(&a, &b, 1.0, &ViewerFrame::from_yaw(yaw));
            for (one, other) in [(LEFT_OF, RIGHT_OF), (IN_FRONT_OF, BEHIND), (ABOVE, BELOW)] {
                prop_assert!(!(holds[one] && holds[other]));
            }
        }

        #[test]
        fn a_viewer_who_turns_changes_nothing_but_directions(
            a in any_object(), b in any_object(), yaw in -3.1..3.1f64, gap in 0.0..0.2f64,
        ) {
            let [one, other] = [0.0, yaw].map(|yaw| ground_truth(&a, &b, gap, &ViewerFrame::from_yaw(yaw)));
            for i in [NEAR, TOUCHING, CENTERED, ALIGNED] {
                prop_assert_eq!(one[i], other[i]);
            }
        }

        #[test]
        fn moving_the_query_by_less_than_a_margin_keeps_the_direction(
            a in any_object(), b in any_object(), direction in prop::array::uniform3(-1.0..1.0f64),
        ) {
            let viewer = ViewerFrame::from_yaw(0.3);
            let margins = ground_truth_margins(&a, &b, 1.0, &viewer);
            for i in [LEFT_OF, IN_FRONT_OF, BELOW] {
                let step = Vector3::from(direction).normalize() * margins.0[i].abs() * 0.99;
                let moved = TrueObject { bounds: a.bounds.transformed(&Isometry3::translation(step.x, step.y, step.z)) };
                // A query that fails two rules at once may need more than the margin: only what holds is guaranteed to stay.
                if margins.0[i] > 0.0 {
                    prop_assert!(ground_truth(&moved, &b, 1.0, &viewer)[i]);
                }
            }
        }

        #[test]
        fn nothing_is_left_of_the_same_thing_from_both_sides(a in any_object(), b in any_object(), yaw in -3.1..3.1f64) {
            let here = ground_truth(&a, &b, 1.0, &ViewerFrame::from_yaw(yaw));
            let there = ground_truth(&a, &b, 1.0, &ViewerFrame::from_yaw(yaw + std::f64::consts::PI));
            for i in [LEFT_OF, RIGHT_OF, IN_FRONT_OF, BEHIND] {
                prop_assert!(!(here[i] && there[i]));
            }
        }
    }

    #[test]
    fn a_table_of_cases_has_the_relations_that_people_would_say() {
        let cube = |x: f64, y: f64, z: f64| object([x, y, z], [0.05; 3], [0.0; 3]);
        let anchor = cube(0.0, 0.0, 0.05);
        let viewer = ViewerFrame::from_yaw(0.0);
        let cases: [(&str, TrueObject, f64, &[usize]); 9] = [
            ("beside it on the left", cube(-0.2, 0.0, 0.05), 0.1, &[LEFT_OF, ALIGNED]),
            ("beside it on the right", cube(0.13, 0.02, 0.05), 0.03, &[RIGHT_OF, NEAR, ALIGNED]),
            ("before it", cube(0.03, -0.2, 0.05), 0.1, &[IN_FRONT_OF, ALIGNED]),
            ("after it, touching", cube(0.0, 0.1005, 0.05), 0.0005, &[BEHIND, NEAR, TOUCHING, ALIGNED]),
            ("stacked on it", cube(0.0, 0.0005, 0.15), 0.0, &[ABOVE, NEAR, TOUCHING, CENTERED, ALIGNED]),
            ("under it", cube(0.0, 0.0, -0.2), 0.15, &[BELOW, CENTERED, ALIGNED]),
            ("just to the left of the diagonal through its corner: left, not in front", cube(-0.2, -0.19, 0.05), 0.13, &[LEFT_OF, ALIGNED]),
            ("beyond the trapezoid of the left: only behind", cube(-0.1, 0.2, 0.05), 0.1, &[BEHIND, ALIGNED]),
            (
                "left, but its corners reach past the anchor's center",
                object([-0.06, 0.0, 0.05], [0.08, 0.05, 0.05], [0.0; 3]),
                0.0,
                &[NEAR, TOUCHING, ALIGNED],
            ),
        ];
        for (name, query, gap, expected) in cases {
            let holds = ground_truth(&query, &anchor, gap, &viewer);
            let found: Vec<usize> = (0..RELATIONS).filter(|&i| holds[i]).collect();
            assert_eq!(found, expected, "{name}");
        }
    }

    #[test]
    fn orientation_decides_aligned_up_to_nine_degrees() {
        let anchor = object([0.0; 3], [0.05; 3], [0.0; 3]);
        for (yaw_deg, expected) in [(0.0f64, true), (8.9, true), (9.1, false), (90.0, false)] {
            let query = object([0.3, 0.0, 0.0], [0.05; 3], [0.0, 0.0, yaw_deg.to_radians()]);
            assert_eq!(ground_truth(&query, &anchor, 0.2, &ViewerFrame::from_yaw(0.0))[ALIGNED], expected, "{yaw_deg} degrees");
        }
    }
}
