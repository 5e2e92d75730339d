//! An object between the fingers: its observed points, each a small ball, fixed to the grasp centre.

use nalgebra::{Isometry3, Point3, Vector3};

/// Points of a held object that share one ball.
pub(super) const HELD_GROUP: usize = 16;

/// The points of the object in the hand, in the frame of the grasp centre.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldCloud {
    pub(super) points_in_tcp: Vec<Vector3<f64>>,
    pub(super) radius_m: f64,
}

/// Points in an order in which near ones follow each other: halved across their longest extent, and the halves likewise.
pub fn neighbouring(mut points: Vec<Point3<f32>>) -> Vec<Point3<f32>> {
    order(&mut points);
    points
}

fn order(points: &mut [Point3<f32>]) {
    if points.len() <= HELD_GROUP {
        return;
    }
    let low = points.iter().fold(Vector3::repeat(f32::INFINITY), |low, p| low.inf(&p.coords));
    let high = points.iter().fold(Vector3::repeat(f32::NEG_INFINITY), |high, p| high.sup(&p.coords));
    let axis = (high - low).imax();
    points.sort_by(|a, b| a[axis].total_cmp(&b[axis]));
    let (first, second) = points.split_at_mut(points.len() / 2);
    order(first);
    order(second);
}

impl HeldCloud {
    /// The object whose points (world frame, already thinned, best [`neighbouring`]) are held by a hand at `world_from_tcp`; each stands for a ball of
    /// `radius_m`.
    pub fn new(points_in_world: &[Point3<f32>], world_from_tcp: &Isometry3<f64>, radius_m: f64) -> Self {
        let tcp_from_world = world_from_tcp.inverse();
        Self { points_in_tcp: points_in_world.iter().map(|p| (tcp_from_world * p.cast::<f64>()).coords).collect(), radius_m }
    }
}
