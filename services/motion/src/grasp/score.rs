//! How good a grasp is: a weighted mean of what is good about it, times what it would fail by.

use nalgebra::{Isometry3, Vector3};
use repose_panda::FINGER_OPENING_MAX_M;

use super::gripper::{self, GripperFit};
use super::{GraspCloud, GraspSettings};

/// Weights of the terms of a grasp's score; each term is between 0 and 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GraspWeights {
    /// An approach from above: the hand leaves a placement the way it came, and a tilted one pulls at what is tall. Default 2.
    pub vertical: f64,
    /// Fingers near the object's middle, which keeps it from turning in the hand. Default 3.
    pub centered: f64,
    /// Pads near the height of the object's middle: what hangs far below them swings, and what they hold there is a neck or a lid. Default 2.
    pub low: f64,
    /// Neither so wide that the opening is used up, nor so thin that a surface may have been taken for a wall. Default 1.5.
    pub fitting: f64,
    /// Surfaces square to the closing direction where the fingers touch. Default 2.
    pub square: f64,
    /// Much surface against the fingers along the approach: little is the shoulder of a bottle or the edge of a lid. Default 1.5.
    pub deep: f64,
    /// Both fingers come down where the camera saw free space, not behind the object. Default 3.
    pub seen: f64,
}

impl Default for GraspWeights {
    fn default() -> Self {
        Self { vertical: 2.0, centered: 3.0, low: 2.0, fitting: 1.5, square: 2.0, deep: 1.5, seen: 3.0 }
    }
}

/// A width from which a grasp is not thin, metres.
const THIN_M: f64 = 0.010;
/// A tilt of the approach at which nothing is left of being from above, radians.
const TILTED_RAD: f64 = 1.2;
/// Height above the object's middle at which nothing is left of being near it, metres.
const FAR_M: f64 = 0.10;
/// Room in the opening that is plenty, and less of which is too little for what is known of the object's place, both fingers', metres.
const ROOM_M: f64 = 0.020;
const NARROW_M: f64 = 0.014;
/// Alignment from which surfaces are told from better ones, and at which none holds: a little beyond the edge of a box taken across its corners.
const SQUARE_MIN: f64 = 0.8;
const SLANTED: f64 = 0.65;
/// Less surface than this along the approach is an edge, metres.
const EDGE_M: f64 = 0.010;

/// How good a grasp is, 0 to 1.
pub fn score(world_from_tcp: &Isometry3<f64>, fit: &GripperFit, object: &GraspCloud, settings: &GraspSettings) -> f64 {
    let weights = &settings.weights;
    let approach = world_from_tcp.rotation * Vector3::z();
    let aside = (world_from_tcp.translation.vector.xy() - object.axis).norm();
    let room_m = FINGER_OPENING_MAX_M - fit.width_m;
    let half_diagonal = 0.5 * f64::from(object.bounds.extent().xy().norm()).max(0.02);
    let terms = [
        (weights.vertical, 1.0 - (-approach.z).clamp(-1.0, 1.0).acos() / TILTED_RAD),
        (weights.centered, 1.0 - aside / half_diagonal),
        (weights.low, 1.0 - (world_from_tcp.translation.z - object.middle_m).abs() / FAR_M),
        (weights.fitting, (fit.width_m / THIN_M).min(room_m / ROOM_M)),
        (weights.square, (fit.squareness - SQUARE_MIN) / (1.0 - SQUARE_MIN)),
        (weights.deep, fit.depth_m / gripper::DEPTH_MAX_M),
        (weights.seen, fit.seen),
    ];
    let total: f64 = terms.iter().map(|(weight, _)| weight).sum();
    let score = terms.iter().map(|(weight, value)| weight * value.clamp(0.0, 1.0)).sum::<f64>() / total;
    // Whatever else is good about it, fingers slide off surfaces that lie across, and off edges.
    let holds = ((fit.squareness - SLANTED) / (SQUARE_MIN - SLANTED)).clamp(0.0, 1.0) * (fit.depth_m / EDGE_M).clamp(0.1, 1.0);
    // And what hardly goes between the fingers is knocked over by them.
    score * holds * stays(fit, settings) * (room_m / NARROW_M).clamp(0.1, 1.0)
}

/// How surely the object stays between the pads as they close, 0.1 to 1. A wedge and a slope of half of what friction bridges are safe, and so are
/// contacts within the inner half of the pads; with what is beyond, each gets worse up to its end.
fn stays(fit: &GripperFit, settings: &GraspSettings) -> f64 {
    let within = |share: f64| (2.0 * (1.0 - share)).clamp(0.1, 1.0);
    let bridged_rad = settings.friction.atan();
    within(0.5 * fit.meeting.wedge_rad / bridged_rad)
        * within(fit.slope_rad / bridged_rad)
        * within(fit.meeting.aside_m / settings.gripper.finger_half_width_m)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector2};
    use repose_geometry::Aabb;

    use super::*;
    use crate::grasp::gripper::GripperFit;
    use crate::grasp::wedge::Meeting;

    fn scored(height_m: f64) -> f64 {
        let points = vec![Point3::new(-0.03, -0.03, 0.0), Point3::new(0.03, 0.03, 0.2)];
        let bounds = Aabb::of(&points).expect("two points");
        let (axis, behind, normals) = (Vector2::zeros(), Vec::new(), Vec::new());
        let object = GraspCloud { points, normals, axis, behind, bounds, middle_m: 0.1, floor_m: 0.017 };
        let (width_m, opening_m, meeting) = (0.05, 0.07, Meeting::default());
        let fit = GripperFit {
            width_m,
            offset_m: 0.0,
            aside_m: 0.0,
            opening_m,
            depth_m: 0.02,
            squareness: 1.0,
            slope_rad: 0.0,
            turn_rad: 0.0,
            meeting,
            seen: 1.0,
        };
        let down = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        score(&Isometry3::from_parts(Vector3::new(0.0, 0.0, height_m).into(), down), &fit, &object, &GraspSettings::default())
    }

    #[test]
    fn a_grasp_near_the_height_of_the_middle_is_better_than_one_at_the_top() {
        assert!(scored(0.12) > scored(0.18));
    }
}
