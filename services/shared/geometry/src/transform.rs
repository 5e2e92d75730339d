//! Rigid transforms in the wire's form, and the planar motion that a placement is.
//!
//! On the wire a transform is 16 numbers, row-major, named `to_from`; here it is an [`Isometry3<f64>`].

use nalgebra::{Isometry3, Matrix4, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// How far a rotation block may be from orthonormal before it is refused (entry-wise on `RRᵀ − I`): as on the wire, where its rows are looked at.
pub const ORTHONORMAL_TOLERANCE: f64 = 1e-3;

/// Why 16 numbers are not a rigid transform.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NotRigid {
    /// An entry is NaN or infinite.
    #[error("entry {0} is not a finite number")]
    NotFinite(usize),
    /// The last row is not `0 0 0 1`.
    #[error("the last row is not 0 0 0 1")]
    LastRow,
    /// The upper left block is not a right-handed rotation.
    #[error("the upper left 3 x 3 block is not a rotation (error {0:.2e})")]
    NotRotation(f64),
}

/// The 16 row-major numbers of a rigid transform.
pub fn to_row_major(to_from: &Isometry3<f64>) -> [f64; 16] {
    let matrix = to_from.to_homogeneous();
    std::array::from_fn(|i| matrix[(i / 4, i % 4)])
}

/// A rigid transform from its 16 row-major numbers; slightly non-orthonormal rotations (text round trips) are projected.
///
/// # Errors
/// [`NotRigid`] when an entry is not finite, the last row is wrong, or the rotation block is further than
/// [`ORTHONORMAL_TOLERANCE`] from a rotation.
pub fn from_row_major(entries: &[f64; 16]) -> Result<Isometry3<f64>, NotRigid> {
    if let Some(i) = entries.iter().position(|v| !v.is_finite()) {
        return Err(NotRigid::NotFinite(i));
    }
    let matrix = Matrix4::from_row_slice(entries);
    if (matrix.row(3) - nalgebra::RowVector4::new(0.0, 0.0, 0.0, 1.0)).amax() > 1e-6 {
        return Err(NotRigid::LastRow);
    }
    let block = matrix.fixed_view::<3, 3>(0, 0).into_owned();
    let error = (block * block.transpose() - nalgebra::Matrix3::identity()).amax();
    if error > ORTHONORMAL_TOLERANCE || block.determinant() < 0.0 {
        return Err(NotRigid::NotRotation(error));
    }
    let rotation = Rotation3::from_matrix_eps(&block, 1e-12, 100, Rotation3::from_matrix_unchecked(block));
    Ok(Isometry3::from_parts(
        Translation3::new(matrix[(0, 3)], matrix[(1, 3)], matrix[(2, 3)]),
        UnitQuaternion::from_rotation_matrix(&rotation),
    ))
}

/// The motion that a candidate stands for: turn by `yaw_rad` about world z through `centroid`, then carry `centroid` to `target`.
///
/// `x' = R_z(yaw) (x − centroid) + target`, paper section 2 (the operator ⊕), yaw counter-clockwise seen from above.
pub fn placed_from_observed(centroid: &Point3<f64>, target: &Point3<f64>, yaw_rad: f64) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
    Isometry3::from_parts(Translation3::from(target.coords - rotation * centroid.coords), rotation)
}

/// How far a body has tipped between two poses, radians from 0 to π: the angle between the directions that were up to it. A turn about the vertical is none,
/// however the body lies.
pub fn tilt(world_from_before: &Isometry3<f64>, world_from_after: &Isometry3<f64>) -> f64 {
    let up = |pose: &Isometry3<f64>| pose.rotation.inverse() * Vector3::z();
    up(world_from_before).angle(&up(world_from_after))
}

/// The yaw of a transform: the turn about z of its rotation's swing–twist split, radians in (−π, π].
pub fn yaw_of(to_from: &Isometry3<f64>) -> f64 {
    let q = to_from.rotation.quaternion();
    wrap_angle(2.0 * q.k.atan2(q.w))
}

/// An angle brought into (−π, π].
pub fn wrap_angle(angle_rad: f64) -> f64 {
    let wrapped = angle_rad.rem_euclid(std::f64::consts::TAU);
    if wrapped > std::f64::consts::PI { wrapped - std::f64::consts::TAU } else { wrapped }
}

/// A camera's or a tool's pose from where it is, what it looks at, and which way is up: z forward, x right, y down (OpenCV).
///
/// `up` must not be parallel to the line of sight.
pub fn look_at(eye: &Point3<f64>, target: &Point3<f64>, up: &Vector3<f64>) -> Isometry3<f64> {
    let forward = (target - eye).normalize();
    let right = forward.cross(up).normalize();
    let down = forward.cross(&right);
    let rotation = Rotation3::from_matrix_unchecked(nalgebra::Matrix3::from_columns(&[right, down, forward]));
    Isometry3::from_parts(Translation3::from(eye.coords), UnitQuaternion::from_rotation_matrix(&rotation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn row_major_round_trips(r in -3.0..3.0f64, p in -1.5..1.5f64, y in -3.0..3.0f64, t in prop::array::uniform3(-2.0..2.0f64)) {
            let original = Isometry3::from_parts(Translation3::new(t[0], t[1], t[2]), UnitQuaternion::from_euler_angles(r, p, y));
            let back = from_row_major(&to_row_major(&original)).unwrap();
            prop_assert!((back.to_homogeneous() - original.to_homogeneous()).amax() < 1e-9);
        }

        #[test]
        fn a_placement_carries_the_centroid_to_the_target_and_turns_by_the_yaw(
            c in prop::array::uniform3(-1.0..1.0f64), t in prop::array::uniform3(-1.0..1.0f64), yaw in -3.1..3.1f64,
        ) {
            let (centroid, target) = (Point3::from(c), Point3::from(t));
            let motion = placed_from_observed(&centroid, &target, yaw);
            prop_assert!((motion * centroid - target).norm() < 1e-12);
            prop_assert!(wrap_angle(yaw_of(&motion) - yaw).abs() < 1e-9);
        }
    }

    #[test]
    fn what_rolls_over_tips_and_what_turns_about_the_vertical_does_not_however_it_lies() {
        let turn = |axis: Vector3<f64>, angle: f64| Isometry3::rotation(axis * angle);
        let lies = turn(Vector3::x(), std::f64::consts::FRAC_PI_2);
        for stands in [Isometry3::identity(), lies] {
            assert!(tilt(&stands, &(turn(Vector3::z(), 0.5) * stands)) < 1e-9);
            assert!((tilt(&stands, &(turn(Vector3::y(), 0.5) * stands)) - 0.5).abs() < 1e-9);
        }
        // About its own axis, which is level.
        assert!((tilt(&lies, &(lies * turn(Vector3::z(), 1.5))) - 1.5).abs() < 1e-9);
    }

    #[test]
    fn what_is_not_rigid_is_refused() {
        let mut entries = to_row_major(&Isometry3::identity());
        entries[5] = f64::NAN;
        assert_eq!(from_row_major(&entries), Err(NotRigid::NotFinite(5)));
        let mut entries = to_row_major(&Isometry3::identity());
        entries[0] = 2.0;
        assert!(matches!(from_row_major(&entries), Err(NotRigid::NotRotation(_))));
        let mut entries = to_row_major(&Isometry3::identity());
        entries[0] = -1.0;
        assert!(matches!(from_row_major(&entries), Err(NotRigid::NotRotation(_))), "mirrors are not rotations");
        let mut entries = to_row_major(&Isometry3::identity());
        entries[15] = 0.5;
        assert_eq!(from_row_major(&entries), Err(NotRigid::LastRow));
    }

    #[test]
    fn what_is_rigid_on_the_wire_is_rigid_here() {
        // Its first column is too long by 0.12 %, of which each row has a third.
        let [third, half, sixth] = [3.0f64, 2.0, 6.0].map(|n| n.sqrt().recip());
        let with = |long: f64| {
            from_row_major(&[long, half, sixth, 0.1, long, -half, sixth, 0.2, long, 0.0, -2.0 * sixth, 0.3, 0.0, 0.0, 0.0, 1.0])
        };
        let pose = with(1.0012 * third).unwrap();
        assert!((pose.rotation * Vector3::x() - Vector3::repeat(third)).norm() < 1e-3);
        // So long that the rows show it.
        assert!(matches!(with(1.0032 * third), Err(NotRigid::NotRotation(_))));
    }

    #[test]
    fn a_camera_that_looks_at_a_point_sees_it_straight_ahead() {
        let world_from_camera = look_at(&Point3::new(1.0, -0.5, 0.8), &Point3::origin(), &Vector3::z());
        let in_camera = world_from_camera.inverse() * Point3::origin();
        assert!(in_camera.x.abs() < 1e-12 && in_camera.y.abs() < 1e-12 && in_camera.z > 0.0);
        let above = world_from_camera.inverse() * Point3::new(0.0, 0.0, 0.1);
        assert!(above.y < 0.0, "up in the world is up in the picture (y grows downwards)");
    }
}
