//! How far the surfaces that the pads meet converge: between them the object is a wedge, and one that is blunter than friction bridges is
//! squeezed out sideways as the fingers close. The corner of a box is one, and so is the side of a neck beside its middle.
//!
//! The outline between the pads is that of what was seen and of what is believed behind it, so that a face nobody saw counts as what joins
//! those beside it. Two parallel faces at a slant are no wedge: the pads turn them square.

use nalgebra::{Point2, Point3, Vector2};
use repose_geometry::Footprint;

/// Outlines seen closer than this along the closing direction are the same: the noise of depth, metres.
const SAME_M: f32 = 0.002;

/// How pads meet what is between them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Meeting {
    /// The angle at which the two surfaces converge, radians.
    pub wedge_rad: f64,
    /// How far from the pads' middle the two contacts are on average, metres: near the pads' edge what they close on turns out from between them.
    pub aside_m: f64,
}

/// How pads of this half width that close along y meet an outline; none where it is not between them.
pub fn meeting(points: &[Point3<f32>], pad_half_m: f32) -> Option<Meeting> {
    let outline = Footprint::of(points)?;
    let [low, high] = [-1.0, 1.0].map(|side| contact(outline.corners(), side, pad_half_m));
    let ((low_m, low), (high_m, high)) = low.zip(high)?;
    Some(Meeting { wedge_rad: f64::from(low.angle(&-high)), aside_m: 0.5 * f64::from((low_m + high_m).abs()) })
}

/// Where along the pad on one side the outline touches it, and the outward normal of the surface there: the pad's own where the outline
/// reaches out furthest under it, the outline's where that goes on beyond the pad's edge.
fn contact(corners: &[Point2<f32>], side: f32, pad_half_m: f32) -> Option<(f32, Vector2<f32>)> {
    let edges = (0..corners.len()).map(|i| (corners[i], corners[(i + 1) % corners.len()]));
    // What of each edge lies under the pad: where it reaches out furthest, and the edge's direction.
    let ends = edges.filter_map(|(a, b)| clipped(a, b, pad_half_m).map(|ends| ends.map(|end| (end, b - a))));
    let under: Vec<(Point2<f32>, Vector2<f32>)> = ends.flatten().collect();
    let furthest = under.iter().map(|(p, _)| side * p.y).reduce(f32::max)?;
    let touched = || under.iter().filter(|(p, _)| side * p.y > furthest - SAME_M);
    let (left, right) = touched().fold((f32::MAX, f32::MIN), |(l, r), (p, _)| (l.min(p.x), r.max(p.x)));
    let at = 0.5 * (left + right);
    let inside = |x: f32| x.abs() < pad_half_m - 1e-4;
    if inside(left) && inside(right) || left < 0.0 && right > 0.0 {
        return Some((at, Vector2::new(0.0, side)));
    }
    // The edge that lies flattest of those that reach the pad's edge.
    let (_, edge) = touched().filter(|(p, _)| !inside(p.x)).max_by(|(_, a), (_, b)| flatness(a).total_cmp(&flatness(b)))?;
    let normal = Vector2::new(-edge.y, edge.x).try_normalize(1e-9)?;
    Some((at, if side * normal.y < 0.0 { -normal } else { normal }))
}

fn flatness(edge: &Vector2<f32>) -> f32 {
    edge.x.abs() / edge.norm().max(1e-9)
}

/// The ends of what of an edge lies within `half_m` of x = 0.
fn clipped(a: Point2<f32>, b: Point2<f32>, half_m: f32) -> Option<[Point2<f32>; 2]> {
    if a.x.min(b.x) > half_m || a.x.max(b.x) < -half_m {
        return None;
    }
    let along = b.x - a.x;
    let share = |x: f32| if along.abs() < 1e-9 { 0.0 } else { ((x - a.x) / along).clamp(0.0, 1.0) };
    Some(if along.abs() < 1e-9 { [a, b] } else { [share(-half_m), share(half_m)].map(|s| a + (b - a) * s) })
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAD_M: f32 = 0.0105;

    /// The outline of a box turned by `yaw`, its middle at `at`.
    fn turned_box(at: [f32; 2], size: [f32; 2], yaw: f32) -> Vec<Point3<f32>> {
        let turn = nalgebra::Rotation2::new(yaw);
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        let placed = |[x, y]: [f32; 2]| turn * Point2::new(0.5 * x * size[0], 0.5 * y * size[1]) + Vector2::from(at);
        corners.into_iter().map(placed).map(|p| Point3::new(p.x, p.y, 0.0)).collect()
    }

    fn circle(at: [f32; 2], radius_m: f32) -> Vec<Point3<f32>> {
        let angle = |k: i32| std::f32::consts::TAU * k as f32 / 60.0;
        (0..60).map(|k| Point3::new(at[0] + radius_m * angle(k).cos(), at[1] + radius_m * angle(k).sin(), 0.0)).collect()
    }

    fn met(points: &[Point3<f32>]) -> Meeting {
        meeting(points, PAD_M).expect("it is between the pads")
    }

    #[test]
    fn parallel_faces_are_no_wedge_however_they_are_turned() {
        for yaw in [0.0, 0.15, -0.4] {
            let met = met(&turned_box([0.0, 0.0], [0.08, 0.05], yaw));
            assert!(met.wedge_rad < 0.01 && met.aside_m < 0.001, "{met:?} at {yaw}");
        }
    }

    #[test]
    fn the_corner_of_a_box_is_a_wedge_and_so_is_the_side_of_a_neck() {
        let corner = met(&turned_box([0.045, 0.0], [0.08, 0.08], std::f32::consts::FRAC_PI_4));
        assert!((corner.wedge_rad - std::f64::consts::FRAC_PI_2).abs() < 0.05, "{corner:?}");
        let (middle, side) = (met(&circle([0.003, 0.0], 0.012)), met(&circle([0.019, 0.0], 0.012)));
        assert!(middle.wedge_rad < 0.01 && side.wedge_rad > 1.0, "{middle:?} {side:?}");
    }

    #[test]
    fn the_end_of_a_slanted_box_is_met_at_the_edge_of_the_pads() {
        let end = met(&turned_box([0.017, 0.004], [0.052, 0.078], -0.42));
        assert!(end.aside_m > 0.008, "{end:?}");
    }

    #[test]
    fn what_is_beside_the_pads_is_not_met() {
        assert_eq!(meeting(&turned_box([0.1, 0.0], [0.04, 0.04], 0.0), PAD_M), None);
    }
}
