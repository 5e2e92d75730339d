//! What must hold before an execution begins.

use nalgebra::Isometry3;
use repose_geometry::transform::from_row_major;
use repose_panda::{Model, START_TOLERANCE_RAD};
use repose_proto::motion::{MotionPhase, MotionPlan};
use repose_proto::robot::{Owner, RobotMode, RobotState};
use repose_proto::{CallError, limits};

/// How far apart the end of one phase and the start of the next may be, radians per joint.
const JOINED_RAD: f64 = 1e-3;
/// How far the base may stand from where motions are planned for, metres and radians: the robot's side may have been told it with fewer digits. At
/// the end of the arm that is 4 mm, less than planning keeps off everything (`padding_m`).
const BASE_OFF_M: f64 = 2e-3;
const BASE_OFF_RAD: f64 = 2e-3;
/// How far in the future a scene may seem to have been seen: a camera's clock and the robot's differ, milliseconds.
const CLOCKS_DIFFER_MS: u64 = 2000;

/// Refuses phases that do not join, from where they start.
///
/// # Errors
/// `invalid_argument` that names the field.
pub fn check_phases(start_joints_rad: &[f64; 7], phases: &[MotionPhase]) -> Result<(), CallError> {
    if phases.is_empty() {
        return Err(CallError::invalid("phases", "the plan has no phases"));
    }
    let mut last = *start_joints_rad;
    for (i, phase) in phases.iter().enumerate() {
        let (Some(first), Some(end)) = (phase.set_points.first(), phase.set_points.last()) else { continue };
        if first.t_ms != 0.0 {
            return Err(CallError::invalid(format!("phases[{i}].set_points[0].t_ms"), format!("expected 0, got {}", first.t_ms)));
        }
        if let Some(joint) = apart(&last, &first.q_rad, JOINED_RAD) {
            let message = format!("joint {joint} starts at {} rad but the phase before ends at {} rad", first.q_rad[joint], last[joint]);
            return Err(CallError::invalid(format!("phases[{i}].set_points[0].q_rad"), message));
        }
        last = end.q_rad;
    }
    Ok(())
}

/// Refuses a scene that was seen at `stamp_ns`, too long ago. `now_ns` and all other instants here are of the robot's clock, as its states tell it: this process's own
/// is on another host, perhaps, and tells nothing of when a camera saw what.
///
/// # Errors
/// `failed_precondition` on `scene_stamp_ns`.
pub fn check_age(stamp_ns: u64, max_age_ms: u64, now_ns: u64) -> Result<(), CallError> {
    let ahead_ms = stamp_ns.saturating_sub(now_ns) / 1_000_000;
    if ahead_ms > CLOCKS_DIFFER_MS {
        let message = format!("the scene was seen {ahead_ms} ms in the future, at most {CLOCKS_DIFFER_MS} ms are put down to clocks");
        return Err(CallError::precondition(message).at("scene_stamp_ns"));
    }
    let age_ms = now_ns.saturating_sub(stamp_ns) / 1_000_000;
    if age_ms > max_age_ms {
        let message = format!("the scene is {age_ms} ms old, at most {max_age_ms} ms are allowed: look again");
        return Err(CallError::precondition(message).at("scene_stamp_ns"));
    }
    Ok(())
}

/// Refuses a scene that was seen before a robot last took or put something: a plan is carried out once, though the arm stands where it started.
/// The robot's side says how long ago that was, so that all its commanders know. `robot` is what the message calls it.
///
/// # Errors
/// `failed_precondition` on `scene_stamp_ns`.
pub fn check_unmoved(stamp_ns: u64, robot: &str, state: &RobotState) -> Result<(), CallError> {
    let Some(since_ms) = state.since_handling_ms else { return Ok(()) };
    let age_ms = state.stamp_ns.saturating_sub(stamp_ns) / 1_000_000;
    let before_ms = age_ms.saturating_sub(since_ms);
    if before_ms > CLOCKS_DIFFER_MS {
        let message = format!("{robot} has taken or put something {before_ms} ms after the scene was seen: look again");
        return Err(CallError::precondition(message).at("scene_stamp_ns"));
    }
    Ok(())
}

/// Refuses a robot that is not free.
///
/// # Errors
/// `failed_precondition` on `robot` when a stop is latched, the robot moves, or a task is open.
pub fn check_free(state: &RobotState) -> Result<(), CallError> {
    match state.mode {
        RobotMode::Stopped => {
            let why = state.stop.as_ref().map_or("it does not say why", |stop| stop.reason.as_str());
            return Err(CallError::precondition(format!("a stop is latched ({why}): `repose robot reset` clears it")).at("robot"));
        }
        RobotMode::Moving => return Err(CallError::precondition("the robot is moving").at("robot")),
        RobotMode::Idle => {}
    }
    if let Some(task) = state.open_task() {
        let owner = state.owner.as_ref().map_or("somebody", |owner| owner.id.as_str());
        return Err(CallError::precondition(format!("the robot carries out task {task} of {owner}")).at("robot"));
    }
    Ok(())
}

/// Refuses a robot that says another model of itself than motions are planned for.
///
/// # Errors
/// `failed_precondition` on `robot`.
pub fn check_model(state: &RobotState, planned_for: Model) -> Result<(), CallError> {
    match state.model.as_deref() {
        Some(model) if model != planned_for.name() => {
            let message = format!("the robot is a {model} and motion plans for a {}: set `robot_model` of [motion]", planned_for.name());
            Err(CallError::precondition(message).at("robot"))
        }
        _ => Ok(()),
    }
}

/// Refuses a robot that says that its base stands elsewhere than motions are planned for: it would carry them out beside where they were checked.
///
/// # Errors
/// `failed_precondition` on `robot`; of a base that is no rigid transform too.
pub fn check_base(state: &RobotState, planned_from: &Isometry3<f64>) -> Result<(), CallError> {
    let Some(told) = &state.world_from_base else { return Ok(()) };
    let stands =
        from_row_major(&told.0).map_err(|e| CallError::precondition(format!("the robot tells no place of its base: {e}")).at("robot"))?;
    let off = planned_from.inverse() * stands;
    let (off_m, off_rad) = (off.translation.vector.norm(), off.rotation.angle());
    if off_m > BASE_OFF_M || off_rad > BASE_OFF_RAD {
        let message = format!(
            "the robot's base stands {:.1} mm and {:.2}° from where motion plans for it: set `world_from_base` alike in [motion] and at the robot's side",
            1e3 * off_m,
            off_rad.to_degrees()
        );
        return Err(CallError::precondition(message).at("robot"));
    }
    Ok(())
}

/// Refuses a robot that does not stand, with an empty hand, where a plan starts.
///
/// # Errors
/// `failed_precondition` on `robot` or `start_joints_rad`.
pub fn check_start(plan: &MotionPlan, state: &RobotState) -> Result<(), CallError> {
    if state.gripper_holding {
        let message = "the robot has something in its hand already: `repose robot open` lets go of it where it is";
        return Err(CallError::precondition(message).at("robot"));
    }
    let first = plan.phases.iter().find_map(|phase| phase.set_points.first());
    // Whatever the plan allows, the robot takes no first set-point further from where it stands.
    let starts = [(&plan.start_joints_rad, plan.start_tolerance_rad.min(START_TOLERANCE_RAD))];
    for (start, tolerance_rad) in starts.into_iter().chain(first.map(|point| (&point.q_rad, START_TOLERANCE_RAD))) {
        if let Some(joint) = apart(start, &state.q_rad, tolerance_rad) {
            let (planned, stands) = (start[joint], state.q_rad[joint]);
            let message = format!("joint {joint} stands at {stands:.4} rad but the plan starts at {planned:.4} rad");
            return Err(CallError::precondition(message).at("start_joints_rad"));
        }
    }
    Ok(())
}

/// Who commands a robot next: the commander, under an epoch above all that were shown.
///
/// # Errors
/// `failed_precondition` when the robot's owner has the highest epoch.
pub fn next_owner(commander: &str, state: &RobotState) -> Result<Owner, CallError> {
    let last = state.owner.as_ref().map_or(0, |owner| owner.epoch);
    if last >= limits::MAX_EPOCH {
        return Err(CallError::precondition(format!("the robot's owner has the highest epoch, {last}")).at("robot"));
    }
    Ok(Owner { id: commander.to_owned(), epoch: last + 1 })
}

/// The first joint at which two configurations are further apart than a tolerance.
pub(super) fn apart(a: &[f64; 7], b: &[f64; 7], tolerance_rad: f64) -> Option<usize> {
    (0..7).find(|&i| (a[i] - b[i]).abs().is_nan() || (a[i] - b[i]).abs() > tolerance_rad)
}
