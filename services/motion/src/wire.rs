//! Between the messages of `repose-proto` and the planner's own types.

use nalgebra::{Isometry3, Point3};
use repose_belief::SeenScene;
use repose_geometry::transform::{from_row_major, to_row_major};
use repose_proto::motion::{Grasp, Heeded, MotionFailure, MotionPhase, MotionPlan, MotionPlanRequest, NotChosen};
use repose_proto::robot::{GripperCommand, HeldObject, SetPoint};
use repose_proto::scene::WorldFrame;
use repose_proto::{CallError, ErrorCode, RigidTransform, Scene};

use crate::grasp::GraspCandidate;
use crate::path::timing::Trajectory;
use crate::pick_place::plan::{PickPlaceError, PickPlacePlan, PlacementFailure, SkippedPlacement};
use crate::scene::{ArmSurroundings, PlanningScene};

/// What a plan says beside the motion itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanTerms {
    /// Longest time between set-points, milliseconds.
    pub set_point_period_ms: f64,
    /// How far from the plan's start the arm may be when it is executed, radians per joint.
    pub start_tolerance_rad: f64,
    /// How old the scene may be when it is executed, milliseconds.
    pub max_scene_age_ms: u64,
}

/// The scene as the planner of a pick and place sees it.
///
/// # Errors
/// `failed_precondition` without a calibrated camera: the robot would not know where things are; `invalid_argument` where objects are too far
/// apart.
pub fn planning_scene(scene: &Scene) -> Result<PlanningScene, CallError> {
    let seen_from = world_from_camera(scene)?;
    let seen = SeenScene::of(scene, &seen_from);
    PlanningScene::of(&seen).map_err(|too_wide| CallError::invalid("scene.points", too_wide.to_string()))
}

/// The scene as an arm sees it that is brought back.
///
/// # Errors
/// `failed_precondition` without a calibrated camera.
pub fn surroundings(scene: &Scene) -> Result<ArmSurroundings, CallError> {
    world_from_camera(scene)?;
    Ok(ArmSurroundings::of(scene))
}

/// The calibrated pose of the scene's camera.
fn world_from_camera(scene: &Scene) -> Result<Isometry3<f64>, CallError> {
    if scene.meta.world_frame != WorldFrame::Extrinsics {
        return Err(
            CallError::precondition("the scene's camera has no calibrated pose (world_from_camera): a robot cannot act on it").at("scene")
        );
    }
    match &scene.meta.camera.world_from_camera {
        Some(transform) => isometry(transform, "scene.camera.world_from_camera"),
        None => Err(CallError::precondition("the scene's camera has no pose").at("scene.camera.world_from_camera")),
    }
}

/// A rigid transform of a message.
///
/// # Errors
/// `invalid_argument` that names `field`.
pub fn isometry(to_from: &RigidTransform, field: &str) -> Result<Isometry3<f64>, CallError> {
    from_row_major(&to_from.0).map_err(|e| CallError::invalid(field, e.to_string()))
}

/// The grasps of a request.
///
/// # Errors
/// `invalid_argument` that names the grasp.
pub fn grasps(grasps: &[Grasp]) -> Result<Vec<GraspCandidate>, CallError> {
    let read = |(i, grasp): (usize, &Grasp)| {
        let world_from_tcp = isometry(&grasp.world_from_tcp, &format!("grasps[{i}].world_from_tcp"))?;
        Ok(GraspCandidate { world_from_tcp, aside_m: 0.0, opening_m: grasp.width_m, width_m: None, score: grasp.score })
    };
    grasps.iter().enumerate().map(read).collect()
}

/// A plan as a message.
pub fn motion_plan(plan: &PickPlacePlan, request: &MotionPlanRequest, scene_stamp_ns: u64, terms: &PlanTerms) -> MotionPlan {
    let phases: Vec<MotionPhase> = plan
        .phases
        .iter()
        .map(|p| MotionPhase {
            name: p.phase,
            gripper: p.gripper.map(|g| GripperCommand { width_m: g.width_m, force_n: g.force_n }),
            set_points: p.trajectory.as_ref().map(|t| set_points(t, terms.set_point_period_ms)).unwrap_or_default(),
        })
        .collect();
    let duration_ms = plan.phases.iter().filter_map(|p| p.trajectory.as_ref()).map(|t| t.duration_s() * 1e3).sum();
    MotionPlan {
        scene_id: request.scene.scene_id.clone(),
        robot: request.robot.clone(),
        query: request.query,
        placement: plan.placement,
        not_chosen: plan.not_chosen.iter().map(not_chosen).collect(),
        grasp: Grasp {
            world_from_tcp: RigidTransform(to_row_major(&plan.grasp.world_from_tcp)),
            width_m: plan.grasp.opening_m,
            score: plan.grasp.score,
        },
        start_joints_rad: request.start_joints_rad,
        start_tolerance_rad: terms.start_tolerance_rad,
        scene_stamp_ns,
        max_scene_age_ms: terms.max_scene_age_ms,
        phases,
        duration_ms,
        heeded: (plan.heeded != Heeded::Everything).then_some(plan.heeded),
    }
}

/// The error reply for a request that no plan serves.
pub fn call_error(error: &PickPlaceError) -> CallError {
    let message = match error {
        PickPlaceError::NoPlacement(reasons) => {
            let lines: Vec<String> =
                reasons.iter().map(|n| format!("placement {}: {}: {}", n.placement, motion_failure(n.failure).as_str(), n.tally)).collect();
            format!("no placement can be served: {}", lines.join("; "))
        }
        PickPlaceError::NoGrasp(_) => format!("{}: {error}", MotionFailure::NoGrasp.as_str()),
        other => other.to_string(),
    };
    match error {
        PickPlaceError::NoObject(_) => CallError::not_found("query", message),
        PickPlaceError::StartBlocked(_) => CallError::precondition(message).at("start_joints_rad"),
        // The object itself, or what stands around it, is to blame: with that elsewhere it may be grasped.
        PickPlaceError::NoGrasp(tally) => {
            CallError::precondition(message).at(if tally.scene_in_the_way == 0 { "query" } else { "scene.objects" })
        }
        PickPlaceError::NoPlacement(_) => CallError::precondition(message).at("placements"),
        PickPlaceError::Stopped => CallError::new(ErrorCode::Cancelled, message),
    }
}

/// What a plan puts into the hand: a box around what was seen of it, as it lies between the fingers.
pub fn held_object(scene: &Scene, plan: &MotionPlan) -> Option<HeldObject> {
    let mut in_tcp = points_in_tcp(scene, plan);
    let first = in_tcp.next()?;
    let (low, high) = in_tcp.fold((first, first), |(low, high), p| (low.inf(&p), high.sup(&p)));
    Some(HeldObject { scene_id: plan.scene_id.clone(), object: plan.query, low_m: low.coords.into(), high_m: high.coords.into() })
}

/// What was seen of a plan's object, in the frame of the tool centre point that grasps it; nothing where the plan has no such frame.
pub fn points_in_tcp(scene: &Scene, plan: &MotionPlan) -> impl Iterator<Item = Point3<f64>> {
    let tcp_from_world = isometry(&plan.grasp.world_from_tcp, "grasp.world_from_tcp").ok().map(|world_from_tcp| world_from_tcp.inverse());
    tcp_from_world
        .into_iter()
        .flat_map(|tcp_from_world| scene.points_of(plan.query).map(move |p| tcp_from_world * Point3::from(p).cast::<f64>()))
}

/// A trajectory as set-points, at most `period_ms` apart.
pub fn set_points(trajectory: &Trajectory, period_ms: f64) -> Vec<SetPoint> {
    let point = |(time_s, p): (f64, crate::path::timing::TrajectoryPoint)| SetPoint {
        t_ms: time_s * 1e3,
        q_rad: p.position_rad,
        dq_rad_s: p.velocity_rad_s,
    };
    trajectory.sampled(period_ms / 1e3).map(point).collect()
}

fn not_chosen(reason: &SkippedPlacement) -> NotChosen {
    NotChosen { placement: reason.placement, reason: motion_failure(reason.failure), detail: reason.tally.to_string() }
}

fn motion_failure(failure: PlacementFailure) -> MotionFailure {
    match failure {
        PlacementFailure::PickUnreachable => MotionFailure::PickUnreachable,
        PlacementFailure::PickBlocked => MotionFailure::PickBlocked,
        PlacementFailure::PlaceUnreachable => MotionFailure::PlaceUnreachable,
        PlacementFailure::PlaceBlocked => MotionFailure::PlaceBlocked,
        PlacementFailure::NoPath => MotionFailure::NoPath,
    }
}
