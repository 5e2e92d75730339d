//! Between nalgebra (ours everywhere) and the physics engine's types, at its edge and nowhere else.

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion};
use rapier3d::math::{Pose, Rotation, Vector};

/// A rigid transform as the engine's pose (single precision).
pub fn pose(to_from: &Isometry3<f64>) -> Pose {
    let (t, q) = (&to_from.translation.vector, to_from.rotation.quaternion());
    let rotation = Rotation::from_xyzw(q.i as f32, q.j as f32, q.k as f32, q.w as f32);
    Pose::from_parts(Vector::new(t.x as f32, t.y as f32, t.z as f32), rotation.normalize())
}

/// The same as the pose that a body at `from` goes to next. Of the two quaternions of a rotation it has the one on the near side: the engine takes
/// the other for a full turn within a step, and throws what the body touches or carries.
pub fn next_pose(to_from: &Isometry3<f64>, from: &Pose) -> Pose {
    let next = pose(to_from);
    let rotation = if next.rotation.dot(from.rotation) < 0.0 { -next.rotation } else { next.rotation };
    Pose { rotation, ..next }
}

/// The engine's pose as a rigid transform.
pub fn isometry(pose: &Pose) -> Isometry3<f64> {
    let (t, q) = (pose.translation, pose.rotation);
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(f64::from(q.w), f64::from(q.x), f64::from(q.y), f64::from(q.z)));
    Isometry3::from_parts(Translation3::new(f64::from(t.x), f64::from(t.y), f64::from(t.z)), rotation)
}

/// A point as the engine's vector.
pub fn vector(p: &Point3<f32>) -> Vector {
    Vector::new(p.x, p.y, p.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_survives_the_round_trip() {
        let original = Isometry3::from_parts(Translation3::new(0.3, -0.2, 1.5), UnitQuaternion::from_euler_angles(0.4, -1.0, 2.5));
        let back = isometry(&pose(&original));
        assert!((back.to_homogeneous() - original.to_homogeneous()).amax() < 1e-6);
    }
}
