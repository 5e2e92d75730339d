//! Paths through joint space as lists of corners, and the free space that they are looked for in.

use repose_panda::{JOINT_COUNT, JointLimits, Joints};

use crate::collision::CollisionChecker;

/// What searches and simplifications ask.
pub trait FreeSpace {
    /// The position limits: whatever is drawn at random lies within them.
    fn limits(&self) -> &JointLimits;
    /// Whether a configuration is free and within the limits.
    fn is_free(&self, joints: &Joints) -> bool;
    /// Whether the straight edge between two configurations within the limits is free, both ends included.
    fn edge_is_free(&self, from: &Joints, to: &Joints) -> bool;
}

impl FreeSpace for CollisionChecker<'_> {
    fn limits(&self) -> &JointLimits {
        Self::limits(self)
    }

    fn is_free(&self, joints: &Joints) -> bool {
        Self::is_free(self, joints)
    }

    fn edge_is_free(&self, from: &Joints, to: &Joints) -> bool {
        Self::edge_is_free(self, from, to)
    }
}

/// Euclidean distance in joint space, radians.
pub fn distance(a: &Joints, b: &Joints) -> f64 {
    (0..JOINT_COUNT).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

/// The configuration at `fraction` of the way from `a` to `b`.
pub fn between(a: &Joints, b: &Joints, fraction: f64) -> Joints {
    std::array::from_fn(|i| a[i] + fraction * (b[i] - a[i]))
}

/// Length of a path, radians.
pub fn length(path: &[Joints]) -> f64 {
    path.windows(2).map(|w| distance(&w[0], &w[1])).sum()
}

/// A free space that is asked in small steps: the tests' stand-in for a checker.
#[cfg(test)]
pub(crate) struct Sampled<F>(pub F);

#[cfg(test)]
impl<F: Fn(&Joints) -> bool> FreeSpace for Sampled<F> {
    fn limits(&self) -> &JointLimits {
        &repose_panda::LIMITS
    }

    fn is_free(&self, joints: &Joints) -> bool {
        (self.0)(joints)
    }

    fn edge_is_free(&self, from: &Joints, to: &Joints) -> bool {
        let steps = (distance(from, to) / 0.005).ceil().max(1.0);
        (0..=steps as usize).all(|k| (self.0)(&between(from, to, k as f64 / steps)))
    }
}
