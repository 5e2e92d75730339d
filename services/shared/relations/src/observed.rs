//! Relations between observed clouds: the paper's model-based baseline. (The check beside a planner's answer takes the same rules on
//! completed shapes instead.)
//!
//! The box is the 1–99 % box of the cloud in the viewer's frame, distance is between nearest points, the centre is the box's (not the
//! mean of the points, which the seen side draws to itself), and orientation is the yaw of the smallest rectangle around the cloud seen
//! from above, which looks the same every quarter turn and knows no tilt. What the camera did not see does not count.

use std::sync::OnceLock;

use nalgebra::Point3;
use repose_geometry::{Aabb, PointGrid, ViewerFrame, cloud};

use crate::directional::{ViewerExtents, directional_margins};
use crate::margins::{Margins, NEAR_M, RELATIONS, TOUCHING_CLOUDS_M};
use crate::rectangle::{quarter_turn_difference_rad, rectangle_yaw_rad};

/// The share of points that the box of a cloud leaves out at either end of each axis: the appendix's 1–99 % box.
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
    /// The object of a cloud (world frame), as a viewer sees it; `None` without points. A point with a coordinate that is not finite is
    /// no reading, and left out.
    pub fn new(points_in_world: &[Point3<f32>], viewer: &ViewerFrame) -> Option<Self> {
        let mut points_in_viewer = viewer.points_in_viewer(points_in_world);
        points_in_viewer.retain(|p| p.coords.iter().all(|c| c.is_finite()));
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
    }

    #[test]
    fn a_cloud_without_finite_points_is_no_object_and_others_are_left_out() {
        let viewer = ViewerFrame::from_yaw(0.0);
        let broken = [Point3::new(f32::NAN, 0.0, 0.0), Point3::new(0.0, f32::INFINITY, 0.0)];
        assert!(ObservedObject::new(&[], &viewer).is_none());
        assert!(ObservedObject::new(&broken, &viewer).is_none());
        let cloud = box_cloud([0.1, 0.0, 0.0], [0.05; 3]);
        let with_broken = [&cloud[..], &broken[..]].concat();
        let [clean, mixed] = [cloud, with_broken].map(|points| ObservedObject::new(&points, &viewer).unwrap());
        assert_eq!(clean.extents(), mixed.extents());
    }

    #[test]
    fn a_single_point_lies_on_one_side_of_another_and_has_no_orientation() {
        let viewer = ViewerFrame::from_yaw(0.0);
        let at = |x: f32| ObservedObject::new(&[Point3::new(x, 0.0, 0.0)], &viewer).unwrap();
        let holds = observed(&at(-0.02), &at(0.0));
        assert_eq!((0..RELATIONS).filter(|i| holds[*i]).collect::<Vec<_>>(), [LEFT_OF, NEAR]);
        let same = observed(&at(0.0), &at(0.0));
        assert_eq!((0..RELATIONS).filter(|i| same[*i]).collect::<Vec<_>>(), [NEAR, TOUCHING, CENTERED]);
    }
}
