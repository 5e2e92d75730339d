//! The smallest rectangle around points seen from above, for the orientation of a cloud.

use nalgebra::Point3;
use repose_geometry::Footprint;

/// The yaw of the minimal-area rectangle around the points' (x, y), in [0, π/2): a rectangle looks the same every quarter turn.
///
/// `None` when the points have no area. By the rotating calipers' theorem one side lies on an edge of the convex hull; the first such
/// edge wins a tie.
pub fn rectangle_yaw_rad(points: &[Point3<f32>]) -> Option<f64> {
    let footprint = Footprint::of(points)?;
    let corners = footprint.corners();
    let mut best: Option<(f64, f64)> = None;
    for (k, corner) in corners.iter().enumerate() {
        let along = (corners[(k + 1) % corners.len()] - corner).cast::<f64>().normalize();
        let across = nalgebra::Vector2::new(-along.y, along.x);
        let span = |axis: &nalgebra::Vector2<f64>| {
            let values = corners.iter().map(|c| c.coords.cast::<f64>().dot(axis));
            let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
            high - low
        };
        let area = span(&along) * span(&across);
        if best.is_none_or(|(smallest, _)| area < smallest) {
            best = Some((area, along.y.atan2(along.x).rem_euclid(std::f64::consts::FRAC_PI_2)));
        }
    }
    best.map(|(_, yaw)| yaw)
}

/// The difference of two yaws modulo a quarter turn, in [0, π/4].
pub fn quarter_turn_difference_rad(a_rad: f64, b_rad: f64) -> f64 {
    let difference = (a_rad - b_rad).rem_euclid(std::f64::consts::FRAC_PI_2);
    difference.min(std::f64::consts::FRAC_PI_2 - difference)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn the_rectangle_turns_with_its_points(yaw in -3.1..3.1f64, long in 0.06..0.2f32, short in 0.01..0.05f32) {
            let turn = nalgebra::Rotation3::from_axis_angle(&nalgebra::Vector3::z_axis(), yaw as f32);
            let mut points = Vec::new();
            for i in 0..=20 {
                for j in 0..=8 {
                    points.push(turn * Point3::new(long * (i as f32 / 20.0 - 0.5), short * (j as f32 / 8.0 - 0.5), 0.0));
                }
            }
            let found = rectangle_yaw_rad(&points).unwrap();
            prop_assert!(quarter_turn_difference_rad(found, yaw) < 1e-3, "{found} for {yaw}");
        }
    }

    #[test]
    fn a_line_has_no_orientation() {
        assert_eq!(rectangle_yaw_rad(&[Point3::origin(), Point3::new(1.0, 1.0, 0.0)]), None);
    }
}
