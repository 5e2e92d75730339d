//! An object between the fingers: its observed points, each a small ball, fixed to the grasp centre.

use nalgebra::{Isometry3, Point3, Vector3};

/// The points of the object in the hand, in the frame of the grasp centre.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldCloud {
    pub(super) points_in_tcp: Vec<Vector3<f64>>,
    pub(super) radius_m: f64,
}

impl HeldCloud {
    /// The object whose points (world frame, already thinned) are held by a hand at `world_from_tcp`; each stands for a ball of `radius_m`.
    pub fn new(points_in_world: &[Point3<f32>], world_from_tcp: &Isometry3<f64>, radius_m: f64) -> Self {
        let tcp_from_world = world_from_tcp.inverse();
        Self { points_in_tcp: points_in_world.iter().map(|p| (tcp_from_world * p.cast::<f64>()).coords).collect(), radius_m }
    }
}
