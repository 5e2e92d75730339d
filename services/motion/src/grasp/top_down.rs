//! Grasps from above: over the object's middle and beside it, across every direction, and at the rim of hollow or wide objects.
//!
//! The top of an object is what a camera that looks down sees best, so these hold where pairs of opposing sides were not both seen.

use nalgebra::{Isometry3, Point3, Rotation3, Unit, Vector2, Vector3};
use repose_geometry::Footprint;
use repose_geometry::sampling::farthest_point_order;

use super::{GraspCloud, GraspSettings, gripper::DEPTH_MAX_M, pose};

/// Places along the object's length at which it is taken, as shares of its half length.
const ALONG: [f64; 3] = [0.0, 0.45, -0.45];
/// How deep the grasp centre goes below the top, as shares of what the palm allows.
const DEPTHS: [f64; 2] = [0.8, 0.45];
/// Lean of the hand past what is higher than the place where an object is taken, radians.
const STEEP_RAD: f64 = 0.8;
/// Places on the rim.
const RIM_PLACES: usize = 16;
/// How far below the top a point counts as rim, metres.
const RIM_M: f32 = 0.012;

/// Proposed poses of the grasp centre, not yet judged.
pub fn proposals(object: &GraspCloud, settings: &GraspSettings) -> Vec<Isometry3<f64>> {
    let mut poses = Vec::new();
    // Square to its sides first: pads that meet a box's faces at a slant turn it as they close and kick it as they open.
    let sides = side_yaw_rad(&object.points).into_iter().flat_map(|yaw| [yaw, yaw + std::f64::consts::FRAC_PI_2]);
    let around = (0..settings.directions).map(|k| std::f64::consts::PI * k as f64 / settings.directions as f64);
    for yaw in sides.chain(around) {
        across(object, yaw, settings, &mut poses);
    }
    rim(object, settings, &mut poses);
    poses
}

/// The direction of one side of the smallest rectangle around the points seen from above, radians from world x; `None` without an area.
fn side_yaw_rad(points: &[Point3<f32>]) -> Option<f64> {
    let outline = Footprint::of(points)?;
    let corners: Vec<Vector2<f64>> = outline.corners().iter().map(|c| c.coords.cast::<f64>()).collect();
    let area = |yaw: f64| {
        let extent = |direction: Vector2<f64>| {
            let along = corners.iter().map(|c| c.dot(&direction));
            let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
            high - low
        };
        extent(Vector2::new(yaw.cos(), yaw.sin())) * extent(Vector2::new(-yaw.sin(), yaw.cos()))
    };
    // One side of the smallest rectangle lies along an edge of the hull.
    let edges = (0..corners.len()).map(|i| corners[(i + 1) % corners.len()] - corners[i]);
    let yaws: Vec<f64> = edges.map(|edge| edge.y.atan2(edge.x)).collect();
    yaws.into_iter().min_by(|a, b| area(*a).total_cmp(&area(*b)))
}

/// Grasps that close along one direction, at several places of the object's length, depths and tilts.
fn across(object: &GraspCloud, yaw: f64, settings: &GraspSettings, poses: &mut Vec<Isometry3<f64>>) {
    let closing = Vector3::new(yaw.cos(), yaw.sin(), 0.0);
    let along = Vector3::new(-yaw.sin(), yaw.cos(), 0.0);
    let (closing_low, closing_high) = extent(object, &closing);
    let (along_low, along_high) = extent(object, &along);
    let middle = along.xy().dot(&object.axis);
    let across_middle = 0.5 * (closing_low + closing_high);
    let places = ALONG.map(|share| middle + share * 0.5 * (along_high - along_low));
    // Where a round object is widest, which is further from the camera than the middle of what was seen of it.
    let object_top = f64::from(object.bounds.max.z);
    let widest = widest_at(object, &closing, closing_low, closing_high, &along).unwrap_or(middle);
    for s in places.into_iter().chain([widest]) {
        let level = closing * across_middle + along * s;
        // The top where the fingers come down, which may be lower than the object's.
        let half = settings.gripper.finger_half_width_m;
        let top = object
            .points
            .iter()
            .filter(|p| (along.dot(&p.coords.cast::<f64>()) - s).abs() <= half)
            .map(|p| f64::from(p.z))
            .fold(f64::NEG_INFINITY, f64::max);
        if !top.is_finite() {
            continue;
        }
        let mut heights = DEPTHS.map(|depth| (top - depth * DEPTH_MAX_M).max(object.floor_m)).to_vec();
        // Of something low the hand reaches the foot from above whichever it is.
        heights.dedup();
        let mut tilted = |tilt: f64, height: f64| {
            let turn = Rotation3::from_axis_angle(&Unit::new_normalize(closing), tilt);
            poses.extend(pose(&Point3::new(level.x, level.y, height), &(turn * -Vector3::z()), &closing));
        };
        for height in heights {
            for tilt in [0.0, settings.tilt_rad, -settings.tilt_rad] {
                tilted(tilt, height);
            }
            // Past something higher, a neck or a handle, the palm comes lower the more the hand leans away from it.
            if object_top - height > DEPTH_MAX_M {
                tilted((middle - s).signum() * STEEP_RAD, height);
            }
        }
    }
}

/// Grasps of the wall under the rim, one finger inside: places spread over the highest points, closing towards the middle.
fn rim(object: &GraspCloud, settings: &GraspSettings, poses: &mut Vec<Isometry3<f64>>) {
    let top = object.bounds.max.z;
    let high: Vec<Point3<f32>> = object.points.iter().filter(|p| p.z > top - RIM_M).copied().collect();
    let middle = object.bounds.center();
    for i in farthest_point_order(&high, RIM_PLACES) {
        let place = high[i as usize];
        let mut closing = (place - middle).cast::<f64>();
        closing.z = 0.0;
        let height = (f64::from(place.z) - 0.7 * DEPTH_MAX_M).max(object.floor_m);
        let at = Point3::new(f64::from(place.x), f64::from(place.y), height);
        for tilt in [0.0, settings.tilt_rad] {
            let Some(axis) = Unit::try_new(closing, 1e-3) else { continue };
            let turn = Rotation3::from_axis_angle(&axis, tilt);
            poses.extend(pose(&at, &(turn * -Vector3::z()), &closing));
        }
    }
}

/// The place along the object at which its two outermost points across lie, on average.
fn widest_at(object: &GraspCloud, closing: &Vector3<f64>, low: f64, high: f64, along: &Vector3<f64>) -> Option<f64> {
    const NEAR_M: f64 = 0.004;
    let mean = |extreme: f64| {
        let near = object.points.iter().map(|p| p.coords.cast::<f64>()).filter(|p| (closing.dot(p) - extreme).abs() < NEAR_M);
        let (sum, count) = near.fold((0.0, 0.0), |(sum, count), p| (sum + along.dot(&p), count + 1.0));
        (count > 0.0).then(|| sum / count)
    };
    Some(0.5 * (mean(low)? + mean(high)?))
}

fn extent(object: &GraspCloud, direction: &Vector3<f64>) -> (f64, f64) {
    object
        .points
        .iter()
        .map(|p| direction.dot(&p.coords.cast::<f64>()))
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

    #[test]
    fn the_sides_of_a_box_are_found_at_any_turn() {
        for turn in [-0.7, -0.2, 0.1, 0.6] {
            let yaw = side_yaw_rad(&synthetic::seen_box([0.5, 0.1], [0.12, 0.05, 0.10], turn)).expect("an area");
            let off = (yaw - turn).rem_euclid(std::f64::consts::FRAC_PI_2);
            assert!(off.min(std::f64::consts::FRAC_PI_2 - off) < 0.02, "{yaw} for {turn}");
        }
    }

    #[test]
    fn beside_a_neck_the_hand_leans_away_from_it() {
        // Shoulders 10 cm high to both sides of a neck of 17 cm.
        let body = synthetic::seen_box([0.5, 0.0], [0.12, 0.05, 0.10], 0.0);
        let points: Vec<Point3<f32>> = body.into_iter().chain(synthetic::seen_box([0.5, 0.0], [0.03, 0.03, 0.17], 0.0)).collect();
        let bounds = repose_geometry::Aabb::of(&points).expect("it has points");
        let normals = vec![Vector3::z(); points.len()];
        let (axis, middle_m, floor_m) = (Vector2::new(0.5, 0.0), 0.085, 0.017);
        let object = GraspCloud { points, normals, axis, behind: Vec::new(), bounds, middle_m, floor_m };
        let proposed = proposals(&object, &GraspSettings::default());
        let steep: Vec<&Isometry3<f64>> =
            proposed.iter().filter(|tcp| ((-(tcp.rotation * Vector3::z()).z).acos() - STEEP_RAD).abs() < 1e-6).collect();
        assert!(!steep.is_empty());
        for tcp in steep {
            let (fingers_m, palm_m) = (tcp.translation.x - 0.5, (tcp * Point3::new(0.0, 0.0, -0.1)).x - 0.5);
            let leans_away = palm_m.abs() > fingers_m.abs() || fingers_m.abs() < 0.01;
            assert!(leans_away && tcp.translation.z < 0.10, "{tcp}");
        }
    }
}
