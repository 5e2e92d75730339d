//! Relations between observed clouds: the paper's model-based baseline, and the geometric check of an answer.
//!
//! The box is the 1–99 % box of the cloud in the viewer's frame, distance is between nearest points, and orientation is the yaw of
//! the smallest rectangle around the cloud seen from above. What the camera did not see does not count.

use std::sync::OnceLock;

use nalgebra::Point3;
use repose_geometry::{Aabb, PointGrid, ViewerFrame, cloud};

use crate::directional::{ViewerExtents, directional_margins};
use crate::margins::{Margins, NEAR_M, RELATIONS, TOUCHING_CLOUDS_M};
use crate::rectangle::{quarter_turn_difference_rad, rectangle_yaw_rad};

/// The share of points that the box of a cloud leaves out at either end of each axis.
const STRAY_SHARE: f64 = 0.01;
/// Distances between clouds are searched this far; more only has to be known to be more.
const SEARCH_M: f32 = NEAR_M as f32 + 0.01;
/// Cells of the search grid: a few points each at a camera's spacing, and few cells within [`SEARCH_M`].
const CELL_M: f32 = 0.02;

/// A cloud with what the rules need of it, computed once.
#[derive(Debug, Clone)]
pub struct ObservedObject {
    points_in_viewer: Vec<Point3<f32>>,
    robust: ViewerExtents,
    whole: Aabb,
    yaw_rad: Option<f64>,
    grid: OnceLock<PointGrid>,
}

impl ObservedObject {
    /// The object of a cloud (world frame), as a viewer sees it; `None` without points.
    pub fn new(points_in_world: &[Point3<f32>], viewer: &ViewerFrame) -> Option<Self> {
        let points_in_viewer = viewer.points_in_viewer(points_in_world);
        let robust = cloud::percentile_box(&points_in_viewer, STRAY_SHARE, 1.0 - STRAY_SHARE)?;
        let whole = Aabb::of(&points_in_viewer)?;
        let yaw_rad = rectangle_yaw_rad(&points_in_viewer);
        Some(Self { robust: ViewerExtents::of_viewer_aabb(&robust), whole, yaw_rad, points_in_viewer, grid: OnceLock::new() })
    }

    /// What the cloud spans along the viewer's axes, strays left out.
    pub fn extents(&self) -> &ViewerExtents {
        &self.robust
    }

    /// The smallest distance between a point of one and a point of the other, metres; beyond 6 cm a lower bound of it.
    pub fn distance_m(&self, other: &Self) -> f64 {
        let lower_bound = self.whole.distance(&other.whole);
        if lower_bound > SEARCH_M {
            return f64::from(lower_bound);
        }
        // The grid is the larger cloud's: fewer look-ups, and the same answer whoever asks.
        let (few, many) = if self.points_in_viewer.len() <= other.points_in_viewer.len() { (self, other) } else { (other, self) };
        let grid = many.grid.get_or_init(|| PointGrid::new(many.points_in_viewer.clone(), CELL_M));
        let mut best = SEARCH_M;
        for p in &few.points_in_viewer {
            if many.whole.inflated(best).contains(p)
                && let Some(nearer) = grid.nearest_distance(p, best)
            {
                best = best.min(nearer);
            }
        }
        f64::from(best)
    }
}

/// Which relations hold from `query` to `anchor`; both must have been made for the same viewer.
pub fn observed(query: &ObservedObject, anchor: &ObservedObject) -> [bool; RELATIONS] {
    observed_margins(query, anchor).holds()
}

/// By how much each relation holds; see [`observed`].
pub fn observed_margins(query: &ObservedObject, anchor: &ObservedObject) -> Margins {
    let turn_rad = match (query.yaw_rad, anchor.yaw_rad) {
        (Some(a), Some(b)) => quarter_turn_difference_rad(a, b),
        // Without an area there is no orientation to agree: as far apart as two rectangles can be.
        _ => std::f64::consts::FRAC_PI_4,
    };
    Margins::new(
        directional_margins(&query.robust, &anchor.robust),
        query.distance_m(anchor),
        TOUCHING_CLOUDS_M,
        query.robust.center_offset_m(&anchor.robust),
        turn_rad,
    )
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::margins::index::*;

    /// Points all over a box's faces, 5 mm apart.
    fn box_cloud(center: [f32; 3], size: [f32; 3]) -> Vec<Point3<f32>> {
        let steps = size.map(|s| (s / 0.005).ceil() as i32);
        let mut points = Vec::new();
        for i in 0..=steps[0] {
            for j in 0..=steps[1] {
                for k in 0..=steps[2] {
                    let at = [i, j, k];
                    if (0..3).any(|a| at[a] == 0 || at[a] == steps[a]) {
                        points.push(Point3::from([0, 1, 2].map(|a| center[a] + size[a] * (at[a] as f32 / steps[a] as f32 - 0.5))));
                    }
                }
            }
        }
        points
    }

    proptest! {
        #[test]
        fn distance_is_what_all_pairs_give(offset in prop::array::uniform3(-0.15..0.15f32)) {
            let viewer = ViewerFrame::from_yaw(0.4);
            let (a, b) = (box_cloud([0.0; 3], [0.04; 3]), box_cloud(offset, [0.03, 0.05, 0.02]));
            let all = a.iter().flat_map(|p| b.iter().map(move |q| (p - q).norm())).fold(f32::INFINITY, f32::min);
            let (a, b) = (ObservedObject::new(&a, &viewer).unwrap(), ObservedObject::new(&b, &viewer).unwrap());
            let found = a.distance_m(&b) as f32;
            prop_assert_eq!(found, b.distance_m(&a) as f32);
            if all < SEARCH_M - 1e-4 {
                prop_assert!((found - all).abs() < 1e-4, "{found} for {all}");
            } else {
                prop_assert!(found >= SEARCH_M - 2e-4 && found <= all + 1e-4);
            }
        }

        #[test]
        fn exchange_mirrors_and_half_a_turn_of_the_viewer_exchanges(offset in prop::array::uniform3(-0.3..0.3f32), yaw in -3.1..3.1f64) {
            let (a, b) = (box_cloud([0.0; 3], [0.06; 3]), box_cloud(offset, [0.06; 3]));
            let holds = |yaw: f64| {
                let viewer = ViewerFrame::from_yaw(yaw);
                let (a, b) = (ObservedObject::new(&a, &viewer).unwrap(), ObservedObject::new(&b, &viewer).unwrap());
                (observed_margins(&b, &a), observed_margins(&a, &b))
            };
            let ((ba, ab), (ba_turned, _)) = (holds(yaw), holds(yaw + std::f64::consts::PI));
            for (one, other) in [(LEFT_OF, RIGHT_OF), (IN_FRONT_OF, BEHIND), (ABOVE, BELOW)] {
                prop_assert_eq!(ba.0[one], ab.0[other]);
            }
            // Of equal boxes neither is the wider, so that turning the viewer is the same as exchanging them.
            for (one, other) in [(LEFT_OF, RIGHT_OF), (IN_FRONT_OF, BEHIND)] {
                prop_assert!((ba.0[one] - ba_turned.0[other]).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn clouds_side_by_side_are_near_touching_and_aligned() {
        let viewer = ViewerFrame::from_yaw(0.0);
        let anchor = ObservedObject::new(&box_cloud([0.0; 3], [0.1, 0.05, 0.06]), &viewer).unwrap();
        let query = ObservedObject::new(&box_cloud([0.102, 0.0, 0.0], [0.1, 0.05, 0.06]), &viewer).unwrap();
        let holds = observed(&query, &anchor);
        let found: Vec<usize> = (0..RELATIONS).filter(|&i| holds[i]).collect();
        assert_eq!(found, [RIGHT_OF, NEAR, TOUCHING, ALIGNED]);
    }

    #[test]
    fn an_empty_cloud_is_no_object() {
        assert!(ObservedObject::new(&[], &ViewerFrame::from_yaw(0.0)).is_none());
    }
}
