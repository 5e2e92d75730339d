//! Antipodal grasps: two points whose outward normals oppose each other along the line between them, within the cone of friction.
//!
//! Nguyen's condition for two soft fingers. Which of the approaches around that line is taken is left to the judge; those from above come first.

use nalgebra::{Isometry3, Point3, Unit, UnitQuaternion, Vector3};
use rand::RngExt;
use rand_pcg::Pcg64;
use repose_panda::FINGER_OPENING_MAX_M;

use super::{GraspCloud, GraspSettings, pose};

/// Turns of the approach about the closing line, radians from the one most from above.
const APPROACH_TURNS_RAD: [f64; 5] = [0.0, 0.5, -0.5, 1.0, -1.0];
/// Partners tried for each drawn point.
const PARTNERS: usize = 40;

/// Proposed poses of the grasp centre, not yet judged.
pub fn proposals(object: &GraspCloud, settings: &GraspSettings, rng: &mut Pcg64) -> Vec<Isometry3<f64>> {
    let mut poses = Vec::new();
    if object.points.len() < 2 {
        return poses;
    }
    let cone_cos = (settings.friction.atan()).cos() as f32;
    for _ in 0..settings.pairs {
        let i = rng.random_range(0..object.points.len());
        let partner = (0..PARTNERS).map(|_| rng.random_range(0..object.points.len())).find(|k| opposed(object, i, *k, cone_cos));
        if let Some(k) = partner {
            around(&object.points[i].cast(), &object.points[k].cast(), object, settings, &mut poses);
        }
    }
    poses
}

fn opposed(object: &GraspCloud, i: usize, k: usize, cone_cos: f32) -> bool {
    let line = object.points[k] - object.points[i];
    let length = line.norm();
    if !(0.004..=FINGER_OPENING_MAX_M as f32).contains(&length) {
        return false;
    }
    let line = line / length;
    -object.normals[i].dot(&line) >= cone_cos && object.normals[k].dot(&line) >= cone_cos
}

/// The approaches around the line between two contacts that come from above enough.
fn around(a: &Point3<f64>, b: &Point3<f64>, object: &GraspCloud, settings: &GraspSettings, poses: &mut Vec<Isometry3<f64>>) {
    let Some(closing) = Unit::try_new(b - a, 1e-6) else { return };
    let down = -Vector3::z();
    let Some(steepest) = (down - *closing * closing.dot(&down)).try_normalize(1e-3) else { return };
    let mut middle = nalgebra::center(a, b);
    middle.z = middle.z.max(object.floor_m);
    for turn in APPROACH_TURNS_RAD {
        let approach = UnitQuaternion::from_axis_angle(&closing, turn) * steepest;
        if approach.dot(&down) >= settings.approach_max_rad.cos() {
            poses.extend(pose(&middle, &approach, &closing));
        }
    }
}
