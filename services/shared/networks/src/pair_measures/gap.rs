//! How far two clouds are apart: by the widest gap that a plane can be put into, and by their nearest points.

use nalgebra::Vector3;

use super::cloud::{MeasuredCloud, OutlineSource, directions};

/// Hulls farther apart than this are far apart: their plane is not refined, and their nearest points are not looked for.
pub(super) const CLOSE_M: f32 = 0.06;
/// How far a direction is tilted when it is refined, radians, one size after another.
const TILTS_RAD: [f32; 5] = [0.2, 0.1, 0.05, 0.025, 0.012];
/// Points of either cloud among which the nearest are looked for.
const FACING: usize = 96;

/// The widest gap that a plane between the anchor's and the query's outlines can have, metres, negative when their hulls overlap (then minus
/// about the least way that parts them); and the plane's normal, towards the query.
pub(super) fn separation(
    query: &MeasuredCloud,
    anchor: &MeasuredCloud,
    offset: &Vector3<f32>,
    outline: OutlineSource,
) -> (f32, Vector3<f32>) {
    let known = directions()
        .iter()
        .enumerate()
        .map(|(d, (u, opposite))| (u.dot(offset) - query.known_reach(*opposite, outline) - anchor.known_reach(d, outline), *u));
    let widest = |best: (f32, Vector3<f32>), next: (f32, Vector3<f32>)| if next.0 > best.0 { next } else { best };
    let mut best = known.fold((f32::NEG_INFINITY, Vector3::z()), widest);
    if best.0 > CLOSE_M {
        return best;
    }
    for tilt in TILTS_RAD {
        let (first, second) = across(&best.1);
        let tilted = [first, -first, second, -second].map(|t| (best.1 + t * tilt).normalize());
        let gap = |u: Vector3<f32>| (u.dot(offset) - query.reach(&-u, outline) - anchor.reach(&u, outline), u);
        best = tilted.into_iter().map(gap).fold(best, widest);
    }
    best
}

/// Two directions across a direction and each other.
fn across(u: &Vector3<f32>) -> (Vector3<f32>, Vector3<f32>) {
    let other = if u.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
    let first = u.cross(&other).normalize();
    (first, u.cross(&first))
}

/// The least distance between points of the two clouds, metres; and the least when what cleaning took is put back on both, which can be
/// negative. Unlike planes, points see into hollows. Both are [`CLOSE_M`] at most.
pub(super) fn nearest(query: &MeasuredCloud, anchor: &MeasuredCloud, offset: &Vector3<f32>) -> [f32; 2] {
    let of_query = facing(query, anchor, offset);
    let of_anchor = facing(anchor, query, &-offset);
    let width = query.rim.width_m + anchor.rim.width_m;
    let line_of_sight = Vector3::from(query.rim.line_of_sight);
    let (mut least, mut restored) = (CLOSE_M * CLOSE_M, CLOSE_M);
    for i in of_query {
        let from = offset + point(query, i);
        for j in &of_anchor {
            let between = from - point(anchor, *j);
            let squared = between.norm_squared();
            least = least.min(squared);
            // Cheap first: putting the rims back on brings points nearer by both at most.
            if squared < (restored + width) * (restored + width) {
                let distance = squared.sqrt().max(f32::EPSILON);
                let along = between.dot(&line_of_sight) / distance;
                restored = restored.min(distance - width * (1.0 - along * along).max(0.0).sqrt());
            }
        }
    }
    [least.sqrt(), restored]
}

fn point(cloud: &MeasuredCloud, i: usize) -> Vector3<f32> {
    Vector3::new(cloud.axes[0][i], cloud.axes[1][i], cloud.axes[2][i])
}

/// The points of a cloud that are nearest to the other's box, up to [`FACING`] of them, in the cloud's order where they are equally near.
fn facing(cloud: &MeasuredCloud, other: &MeasuredCloud, offset: &Vector3<f32>) -> Vec<usize> {
    let squared = |i: usize| -> f32 {
        let beyond = |k: usize| {
            let at = cloud.axes[k][i] + offset[k];
            (other.low[k] - at).max(at - other.high[k]).max(0.0)
        };
        (0..3).map(|k| beyond(k) * beyond(k)).sum()
    };
    let mut near: Vec<(f32, usize)> = (0..cloud.axes[0].len()).map(|i| (squared(i), i)).filter(|(d, _)| *d < CLOSE_M * CLOSE_M).collect();
    if near.len() > FACING {
        near.select_nth_unstable_by(FACING, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        near.truncate(FACING);
    }
    near.into_iter().map(|(_, i)| i).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::tests::cuboid;
    use super::*;

    proptest! {
        #[test]
        fn the_gap_between_boxes_face_to_face_is_found_whatever_way_they_are_turned(
            yaw_rad in -3.1..3.1f32, gap_m in -0.01..0.05f32, slide_m in -0.02..0.02f32, rim_m in 0.0..0.01f32,
        ) {
            let (query, anchor) = (cuboid([0.03, 0.04, 0.05], yaw_rad, rim_m), cuboid([0.05, 0.04, 0.05], yaw_rad, rim_m));
            let (sin, cos) = yaw_rad.sin_cos();
            let along = 0.08 + gap_m;
            let offset = Vector3::new(cos * along - sin * slide_m, sin * along + cos * slide_m, 0.0);
            let (found_m, normal) = separation(&query, &anchor, &offset, OutlineSource::Observed);
            prop_assert!((found_m - gap_m).abs() < 0.002, "{} instead of {}", found_m, gap_m);
            prop_assert!(normal.dot(&Vector3::new(cos, sin, 0.0)) > 0.99 || gap_m < 0.002);
            // Restored outlines are nearer by both rims where the plane lies along the line of sight, and never farther.
            let (restored_m, _) = separation(&query, &anchor, &offset, OutlineSource::Restored);
            let beyond_m = query.rim.beyond_m([cos, sin, 0.0]) + anchor.rim.beyond_m([cos, sin, 0.0]);
            prop_assert!(restored_m <= found_m + 1e-6 && restored_m >= gap_m - beyond_m - 0.002, "{} of {}", restored_m, gap_m);
        }

        #[test]
        fn the_nearest_points_are_as_far_apart_as_faces_are(gap_m in 0.001..0.05f32, rim_m in 0.0..0.01f32) {
            let (query, anchor) = (cuboid([0.03, 0.04, 0.05], 0.0, rim_m), cuboid([0.05, 0.04, 0.05], 0.0, rim_m));
            let [least_m, restored_m] = nearest(&query, &anchor, &Vector3::new(0.08 + gap_m, 0.0, 0.0));
            prop_assert!((least_m - gap_m).abs() < 0.002, "{} instead of {}", least_m, gap_m);
            // The line of sight is y: across it, both rims come back on.
            prop_assert!((restored_m - (gap_m - 2.0 * rim_m)).abs() < 0.003, "{} instead of {}", restored_m, gap_m - 2.0 * rim_m);
        }
    }

    #[test]
    fn one_on_the_other_is_parted_by_a_level_plane() {
        let (query, anchor) = (cuboid([0.03, 0.04, 0.05], 0.3, 0.0), cuboid([0.05, 0.04, 0.02], -0.8, 0.0));
        let (gap_m, normal) = separation(&query, &anchor, &Vector3::new(0.01, 0.0, 0.072), OutlineSource::Observed);
        assert!((gap_m - 0.002).abs() < 1e-4 && normal.z > 0.999, "{gap_m} {normal}");
    }

    #[test]
    fn points_see_into_a_hollow_that_no_plane_parts() {
        let wall = cuboid([0.05, 0.05, 0.05], 0.0, 0.0);
        let inside = cuboid([0.02, 0.02, 0.02], 0.0, 0.0);
        assert!(separation(&inside, &wall, &Vector3::zeros(), OutlineSource::Observed).0 < -0.05);
        let [least_m, _] = nearest(&inside, &wall, &Vector3::zeros());
        assert!((least_m - 0.03).abs() < 0.002, "{least_m}");
    }
}
