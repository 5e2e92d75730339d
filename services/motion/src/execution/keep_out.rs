//! Whether a plan that is to be executed keeps out of this cell's zones: it may have been made elsewhere, or before they were drawn.

use nalgebra::Isometry3;
use repose_panda::{FINGER_OPENING_MAX_M, Link, LinkFrames, SPHERE_LINKS, spheres_in_base};
use repose_proto::CallError;
use repose_proto::motion::MotionPlan;

use crate::obstacles::ObstacleShape;

/// Checks every set-point of a plan against the zones, with the arm's own spheres and no margin: planning keeps one.
///
/// # Errors
/// `failed_precondition` at the first set-point whose arm is in a zone.
pub fn check(plan: &MotionPlan, world_from_base: &Isometry3<f64>, zones: &[ObstacleShape]) -> Result<(), CallError> {
    if zones.is_empty() {
        return Ok(());
    }
    for (i, phase) in plan.phases.iter().enumerate() {
        for (j, point) in phase.set_points.iter().enumerate() {
            let spheres = spheres_in_base(&LinkFrames::at(&point.q_rad), FINGER_OPENING_MAX_M);
            // The foot never moves.
            for (sphere, link) in spheres.iter().zip(SPHERE_LINKS).skip(Link::Link0.sphere_range().end) {
                let center = world_from_base * sphere.center;
                if let Some(zone) = zones.iter().position(|zone| zone.distance_m(&center) < sphere.radius_m) {
                    let message = format!("{link:?} would enter keep_out[{zone}] in phase {}", phase.name);
                    return Err(CallError::precondition(message).at(format!("phases[{i}].set_points[{j}]")));
                }
            }
        }
    }
    Ok(())
}
