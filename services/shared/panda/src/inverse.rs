//! Analytic inverse kinematics: every set of joint angles that puts the grasp centre at a pose.
//!
//! The arm has one joint more than a pose needs, so the angle of the last one is given and the rest follows from two triangles. With the last
//! joint fixed the wrist's place is known; the distance from shoulder to wrist gives the elbow (two ways to bend it), the shoulder's
//! component along the forearm gives joint 6 (two ways), and the axis of the upper arm gives the shoulder (two ways): at most eight solutions.
//! The choice of the redundant angle and the decomposition are those of He and Liu, "Analytical Inverse Kinematics for Franka Emika Panda"
//! (2021); the equations here are derived from the Denavit–Hartenberg table of [`crate::kinematics`].

use std::f64::consts::{PI, TAU};

use nalgebra::{Isometry3, Matrix3, Vector3};

use crate::kinematics::{ELBOW_OFFSET_M, FLANGE_M, FOREARM_M, HAND_TURN_RAD, SHOULDER_M, TCP_M, UPPER_ARM_M, WRIST_OFFSET_M};
use crate::{JOINT_COUNT, JointLimits, Joints, LIMITS};

/// Which solutions count, and how finely the redundant angle is swept.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InverseSettings {
    /// The limits that a solution keeps.
    pub limits: JointLimits,
    /// How far from the position limits it stays, radians. Default 0.01.
    pub limit_margin_rad: f64,
    /// Angles of the last joint that a sweep tries. More finds postures in narrower places and costs about a microsecond each. Default 32.
    pub sweep: usize,
}

impl Default for InverseSettings {
    fn default() -> Self {
        Self { limits: LIMITS, limit_margin_rad: 0.01, sweep: 32 }
    }
}

/// Why there are no joint angles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum InverseError {
    /// A number of the target or the start is NaN or infinite.
    #[error("the target or the start is not finite")]
    NotFinite,
    /// No joint angles within the limits lead there.
    #[error("the pose is out of reach within the joint limits")]
    NotReached,
}

/// The joint angles within the limits that put the grasp centre at `base_from_tcp` with the last joint at `last_rad`: at most eight.
///
/// Empty when the pose is out of reach or a number is not finite. In a singular posture (upper arm along the base's axis, shoulder on the
/// forearm's axis) one joint of a continuum is returned.
pub fn inverse_at(base_from_tcp: &Isometry3<f64>, last_rad: f64, settings: &InverseSettings) -> Vec<Joints> {
    let mut found = Vec::with_capacity(8);
    solve(base_from_tcp, last_rad, &mut |joints| {
        if let Some(joints) = within_limits(&joints, settings) {
            found.push(joints);
        }
    });
    found
}

/// The solutions for `settings.sweep` angles of the last joint, evenly over its range; in the order of that angle.
pub fn inverse_sweep(base_from_tcp: &Isometry3<f64>, settings: &InverseSettings) -> Vec<Joints> {
    let low = settings.limits.position_lower_rad[JOINT_COUNT - 1] + settings.limit_margin_rad;
    let high = settings.limits.position_upper_rad[JOINT_COUNT - 1] - settings.limit_margin_rad;
    let angle = |k: usize| low + (high - low) * (k as f64 + 0.5) / settings.sweep as f64;
    (0..settings.sweep).flat_map(|k| inverse_at(base_from_tcp, angle(k), settings)).collect()
}

/// The solution nearest to `near` that keeps its last joint: the way to follow a path of the hand without a jump to another branch.
///
/// # Errors
/// [`InverseError::NotFinite`] on bad numbers, [`InverseError::NotReached`] when there is no solution with that last joint.
pub fn inverse_near(base_from_tcp: &Isometry3<f64>, near: &Joints, settings: &InverseSettings) -> Result<Joints, InverseError> {
    let finite = base_from_tcp.to_homogeneous().iter().chain(near).all(|v| v.is_finite());
    if !finite {
        return Err(InverseError::NotFinite);
    }
    let apart = |joints: &Joints| (0..JOINT_COUNT).map(|i| (joints[i] - near[i]).powi(2)).sum::<f64>();
    let found = inverse_at(base_from_tcp, near[JOINT_COUNT - 1], settings);
    found.into_iter().min_by(|a, b| apart(a).total_cmp(&apart(b))).ok_or(InverseError::NotReached)
}

/// How far a cosine may leave −1 to 1 by rounding.
const ROUNDING: f64 = 1e-12;
/// Below this a direction is lost in rounding, metres.
const VANISHING_M: f64 = 1e-9;

fn acos(cosine: f64) -> Option<f64> {
    (cosine.abs() <= 1.0 + ROUNDING).then(|| cosine.clamp(-1.0, 1.0).acos())
}

/// The wrist's place as a pose and a last angle give it.
struct Wrist {
    /// Axes of frame 6 in the base frame.
    axes: Matrix3<f64>,
    /// From the wrist to the shoulder, in the base frame.
    to_shoulder: Vector3<f64>,
}

fn solve(base_from_tcp: &Isometry3<f64>, last_rad: f64, found: &mut impl FnMut(Joints)) {
    let rotation = base_from_tcp.rotation.to_rotation_matrix().into_inner();
    let approach = rotation.column(2).into_owned();
    // Frame 6 in the pose: back along the approach, then against the turns of the hand and the last joint.
    let (sin, cos) = (-(HAND_TURN_RAD + last_rad)).sin_cos();
    let link = rotation.column(0) * cos + rotation.column(1) * sin;
    let side = rotation.column(1) * cos - rotation.column(0) * sin;
    let wrist = base_from_tcp.translation.vector - approach * (TCP_M + FLANGE_M) - link * WRIST_OFFSET_M;
    // Frame 7 is frame 6 turned by a right angle about x: its y is frame 6's z, its z against frame 6's y.
    let axes = Matrix3::from_columns(&[link, -approach, side]);
    let wrist = Wrist { axes, to_shoulder: Vector3::new(0.0, 0.0, SHOULDER_M) - wrist };
    if !wrist.to_shoulder.iter().all(|v| v.is_finite()) {
        return;
    }
    // From the elbow to the shoulder and to the wrist, in the elbow's plane: x along the offset, y along upper arm and forearm.
    let (upper, fore) = (UPPER_ARM_M.hypot(ELBOW_OFFSET_M), FOREARM_M.hypot(ELBOW_OFFSET_M));
    let cosine = (upper * upper + fore * fore - wrist.to_shoulder.norm_squared()) / (2.0 * upper * fore);
    let Some(opening) = acos(cosine) else { return };
    let straight = (-UPPER_ARM_M).atan2(-ELBOW_OFFSET_M) - FOREARM_M.atan2(-ELBOW_OFFSET_M);
    for elbow in [straight + opening, straight - opening] {
        with_elbow(&wrist, elbow, last_rad, found);
    }
}

fn with_elbow(wrist: &Wrist, elbow: f64, last_rad: f64, found: &mut impl FnMut(Joints)) {
    let (sin, cos) = elbow.sin_cos();
    // From the wrist to the shoulder in frame 4's x and y; y is the forearm's axis.
    let across = ELBOW_OFFSET_M - ELBOW_OFFSET_M * cos - UPPER_ARM_M * sin;
    let along = -FOREARM_M + ELBOW_OFFSET_M * sin - UPPER_ARM_M * cos;
    // The forearm's axis lies in frame 6's x-y plane, at the angle that gives the shoulder this component.
    let shoulder = wrist.axes.tr_mul(&wrist.to_shoulder);
    let Some(half) = acos(along / shoulder.x.hypot(shoulder.y)) else { return };
    let middle = shoulder.x.atan2(shoulder.y);
    for bend in [middle + half, middle - half] {
        let forearm = wrist.axes * Vector3::new(bend.sin(), bend.cos(), 0.0);
        let rest = wrist.to_shoulder - forearm * along;
        // Where the shoulder lies on the forearm's axis the elbow may be anywhere around it.
        let elbow_x = if rest.norm() > VANISHING_M { rest.normalize() * across.signum() } else { wrist.axes.column(2).into_owned() };
        let elbow_z = elbow_x.cross(&forearm);
        // Joint 5 turns from frame 4's x to frame 5's, which is square to the axes of joints 5 and 6.
        let x = forearm.cross(&wrist.axes.column(2));
        let forearm_turn = (-x.dot(&elbow_z)).atan2(x.dot(&elbow_x));
        let arm_axis = elbow_x * sin + forearm * cos;
        let arm_x = elbow_x * cos - forearm * sin;
        let tilt = arm_axis.x.hypot(arm_axis.y);
        let turn = if tilt > ROUNDING { arm_axis.y.atan2(arm_axis.x) } else { 0.0 };
        for (base, lean) in [(turn, tilt.atan2(arm_axis.z)), (turn + PI, -tilt.atan2(arm_axis.z))] {
            let around = Vector3::new(base.cos() * lean.cos(), base.sin() * lean.cos(), -lean.sin());
            let across = Vector3::new(-base.sin(), base.cos(), 0.0);
            let arm_turn = arm_x.dot(&across).atan2(arm_x.dot(&around));
            found([base, lean, arm_turn, elbow, forearm_turn, bend, last_rad]);
        }
    }
}

/// The angles brought into the limits by whole turns (no joint's range has more than one).
fn within_limits(joints: &Joints, settings: &InverseSettings) -> Option<Joints> {
    let limits = &settings.limits;
    let wrapped = std::array::from_fn(|i| {
        let middle = 0.5 * (limits.position_lower_rad[i] + limits.position_upper_rad[i]);
        joints[i] - TAU * ((joints[i] - middle) / TAU).round()
    });
    limits.contains(&wrapped, settings.limit_margin_rad).then_some(wrapped)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{READY, base_from_tcp};
    use proptest::prelude::*;
    use std::f64::consts::FRAC_PI_2;

    fn settings() -> InverseSettings {
        InverseSettings { limit_margin_rad: 0.0, ..InverseSettings::default() }
    }

    fn reaches(joints: &Joints, target: &Isometry3<f64>) -> bool {
        off(joints, target) < 1e-6
    }

    /// How far the joints miss the pose, metres or radians, whichever is more.
    fn off(joints: &Joints, target: &Isometry3<f64>) -> f64 {
        let reached = base_from_tcp(joints);
        let missing = target.rotation * reached.rotation.inverse();
        let apart = target.translation.vector - reached.translation.vector;
        // Not `angle`: it is the arc cosine of a number next to one.
        apart.norm().max(missing.imag().norm() * 2.0)
    }

    fn joints() -> impl Strategy<Value = Joints> {
        prop::array::uniform7(0.0001..0.9999f64).prop_map(|u| LIMITS.between(&u))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]

        #[test]
        fn every_solution_reaches_the_pose_and_the_angles_it_came_from_are_among_them(joints in joints()) {
            let target = base_from_tcp(&joints);
            let solutions = inverse_at(&target, joints[6], &settings());
            prop_assert!(solutions.iter().all(|q| LIMITS.contains(q, 0.0) && q[6] == joints[6]));
            prop_assert!(solutions.iter().all(|q| reaches(q, &target)), "{solutions:?}");
            let apart = |q: &Joints| (0..JOINT_COUNT).map(|i| (q[i] - joints[i]).abs()).fold(0.0, f64::max);
            let nearest = solutions.iter().map(apart).fold(f64::INFINITY, f64::min);
            prop_assert!(nearest < 1e-5, "{nearest} from {joints:?}");
        }

        #[test]
        fn the_nearest_solution_follows_a_small_motion(joints in joints(), step in prop::array::uniform6(-1e-5..1e-5f64)) {
            let apart = Isometry3::new(Vector3::new(step[0], step[1], step[2]), Vector3::new(step[3], step[4], step[5]));
            let target = base_from_tcp(&joints) * apart;
            if let Ok(found) = inverse_near(&target, &joints, &settings()) {
                prop_assert!(reaches(&found, &target));
            }
        }
    }

    proptest! {
        #[test]
        fn a_sweep_reaches_the_pose_with_many_postures(joints in joints()) {
            let target = base_from_tcp(&joints);
            let sweep = inverse_sweep(&target, &InverseSettings { sweep: 200, ..settings() });
            prop_assert!(sweep.iter().all(|q| LIMITS.contains(q, 0.0) && reaches(q, &target)));
        }

        #[test]
        fn no_numeric_search_ends_on_a_solution_that_is_not_listed(joints in joints(), other in joints()) {
            // Newton steps from elsewhere with the last joint held: where they converge, the analytic solution must be there.
            let target = base_from_tcp(&joints);
            let mut q: Joints = std::array::from_fn(|i| if i == 6 { joints[6] } else { other[i] });
            for _ in 0..60 {
                let reached = base_from_tcp(&q);
                let mut error = nalgebra::Vector6::zeros();
                error.fixed_rows_mut::<3>(0).copy_from(&(target.translation.vector - reached.translation.vector));
                error.fixed_rows_mut::<3>(3).copy_from(&(target.rotation * reached.rotation.inverse()).scaled_axis());
                let square = crate::jacobian(&q).fixed_view::<6, 6>(0, 0).into_owned();
                let Some(step) = (square.tr_mul(&square) + nalgebra::Matrix6::identity() * 1e-9).try_inverse().map(|m| m * square.tr_mul(&error)) else { break };
                (0..6).for_each(|i| q[i] += step[i].clamp(-0.3, 0.3));
            }
            // Next to a singular posture joints may be far from a solution and hardly miss the pose: only what converged counts.
            if off(&q, &target) < 1e-10 {
                let Some(q) = within_limits(&q, &settings()) else { return Ok(()) };
                let solutions = inverse_at(&target, joints[6], &settings());
                let apart = |s: &Joints| (0..JOINT_COUNT).map(|i| (q[i] - s[i]).abs()).fold(0.0, f64::max);
                prop_assert!(solutions.iter().map(apart).fold(f64::INFINITY, f64::min) < 1e-2 || !LIMITS.contains(&q, 1e-3));
            }
        }
    }

    #[test]
    fn a_pose_in_the_middle_of_the_workspace_has_many_postures() {
        let target = base_from_tcp(&READY);
        let near = inverse_near(&target, &READY, &settings()).unwrap();
        assert!((0..JOINT_COUNT).all(|i| (near[i] - READY[i]).abs() < 1e-9));
        let sweep = inverse_sweep(&target, &settings());
        assert!(sweep.len() > 20, "{}", sweep.len());
        assert!(sweep.iter().any(|q| q[1] > 0.0) && sweep.iter().any(|q| q[1] < 0.0), "the shoulder leans both ways");
    }

    #[test]
    fn the_upper_arm_along_the_base_axis_still_has_a_solution() {
        let upright = [0.4, 0.0, -0.3, -FRAC_PI_2, 0.2, 1.7, 0.5];
        let target = base_from_tcp(&upright);
        let solutions = inverse_at(&target, 0.5, &settings());
        assert!(!solutions.is_empty() && solutions.iter().all(|q| reaches(q, &target)));
    }

    #[test]
    fn a_pose_out_of_reach_and_bad_numbers_are_refused() {
        let far = Isometry3::translation(2.0, 0.0, 0.5);
        assert!(inverse_sweep(&far, &settings()).is_empty());
        assert_eq!(inverse_near(&far, &READY, &settings()), Err(InverseError::NotReached));
        let bad = Isometry3::translation(f64::NAN, 0.0, 0.5);
        assert!(inverse_sweep(&bad, &settings()).is_empty());
        assert_eq!(inverse_near(&bad, &READY, &settings()), Err(InverseError::NotFinite));
    }
}
