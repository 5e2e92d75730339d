//! Forward kinematics and the geometric Jacobian.
//!
//! Modified (Craig) Denavit–Hartenberg parameters as Franka documents them (frankaemika/docs, `control_parameters.rst`): joint `i` turns by
//! `θᵢ` about the z axis of frame `i`, and `frame(i−1) from frame(i) = Rot_x(α) · Trans_x(a) · Rot_z(θ) · Trans_z(d)`. All `α` are multiples
//! of a right angle, so the table holds their exact sines and cosines. The hand's offsets are those of Franka's own description.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, SMatrix, Translation3, UnitQuaternion, Vector3};

use crate::{JOINT_COUNT, Joints};

/// Height of the shoulder over the base, metres.
pub const SHOULDER_M: f64 = 0.333;
/// From the shoulder along the upper arm to the elbow, metres.
pub const UPPER_ARM_M: f64 = 0.316;
/// From the elbow along the forearm to the wrist, metres.
pub const FOREARM_M: f64 = 0.384;
/// How far the elbow's axis stands off from upper arm and forearm, metres.
pub const ELBOW_OFFSET_M: f64 = 0.0825;
/// From the wrist to the last joint's axis, metres.
pub const WRIST_OFFSET_M: f64 = 0.088;
/// Distance of the flange from the last joint's frame, along z, metres.
pub const FLANGE_M: f64 = 0.107;
/// Distance of the grasp centre from the hand's frame, along z, metres.
pub const TCP_M: f64 = 0.1034;
/// Turn of the hand about the flange's z axis, radians.
pub const HAND_TURN_RAD: f64 = -std::f64::consts::FRAC_PI_4;

/// Rows: linear velocity x y z, then angular velocity x y z (base frame). Columns: joints.
pub type Jacobian = SMatrix<f64, 6, JOINT_COUNT>;

struct DhRow {
    a_m: f64,
    d_m: f64,
    cos_alpha: f64,
    sin_alpha: f64,
}

const fn row(a_m: f64, d_m: f64, cos_alpha: f64, sin_alpha: f64) -> DhRow {
    DhRow { a_m, d_m, cos_alpha, sin_alpha }
}

const DH: [DhRow; JOINT_COUNT] = [
    row(0.0, SHOULDER_M, 1.0, 0.0),
    row(0.0, 0.0, 0.0, -1.0),
    row(0.0, UPPER_ARM_M, 0.0, 1.0),
    row(ELBOW_OFFSET_M, 0.0, 0.0, 1.0),
    row(-ELBOW_OFFSET_M, FOREARM_M, 0.0, -1.0),
    row(0.0, 0.0, 0.0, 1.0),
    row(WRIST_OFFSET_M, 0.0, 0.0, 1.0),
];

/// A link's frame as a rotation matrix and an origin, in the base frame: cheaper than quaternions where many points are carried.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkFrame {
    /// Columns are the link's axes in the base frame.
    pub rotation: Matrix3<f64>,
    /// The link's origin in the base frame, metres.
    pub origin: Vector3<f64>,
}

impl LinkFrame {
    /// The base itself.
    pub const BASE: Self =
        Self { rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), origin: Vector3::new(0.0, 0.0, 0.0) };

    /// A point of the link, in the base frame.
    pub fn carry(&self, point_in_link: &Vector3<f64>) -> Point3<f64> {
        Point3::from(self.rotation * point_in_link + self.origin)
    }

    /// The same as a rigid transform, `base_from_link`.
    pub fn isometry(&self) -> Isometry3<f64> {
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(self.rotation));
        Isometry3::from_parts(Translation3::from(self.origin), rotation)
    }

    /// The frame that a rigid transform describes.
    pub fn of(isometry: &Isometry3<f64>) -> Self {
        Self { rotation: isometry.rotation.to_rotation_matrix().into_inner(), origin: isometry.translation.vector }
    }

    fn next(&self, dh: &DhRow, angle_rad: f64) -> Self {
        let (sin, cos) = angle_rad.sin_cos();
        let (x, y, z) = (self.rotation.column(0), self.rotation.column(1), self.rotation.column(2));
        let turned_y = y * dh.cos_alpha + z * dh.sin_alpha;
        let turned_z = z * dh.cos_alpha - y * dh.sin_alpha;
        let rotation = Matrix3::from_columns(&[x * cos + turned_y * sin, turned_y * cos - x * sin, turned_z]);
        Self { rotation, origin: self.origin + x * dh.a_m + turned_z * dh.d_m }
    }
}

/// Where every link is for one set of joint angles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkFrames {
    /// Links 1 to 7 (link 0 is the base), in the base frame.
    pub links: [LinkFrame; JOINT_COUNT],
    /// The hand.
    pub hand: LinkFrame,
}

impl LinkFrames {
    /// The frames at `joints`.
    pub fn at(joints: &Joints) -> Self {
        let mut links = [LinkFrame::BASE; JOINT_COUNT];
        let mut previous = LinkFrame::BASE;
        for ((link, dh), angle) in links.iter_mut().zip(&DH).zip(joints) {
            *link = previous.next(dh, *angle);
            previous = *link;
        }
        let flange = row(0.0, FLANGE_M, 1.0, 0.0);
        Self { links, hand: previous.next(&flange, HAND_TURN_RAD) }
    }

    /// The grasp centre in the base frame.
    pub fn tcp(&self) -> LinkFrame {
        LinkFrame { rotation: self.hand.rotation, origin: self.hand.origin + self.hand.rotation.column(2) * TCP_M }
    }

    /// The Jacobian of a point that is fixed to the last link.
    ///
    /// `point_in_base` is where that point is now. Column `i` is the twist that a unit rate of joint `i` gives it.
    pub fn jacobian_of(&self, point_in_base: &Vector3<f64>) -> Jacobian {
        let mut jacobian = Jacobian::zeros();
        for (i, link) in self.links.iter().enumerate() {
            let axis = link.rotation.column(2).into_owned();
            jacobian.fixed_view_mut::<3, 1>(0, i).copy_from(&axis.cross(&(point_in_base - link.origin)));
            jacobian.fixed_view_mut::<3, 1>(3, i).copy_from(&axis);
        }
        jacobian
    }
}

/// The flange's frame from the hand's.
pub fn flange_from_hand() -> Isometry3<f64> {
    Isometry3::rotation(Vector3::z() * HAND_TURN_RAD)
}

/// The hand's frame from the grasp centre's.
pub fn hand_from_tcp() -> Isometry3<f64> {
    Isometry3::translation(0.0, 0.0, TCP_M)
}

/// Pose of the flange in the base frame.
pub fn base_from_flange(joints: &Joints) -> Isometry3<f64> {
    base_from_hand(joints) * flange_from_hand().inverse()
}

/// Pose of the hand in the base frame.
pub fn base_from_hand(joints: &Joints) -> Isometry3<f64> {
    LinkFrames::at(joints).hand.isometry()
}

/// Pose of the grasp centre in the base frame.
pub fn base_from_tcp(joints: &Joints) -> Isometry3<f64> {
    LinkFrames::at(joints).tcp().isometry()
}

/// The grasp centre's Jacobian in the base frame.
pub fn jacobian(joints: &Joints) -> Jacobian {
    let frames = LinkFrames::at(joints);
    frames.jacobian_of(&frames.tcp().origin)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{LIMITS, READY};
    use proptest::prelude::*;
    use std::f64::consts::FRAC_PI_2;

    /// Any configuration within the position limits.
    fn joints() -> impl Strategy<Value = Joints> {
        prop::array::uniform7(0.0..1.0f64).prop_map(|u| LIMITS.between(&u))
    }

    #[test]
    fn the_arm_stretched_upwards_is_as_high_as_its_links_are_long() {
        let flange = base_from_flange(&[0.0; 7]);
        let expected = Vector3::new(0.088, 0.0, 0.333 + 0.316 + 0.384 - 0.107);
        assert!((flange.translation.vector - expected).norm() < 1e-12);
        assert!((flange.rotation * Vector3::z() + Vector3::z()).norm() < 1e-12, "the flange looks down");
    }

    #[test]
    fn the_ready_pose_is_where_franka_says() {
        let flange = base_from_flange(&READY);
        assert!((flange.translation.vector - Vector3::new(0.306_890_5, 0.0, 0.590_282)).norm() < 1e-5, "{flange}");
        let tcp = base_from_tcp(&READY);
        assert!((tcp.rotation * Vector3::z() + Vector3::z()).norm() < 1e-9, "the hand looks straight down");
        assert!((tcp.rotation * Vector3::y() + Vector3::y()).norm() < 1e-9, "the fingers move along the base's y");
        assert!((flange.translation.vector.z - tcp.translation.vector.z - TCP_M).abs() < 1e-12);
    }

    #[test]
    fn the_elbow_bent_by_a_right_angle_reaches_forward() {
        let flange = base_from_flange(&[0.0, 0.0, 0.0, -FRAC_PI_2, 0.0, FRAC_PI_2, 0.0]);
        let expected = Vector3::new(0.0825 + 0.384 + 0.088, 0.0, 0.333 + 0.316 + 0.0825 - 0.107);
        assert!((flange.translation.vector - expected).norm() < 1e-12, "{flange}");
    }

    #[test]
    fn the_first_joint_turns_everything_about_the_base() {
        let (mut turned, angle) = (READY, 0.7);
        turned[0] += angle;
        let expected = Isometry3::rotation(Vector3::z() * angle) * base_from_tcp(&READY);
        assert!((base_from_tcp(&turned).to_homogeneous() - expected.to_homogeneous()).amax() < 1e-12);
    }

    proptest! {
        #[test]
        fn the_jacobian_equals_finite_differences(joints in joints()) {
            let jacobian = jacobian(&joints);
            const STEP: f64 = 1e-6;
            for i in 0..JOINT_COUNT {
                let (mut low, mut high) = (joints, joints);
                low[i] -= STEP;
                high[i] += STEP;
                let (low, high) = (base_from_tcp(&low), base_from_tcp(&high));
                let linear = (high.translation.vector - low.translation.vector) / (2.0 * STEP);
                let angular = (high.rotation * low.rotation.inverse()).scaled_axis() / (2.0 * STEP);
                prop_assert!((jacobian.fixed_view::<3, 1>(0, i) - linear).amax() < 1e-7);
                prop_assert!((jacobian.fixed_view::<3, 1>(3, i) - angular).amax() < 1e-7);
            }
        }

        #[test]
        fn rotations_stay_orthonormal(joints in joints()) {
            for link in LinkFrames::at(&joints).links {
                prop_assert!((link.rotation.transpose() * link.rotation - Matrix3::identity()).amax() < 1e-12);
            }
        }
    }
}
