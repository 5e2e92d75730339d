//! Numerical inverse kinematics: joint angles that put the grasp centre at a pose.
//!
//! Levenberg–Marquardt on the six pose errors with the damped pseudo-inverse `Jᵀ(JJᵀ + λI)⁻¹`, angles kept within the limits at every step.
//! One start can end in a limit or a local minimum; so the given start is tried first and then seeded random ones.

use nalgebra::{Isometry3, Matrix6, Rotation3, UnitQuaternion, Vector6};
use rand::RngExt;
use rand_pcg::Pcg64;

use crate::{JOINT_COUNT, Joints, LIMITS, LinkFrames};

/// How hard to try, and what counts as there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InverseSettings {
    /// Largest distance of the grasp centre from the target, metres. Default 1e-7.
    pub position_tolerance_m: f64,
    /// Largest turn of the hand from the target, radians. Default 1e-7.
    pub rotation_tolerance_rad: f64,
    /// How far from the position limits a solution stays, radians. Default 0.01.
    pub limit_margin_rad: f64,
    /// Steps from one start. More helps near singular poses and costs time where nothing helps. Default 60.
    pub iterations: usize,
    /// Random starts after the given one. Default 12.
    pub restarts: usize,
    /// How much one radian of turn weighs against one metre of distance. Default 0.3.
    pub rotation_weight_m: f64,
}

impl Default for InverseSettings {
    fn default() -> Self {
        Self {
            position_tolerance_m: 1e-7,
            rotation_tolerance_rad: 1e-7,
            limit_margin_rad: 0.01,
            iterations: 60,
            restarts: 12,
            rotation_weight_m: 0.3,
        }
    }
}

/// Why there are no joint angles.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum InverseError {
    /// A number of the target or the start is NaN or infinite.
    #[error("the target or the start is not finite")]
    NotFinite,
    /// No start led there: the pose is likely out of reach.
    #[error("no joint angles found after {starts} starts; the best is {position_m:.4} m and {rotation_rad:.4} rad away")]
    NotReached {
        /// Starts that were tried.
        starts: usize,
        /// Distance that the best attempt left, metres.
        position_m: f64,
        /// Turn that the best attempt left, radians.
        rotation_rad: f64,
    },
}

/// Joint angles that put the grasp centre at `base_from_tcp`: from `start` first, then from random starts drawn from `rng`.
///
/// # Errors
/// [`InverseError::NotFinite`] on bad numbers, [`InverseError::NotReached`] with what the best attempt left.
pub fn inverse(
    base_from_tcp: &Isometry3<f64>,
    start: &Joints,
    settings: &InverseSettings,
    rng: &mut Pcg64,
) -> Result<Joints, InverseError> {
    let mut best = match inverse_near(base_from_tcp, start, settings) {
        Err(InverseError::NotReached { position_m, rotation_rad, .. }) => (position_m, rotation_rad),
        done => return done,
    };
    for _ in 0..settings.restarts {
        let start = LIMITS.between(&std::array::from_fn(|_| rng.random_range(0.0..1.0)));
        match inverse_near(base_from_tcp, &start, settings) {
            Err(InverseError::NotReached { position_m, rotation_rad, .. }) => {
                let weighted = |(p, r): (f64, f64)| p + settings.rotation_weight_m * r;
                if weighted((position_m, rotation_rad)) < weighted(best) {
                    best = (position_m, rotation_rad);
                }
            }
            done => return done,
        }
    }
    Err(InverseError::NotReached { starts: settings.restarts + 1, position_m: best.0, rotation_rad: best.1 })
}

/// As [`inverse`], from the one start only: the way to follow a path, where a jump to another branch would be wrong.
///
/// # Errors
/// As [`inverse`].
pub fn inverse_near(base_from_tcp: &Isometry3<f64>, start: &Joints, settings: &InverseSettings) -> Result<Joints, InverseError> {
    let finite = base_from_tcp.to_homogeneous().iter().chain(start).all(|v| v.is_finite());
    if !finite {
        return Err(InverseError::NotFinite);
    }
    let target = Target { base_from_tcp, rotation: base_from_tcp.rotation.to_rotation_matrix(), weight: settings.rotation_weight_m };
    let mut joints = LIMITS.clamped(start, settings.limit_margin_rad);
    let mut frames = LinkFrames::at(&joints);
    let mut error = target.error(&frames);
    let mut damping = 1e-3;
    for _ in 0..settings.iterations {
        if target.reached(&error, settings) {
            return Ok(joints);
        }
        let stepped = target.step(&joints, &frames, &error, damping, settings.limit_margin_rad);
        let stepped_frames = LinkFrames::at(&stepped);
        let stepped_error = target.error(&stepped_frames);
        if stepped_error.norm_squared() < error.norm_squared() {
            (joints, frames, error) = (stepped, stepped_frames, stepped_error);
            damping = (damping * 0.2).max(1e-12);
        } else {
            damping *= 8.0;
            if damping > 1e3 {
                break;
            }
        }
    }
    if target.reached(&error, settings) {
        return Ok(joints);
    }
    let (position_m, rotation_rad) = target.residual(&error);
    Err(InverseError::NotReached { starts: 1, position_m, rotation_rad })
}

struct Target<'a> {
    base_from_tcp: &'a Isometry3<f64>,
    rotation: Rotation3<f64>,
    weight: f64,
}

impl Target<'_> {
    /// Distance left (x y z, metres), then turn left (rotation vector, weighted), both in the base frame.
    fn error(&self, frames: &LinkFrames) -> Vector6<f64> {
        let tcp = frames.tcp();
        let position = self.base_from_tcp.translation.vector - tcp.origin;
        let turn = Rotation3::from_matrix_unchecked(self.rotation.matrix() * tcp.rotation.transpose());
        let turn = UnitQuaternion::from_rotation_matrix(&turn).scaled_axis() * self.weight;
        Vector6::new(position.x, position.y, position.z, turn.x, turn.y, turn.z)
    }

    fn residual(&self, error: &Vector6<f64>) -> (f64, f64) {
        (error.fixed_rows::<3>(0).norm(), error.fixed_rows::<3>(3).norm() / self.weight)
    }

    fn reached(&self, error: &Vector6<f64>, settings: &InverseSettings) -> bool {
        let (position_m, rotation_rad) = self.residual(error);
        position_m <= settings.position_tolerance_m && rotation_rad <= settings.rotation_tolerance_rad
    }

    fn step(&self, joints: &Joints, frames: &LinkFrames, error: &Vector6<f64>, damping: f64, margin_rad: f64) -> Joints {
        let mut jacobian = frames.jacobian_of(&frames.tcp().origin);
        jacobian.fixed_rows_mut::<3>(3).scale_mut(self.weight);
        // A joint that stands at a limit and would be pushed through it takes no part, so that the others do its share.
        for _ in 0..2 {
            let square: Matrix6<f64> = jacobian * jacobian.transpose() + Matrix6::identity() * damping;
            let Some(factor) = square.cholesky() else { return *joints };
            let change = jacobian.transpose() * factor.solve(error);
            let stepped: Joints = std::array::from_fn(|i| joints[i] + change[i].clamp(-0.5, 0.5));
            let clamped = LIMITS.clamped(&stepped, margin_rad);
            let stuck: Vec<usize> = (0..JOINT_COUNT).filter(|&i| clamped[i] == joints[i] && stepped[i] != joints[i]).collect();
            if stuck.is_empty() {
                return clamped;
            }
            stuck.into_iter().for_each(|i| jacobian.column_mut(i).fill(0.0));
        }
        let square: Matrix6<f64> = jacobian * jacobian.transpose() + Matrix6::identity() * damping;
        let Some(factor) = square.cholesky() else { return *joints };
        let change = jacobian.transpose() * factor.solve(error);
        LIMITS.clamped(&std::array::from_fn(|i| joints[i] + change[i].clamp(-0.5, 0.5)), margin_rad)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{READY, base_from_tcp};
    use proptest::prelude::*;
    use rand::SeedableRng;

    proptest! {
        #[test]
        fn a_pose_that_the_arm_can_take_is_found_again(u in prop::array::uniform7(0.02..0.98f64), seed in 0u64..1000) {
            let target = base_from_tcp(&LIMITS.between(&u));
            let settings = InverseSettings { restarts: 60, ..InverseSettings::default() };
            let found = inverse(&target, &READY, &settings, &mut Pcg64::seed_from_u64(seed)).unwrap();
            prop_assert!(LIMITS.contains(&found, 0.0));
            let reached = base_from_tcp(&found);
            prop_assert!((reached.translation.vector - target.translation.vector).norm() < 1e-6);
            prop_assert!(reached.rotation.angle_to(&target.rotation) < 1e-6);
        }
    }

    #[test]
    fn a_pose_out_of_reach_is_refused_with_what_was_left() {
        let target = Isometry3::translation(2.0, 0.0, 0.5);
        let error = inverse(&target, &READY, &InverseSettings::default(), &mut Pcg64::seed_from_u64(1)).unwrap_err();
        let InverseError::NotReached { starts, position_m, .. } = error else { panic!("{error}") };
        assert_eq!(starts, 13);
        assert!(position_m > 0.8, "{error}");
    }

    #[test]
    fn the_same_seed_gives_the_same_angles() {
        let target = base_from_tcp(&[1.0, 0.5, -1.0, -2.0, 0.3, 2.0, -0.5]);
        let solve = || inverse(&target, &READY, &InverseSettings::default(), &mut Pcg64::seed_from_u64(7));
        assert_eq!(solve(), solve());
    }

    #[test]
    fn bad_numbers_are_refused() {
        let target = Isometry3::translation(f64::NAN, 0.0, 0.5);
        assert_eq!(inverse_near(&target, &READY, &InverseSettings::default()), Err(InverseError::NotFinite));
    }
}
