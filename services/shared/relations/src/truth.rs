//! Relations between objects whose pose and shape are known: the labels.
//!
//! `aligned` compares ground-truth orientations, as the appendix has it: the angle of the rotation that carries one object's axes to the
//! other's, all three of them. A can that was turned about its own axis is therefore turned, and a box turned by a quarter is not
//! aligned with its twin, although nobody could tell from looking; the appendix calls the label hard to learn for that reason, and the
//! paper's networks leave it out. Clouds are judged by what they show instead ([`crate::observed`](mod@crate::observed)).

use repose_geometry::{OrientedBox, ViewerFrame};

use crate::directional::{ViewerExtents, directional_margins};
use crate::margins::{Margins, RELATIONS, TOUCHING_MESHES_M};

/// The true bounds of a simulated object: all that the rules use.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrueBounds {
    /// The object's own box in the world: centre and corners for the directions, and, since its axes are the object's, its
    /// orientation for `aligned`.
    pub bounds: OrientedBox,
}

/// Which relations hold from `query` to `anchor` for the viewer; `surface_distance_m` is the distance between the two meshes, 0 when
/// they overlap.
pub fn ground_truth(query: &TrueBounds, anchor: &TrueBounds, surface_distance_m: f64, viewer: &ViewerFrame) -> [bool; RELATIONS] {
    ground_truth_margins(query, anchor, surface_distance_m, viewer).holds()
}

/// By how much each relation holds; see [`ground_truth`].
pub fn ground_truth_margins(query: &TrueBounds, anchor: &TrueBounds, surface_distance_m: f64, viewer: &ViewerFrame) -> Margins {
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
    use nalgebra::{Isometry3, Vector3};

    use super::*;
    use crate::margins::index::*;

    fn cube(yaw_deg: f64) -> TrueBounds {
        let world_from_box = Isometry3::new(Vector3::new(0.3, 0.0, 0.0), Vector3::z() * yaw_deg.to_radians());
        TrueBounds { bounds: OrientedBox { world_from_box, half_extents: Vector3::repeat(0.05) } }
    }

    #[test]
    fn orientation_decides_aligned_up_to_nine_degrees() {
        for (yaw_deg, expected) in [(0.0, true), (8.9, true), (-8.9, true), (9.1, false), (90.0, false), (180.0, false), (359.0, true)] {
            let holds = ground_truth(&cube(yaw_deg), &cube(0.0), 0.2, &ViewerFrame::from_yaw(0.0));
            assert_eq!(holds[ALIGNED], expected, "{yaw_deg} degrees");
        }
    }

    #[test]
    fn limits_hold_where_they_are_said_to_be_at_most() {
        let at = |distance_m: f64| ground_truth(&cube(0.0), &cube(0.0), distance_m, &ViewerFrame::from_yaw(0.0));
        assert!(at(0.05)[NEAR] && !at(0.050001)[NEAR]);
        assert!(at(0.001)[TOUCHING] && !at(0.001001)[TOUCHING]);
    }

    #[test]
    fn what_is_not_a_number_has_no_relations() {
        for broken in [f64::NAN, f64::INFINITY] {
            let mut query = cube(0.0);
            query.bounds.world_from_box.translation.vector.x = broken;
            for (i, j) in [(query, cube(0.0)), (cube(0.0), query)] {
                let holds = ground_truth(&i, &j, f64::NAN, &ViewerFrame::from_yaw(0.3));
                // Only the orientations are known.
                assert_eq!((0..RELATIONS).filter(|k| holds[*k]).collect::<Vec<_>>(), [ALIGNED], "{broken}");
            }
        }
        let mut query = cube(0.0);
        query.bounds.half_extents.y = f64::NAN;
        query.bounds.world_from_box.translation.vector.x = -1.0;
        let holds = ground_truth(&query, &cube(0.0), 1.0, &ViewerFrame::from_yaw(0.0));
        assert!(holds[..NEAR].iter().all(|holds| !holds), "no direction without a size");
    }
}
