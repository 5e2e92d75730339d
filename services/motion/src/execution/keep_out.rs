//! Whether a plan that is to be executed keeps out of this cell's zones: it may have been made elsewhere, or before they were drawn.

use nalgebra::{Isometry3, Point3};
use repose_geometry::cloud;
use repose_panda::{FINGER_OPENING_MAX_M, JOINT_COUNT, Joints, Link, LinkFrames, SPHERE_LINKS, base_from_tcp, hermite, spheres_in_base};
use repose_proto::motion::{MotionPlan, Phase};
use repose_proto::robot::SetPoint;
use repose_proto::{CallError, Scene};

use crate::obstacles::ObstacleShape;
use crate::wire::points_in_tcp;

/// A joint moves by about this from one posture to the next that is looked at, radians: the hand by a centimetre, less than any sphere's radius.
const STEP_RAD: f64 = 0.01;
/// Between two set-points at most so many postures are looked at: a joint's whole range and more.
const MOST_STEPS: usize = 1000;
/// What the cubic adds to a joint's way beside its ends, for each radian that their velocities would go in the span: twice the most of its basis.
const VELOCITY_SHARE: f64 = 8.0 / 27.0;
/// What is held is looked at in cells of this size, metres.
const VOXEL_M: f32 = 0.005;

/// The zones of a cell, and where its robot stands.
#[derive(Debug, Clone, Copy)]
pub struct Zones<'a> {
    /// Where the robot's base stands.
    pub world_from_base: &'a Isometry3<f64>,
    /// The zones.
    pub solids: &'a [ObstacleShape],
    /// Whose parts the solids are, where they are another robot's and no zones.
    pub of_robot: Option<&'a str>,
}

impl Zones<'_> {
    /// Checks all that a plan goes through, its set-points and the cubics between them as the robot follows them: the arm by its own spheres, its
    /// fingers no further apart than they were sent, and, where the plan's scene is known, what was seen of the object from the grasp to the release.
    /// Without a margin: planning keeps one. That takes seconds for a large plan; whether to `go_on` is asked at every set-point.
    ///
    /// # Errors
    /// `failed_precondition` at the first set-point on the way to which something is in a zone; `invalid_argument` at one that is too far from the
    /// one before for that to be told; what `go_on` says.
    pub fn check(&self, plan: &MotionPlan, scene: Option<&Scene>, go_on: &dyn Fn() -> Result<(), CallError>) -> Result<(), CallError> {
        if self.solids.is_empty() {
            return Ok(());
        }
        let object = scene.map_or_else(Vec::new, |scene| held(scene, plan));
        let (mut holds, mut opening_m) = (false, FINGER_OPENING_MAX_M);
        for (i, phase) in plan.phases.iter().enumerate() {
            holds = match phase.name {
                Phase::Grasp => true,
                Phase::Release => false,
                _ => holds,
            };
            // Fingers that close on something stop anywhere on the way to where they are sent: no further apart than they were.
            opening_m = phase.gripper.filter(|_| phase.name != Phase::Grasp).map_or(opening_m, |gripper| gripper.width_m);
            for (j, point) in phase.set_points.iter().enumerate() {
                go_on()?;
                let at = || format!("phases[{i}].set_points[{j}]");
                let before = j.checked_sub(1).map_or(point, |before| &phase.set_points[before]);
                let entered = |q_rad: Joints| self.entered(&q_rad, opening_m, if holds { &object } else { &[] });
                if let Some(what) = way(before, point).map_err(|e| e.at(at()))?.find_map(entered) {
                    return Err(CallError::precondition(format!("{what} in phase {}", phase.name)).at(at()));
                }
            }
        }
        Ok(())
    }

    /// What would enter a zone in a posture, the fingers so far apart, with an object of these points in the frame of the tool centre point.
    fn entered(&self, q_rad: &Joints, opening_m: f64, object: &[Point3<f64>]) -> Option<String> {
        let spheres = spheres_in_base(&LinkFrames::at(q_rad), opening_m);
        // The foot never moves.
        for (sphere, link) in spheres.iter().zip(SPHERE_LINKS).skip(Link::Link0.sphere_range().end) {
            let center = self.world_from_base * sphere.center;
            if let Some(zone) = self.solids.iter().position(|zone| zone.distance_m(&center) < sphere.radius_m) {
                return Some(format!("{link:?} would {}", self.meeting(zone)));
            }
        }
        let world_from_tcp = self.world_from_base * base_from_tcp(q_rad);
        let is_inside = |zone: &ObstacleShape| object.iter().any(|p| zone.distance_m(&(world_from_tcp * p)) <= 0.0);
        let zone = self.solids.iter().position(is_inside)?;
        Some(format!("the held object would {}", self.meeting(zone)))
    }

    /// What something does that is in a solid, in words.
    fn meeting(&self, solid: usize) -> String {
        self.of_robot.map_or_else(|| format!("enter keep_out[{solid}]"), |robot| format!("touch robot {robot}"))
    }
}

/// Refuses a plan that carries an object where its scene is not known: without it the object cannot be checked against zones and other robots.
///
/// # Errors
/// `failed_precondition` on `scene_id`.
pub fn check_carried(plan: &MotionPlan, scene: Option<&Scene>) -> Result<(), CallError> {
    if scene.is_some() || plan.phases.iter().all(|phase| phase.name != Phase::Grasp) {
        return Ok(());
    }
    let message = "neither motion nor perception has the plan's scene any more, so what it carries cannot be checked against keep-out zones \
                   and other robots: look again and plan anew";
    Err(CallError::precondition(message).at("scene_id"))
}

/// The points of a plan's object in the frame of the tool centre point that grasps it.
fn held(scene: &Scene, plan: &MotionPlan) -> Vec<Point3<f64>> {
    let points: Vec<Point3<f32>> = points_in_tcp(scene, plan).map(|p| p.cast()).collect();
    cloud::voxel_downsampled(&points, VOXEL_M).iter().map(|p| p.cast()).collect()
}

/// The postures from one set-point to another, without the first unless they are the same.
///
/// # Errors
/// `invalid_argument` when there would be too many.
fn way(a: &SetPoint, b: &SetPoint) -> Result<impl Iterator<Item = Joints>, CallError> {
    let span_s = (b.t_ms - a.t_ms) * 1e-3;
    let along = |i: usize| (b.q_rad[i] - a.q_rad[i]).abs() + VELOCITY_SHARE * span_s * (a.dq_rad_s[i].abs() + b.dq_rad_s[i].abs());
    let farthest_rad = (0..JOINT_COUNT).map(along).fold(0.0, f64::max);
    let most_rad = STEP_RAD * MOST_STEPS as f64;
    if farthest_rad.is_nan() || farthest_rad > most_rad {
        let message = format!(
            "a joint would go {farthest_rad:.1} rad from the set-point before, at most {most_rad} rad can be checked against keep-out zones"
        );
        return Err(CallError::invalid("set_points", message));
    }
    let steps = (farthest_rad / STEP_RAD).ceil().max(1.0);
    let (from, to) = ((a.q_rad, a.dq_rad_s), (b.q_rad, b.dq_rad_s));
    Ok((1..=steps as usize).map(move |k| hermite((&from.0, &from.1), (&to.0, &to.1), span_s, k as f64 / steps).0))
}
