//! Whether a plan that is to be executed keeps out of this cell's zones: it may have been made elsewhere, or before they were drawn.

use nalgebra::{Isometry3, Point3, Vector3};
use repose_geometry::cloud;
use repose_panda::kinematics::{FLANGE_M, TCP_M};
use repose_panda::{
    FINGER_OPENING_MAX_M, JOINT_COUNT, Joints, LINKS, Link, LinkFrame, LinkFrames, SPHERE_LINKS, base_from_tcp, gripper_spheres, hermite,
    levers, spheres_in_base, spheres_in_link,
};
use repose_proto::motion::{MotionPlan, Phase};
use repose_proto::robot::SetPoint;
use repose_proto::{CallError, Scene};

use crate::obstacles::ObstacleShape;
use crate::wire::points_in_tcp;

/// No place on the arm, or of what it holds, moves further from one posture to the next that is looked at, metres: as fine as what is held is
/// looked at, and less than any sphere's radius.
const STEP_M: f64 = 0.005;
/// A joint may be sent at most so far from one set-point to the next, radians: its whole range and more.
const MOST_RAD: f64 = 10.0;
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
        let longest = longest_levers(&object);
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
                if let Some(what) = way(before, point, &longest).map_err(|e| e.at(at()))?.find_map(entered) {
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

/// How far a radian of each joint moves a place on the arm, or of what is held there, at most, metres: points in the frame of the tool centre
/// point.
fn longest_levers(object: &[Point3<f64>]) -> Joints {
    // A lever asks how far a place is along the last axis, and from it: how the hand is turned about that does not matter.
    let hand = gripper_spheres(&LinkFrame::BASE, FINGER_OPENING_MAX_M).map(|sphere| sphere.center.coords + Vector3::z() * FLANGE_M);
    let held = object.iter().map(|p| p.coords + Vector3::z() * (FLANGE_M + TCP_M));
    let on_last = hand.into_iter().chain(held).map(|place| (7, place));
    let on_links = (1..=7).flat_map(|link| spheres_in_link(LINKS[link]).map(move |sphere| (link, sphere.center.coords)));
    on_links.chain(on_last).fold([0.0; JOINT_COUNT], |longest, (link, place)| {
        let levers = levers(link, &place);
        std::array::from_fn(|i| longest[i].max(levers[i]))
    })
}

/// The postures from one set-point to another, without the first unless they are the same; `longest` levers, metres.
///
/// # Errors
/// `invalid_argument` when there would be too many.
fn way(a: &SetPoint, b: &SetPoint, longest: &Joints) -> Result<impl Iterator<Item = Joints>, CallError> {
    let span_s = (b.t_ms - a.t_ms) * 1e-3;
    let rates: Joints = std::array::from_fn(|i| fastest(b.q_rad[i] - a.q_rad[i], span_s * a.dq_rad_s[i], span_s * b.dq_rad_s[i]));
    // What is no number is not within it.
    if let Some(rate) = rates.iter().find(|rate| !(0.0..=MOST_RAD).contains(*rate)) {
        let message = format!(
            "a joint would go as far as {rate:.1} rad from the set-point before, at most {MOST_RAD} rad can be checked against keep-out zones"
        );
        return Err(CallError::invalid("set_points", message));
    }
    let farthest_m: f64 = (0..JOINT_COUNT).map(|i| longest[i] * rates[i]).sum();
    let steps = (farthest_m / STEP_M).ceil().max(1.0);
    let (from, to) = ((a.q_rad, a.dq_rad_s), (b.q_rad, b.dq_rad_s));
    Ok((1..=steps as usize).map(move |k| hermite((&from.0, &from.1), (&to.0, &to.1), span_s, k as f64 / steps).0))
}

/// The highest rate at which a cubic goes `by_rad` over a unit interval, with these rates at its ends: its derivative is a parabola.
fn fastest(by_rad: f64, first: f64, last: f64) -> f64 {
    let (slope, bend) = (6.0 * by_rad - 4.0 * first - 2.0 * last, 3.0 * (first + last) - 6.0 * by_rad);
    let at = -slope / (2.0 * bend);
    let vertex = if at > 0.0 && at < 1.0 { (first + 0.5 * at * slope).abs() } else { 0.0 };
    // The largest of some is never what is no number; the sum of all is.
    if slope.is_nan() { slope } else { first.abs().max(last.abs()).max(by_rad.abs()).max(vertex) }
}

#[cfg(test)]
mod tests {
    use repose_panda::READY;

    use super::*;

    fn set_point(t_ms: f64, by_rad: f64, speed_rad_s: f64) -> SetPoint {
        SetPoint { t_ms, q_rad: READY.map(|q| q + by_rad), dq_rad_s: [speed_rad_s; JOINT_COUNT] }
    }

    #[test]
    fn no_place_goes_further_than_a_step_between_two_postures_however_many_joints_turn() {
        // A pole of 40 cm in the hand.
        let object = [Point3::new(0.0, 0.0, 0.0), Point3::new(0.0, 0.0, 0.4)];
        let longest = longest_levers(&object);
        for (by_rad, first, last) in [(0.009, 0.9, 0.9), (0.05, 0.0, 0.0), (0.0, 2.0, -2.0), (-0.03, 1.0, -2.0)] {
            let (a, b) = (set_point(0.0, 0.0, first), set_point(10.0, by_rad, last));
            let mut tips = std::iter::once(a.q_rad).chain(way(&a, &b, &longest).unwrap()).map(|q_rad| base_from_tcp(&q_rad) * object[1]);
            let mut before = tips.next().unwrap();
            for tip in tips {
                assert!((tip - before).norm() <= STEP_M, "{} m", (tip - before).norm());
                before = tip;
            }
            assert!((before - base_from_tcp(&b.q_rad) * object[1]).norm() < 1e-9, "to the end");
        }
    }

    #[test]
    fn what_is_too_far_or_no_number_is_refused() {
        let (from, longest) = (set_point(0.0, 0.0, 0.0), longest_levers(&[]));
        for to in [set_point(10.0, 11.0, 0.0), set_point(10.0, 0.0, 1e4), set_point(10.0, f64::MAX, 0.0), set_point(10.0, 0.0, f64::NAN)] {
            assert_eq!(way(&from, &to, &longest).err().map(|e| e.field), Some(Some("set_points".to_owned())));
        }
        assert_eq!(way(&from, &from, &longest).map(Iterator::count), Ok(1));
    }
}
