//! Grasps from above: over the object's middle and beside it, across every direction, and at the rim of hollow or wide objects.
//!
//! The top of an object is what a camera that looks down sees best, so these hold where pairs of opposing sides were not both seen.

use nalgebra::{Isometry3, Point3, Rotation3, Unit, Vector3};
use repose_geometry::sampling::farthest_point_order;

use super::{GraspSettings, ObjectCloud, gripper::DEPTH_MAX_M, pose};

/// Places along the object's length at which it is taken, as shares of its half length.
const ALONG: [f64; 3] = [0.0, 0.45, -0.45];
/// How deep the grasp centre goes below the top, as shares of what the palm allows.
const DEPTHS: [f64; 2] = [0.8, 0.45];
/// Places on the rim.
const RIM_PLACES: usize = 16;
/// How far below the top a point counts as rim, metres.
const RIM_M: f32 = 0.012;

/// Proposed poses of the grasp centre, not yet judged.
pub fn proposals(object: &ObjectCloud, settings: &GraspSettings) -> Vec<Isometry3<f64>> {
    let mut poses = Vec::new();
    for k in 0..settings.directions {
        let yaw = std::f64::consts::PI * k as f64 / settings.directions as f64;
        across(object, yaw, settings, &mut poses);
    }
    rim(object, settings, &mut poses);
    poses
}

/// Grasps that close along one direction, at several places of the object's length, depths and tilts.
fn across(object: &ObjectCloud, yaw: f64, settings: &GraspSettings, poses: &mut Vec<Isometry3<f64>>) {
    let closing = Vector3::new(yaw.cos(), yaw.sin(), 0.0);
    let along = Vector3::new(-yaw.sin(), yaw.cos(), 0.0);
    let (closing_low, closing_high) = extent(object, &closing);
    let (along_low, along_high) = extent(object, &along);
    let middle = along.dot(&object.middle.coords);
    let across_middle = 0.5 * (closing_low + closing_high);
    let places = ALONG.map(|share| middle + share * 0.5 * (along_high - along_low));
    // Where a round object is widest, which is further from the camera than the middle of what was seen of it.
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
        for depth in DEPTHS {
            let height = (top - depth * DEPTH_MAX_M).max(object.floor_m);
            for tilt in [0.0, settings.tilt_rad, -settings.tilt_rad] {
                let turn = Rotation3::from_axis_angle(&Unit::new_normalize(closing), tilt);
                poses.extend(pose(&Point3::new(level.x, level.y, height), &(turn * -Vector3::z()), &closing));
            }
        }
    }
}

/// Grasps of the wall under the rim, one finger inside: places spread over the highest points, closing towards the middle.
fn rim(object: &ObjectCloud, settings: &GraspSettings, poses: &mut Vec<Isometry3<f64>>) {
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
fn widest_at(object: &ObjectCloud, closing: &Vector3<f64>, low: f64, high: f64, along: &Vector3<f64>) -> Option<f64> {
    const NEAR_M: f64 = 0.004;
    let mean = |extreme: f64| {
        let near = object.points.iter().map(|p| p.coords.cast::<f64>()).filter(|p| (closing.dot(p) - extreme).abs() < NEAR_M);
        let (sum, count) = near.fold((0.0, 0.0), |(sum, count), p| (sum + along.dot(&p), count + 1.0));
        (count > 0.0).then(|| sum / count)
    };
    Some(0.5 * (mean(low)? + mean(high)?))
}

fn extent(object: &ObjectCloud, direction: &Vector3<f64>) -> (f64, f64) {
    object
        .points
        .iter()
        .map(|p| direction.dot(&p.coords.cast::<f64>()))
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
}
