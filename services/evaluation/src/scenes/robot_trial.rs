//! One trial of the robot's table: a placement and a motion are planned from what was seen, the simulated Panda carries them out by friction
//! alone, and ground truth says what came of it.
//!
//! The same state machine that commands robots over the network drives the arm here, in robot time and with nothing between the two ([`CellRun`]).
//! What was lost, or does not make the goal true in a view after it, is tried again as `place --execute` does: the arm goes home, looks, and
//! plans anew, with other draws, a bounded number of times.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

use nalgebra::Isometry3;
use repose_geometry::transform::{from_row_major, tilt};
use repose_motion::believed::Heeded;
use repose_motion::pick_place::plan::PickPlaceError;
use repose_motion::pick_place::{PickPlaceRequest, PickPlaceSettings, pick_place};
use repose_motion::wire;
use repose_panda::Joints;
use repose_planner::{PlacementModels, PreparedScene, plan};
use repose_proto::motion::{ExecuteReply, ExecutionOutcome, MotionPlan, MotionPlanRequest};
use repose_proto::place::ReachingRobot;
use repose_proto::{CallError, ErrorCode, GoalTerm, PlaceRequest, RigidTransform};
use repose_simulator::cell_world::CellWorld;
use serde::Serialize;

use crate::scenes::carry_watch::{CarryWatch, Incident, Shift};
use crate::scenes::cell_run::{CellRun, Strip};
use crate::scenes::outcome::{OTHERS_MOVED_M, STABLE_M, TILT_RAD};
use crate::scenes::problem::Problem;
use crate::scenes::robot_scene::{Excluded, TableCondition};
use crate::scenes::robot_settings::{RobotTrialError, RobotTrialSettings};

/// Why a trial failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// The planner found no placement.
    NoPlacement,
    /// Motion found no grasp on the object.
    NoGrasp,
    /// No placement can be reached with any grasp.
    NoMotion,
    /// The robot stopped: a reflex, or it did not follow.
    Stopped,
    /// The object was not in the hand when the lift had ended.
    GraspLost,
    /// It left the hand between lift and release.
    Dropped,
    /// It came to rest further than 5 cm from where it was to stand.
    Moved,
    /// It stands where it was to stand, and has tipped by 15° or more.
    Tipped,
    /// It stands where it was to stand, and another object was moved by more than 2 cm.
    Disturbed,
    /// It stands where it was to stand, but the goal does not hold.
    GoalNotTrue,
}

impl Cause {
    /// Whether nothing has moved because motion could serve none of the placements: other draws may do.
    fn is_unserved(self) -> bool {
        matches!(self, Self::NoGrasp | Self::NoMotion)
    }

    /// The name in words.
    pub fn name(self) -> &'static str {
        match self {
            Self::NoPlacement => "no placement",
            Self::NoGrasp => "no grasp",
            Self::NoMotion => "no motion",
            Self::Stopped => "stopped",
            Self::GraspLost => "grasp lost",
            Self::Dropped => "dropped",
            Self::Moved => "moved > 5 cm",
            Self::Tipped => "tipped",
            Self::Disturbed => "moved another",
            Self::GoalNotTrue => "goal not true",
        }
    }
}

/// An attempt that was followed by another.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct FailedAttempt {
    /// What had come of it, by the truth; none where it went well and was not seen to.
    pub cause: Option<Cause>,
    /// What the robot or the search said.
    pub detail: String,
}

/// The result of a trial. Steps that were not reached are `false`.
#[derive(Debug, Clone, Serialize)]
pub struct RobotTrial {
    /// The object's name.
    pub object: String,
    /// What it stood among.
    pub condition: TableCondition,
    /// The scene's seed.
    pub seed: u64,
    /// What was asked, in the scene's ids; the object is 1.
    pub goal: GoalTerm,
    /// A placement and a motion to it were found, at one attempt or more.
    pub planned: bool,
    /// The object was in the hand when the lift had ended, at the last attempt that was carried out.
    pub grasped: bool,
    /// It stands upright within 5 cm of where it was to stand, nothing else was moved, and the goal holds.
    pub placed: bool,
    /// Why not.
    pub cause: Option<Cause>,
    /// The same for a person.
    pub detail: String,
    /// Attempts before the last.
    pub failed_attempts: Vec<FailedAttempt>,
    /// What was drawn before it and not asked for.
    pub excluded: Excluded,
    /// What the motion heeded of what was not seen.
    pub heeded: Option<Heeded>,
    /// How far the fingers' middle was from the object's true centre, seen from above, metres.
    pub aside_m: Option<f64>,
    /// How far and how much the object shifted and turned in the hand between grasp and release, metres and radians.
    pub in_hand: Option<Shift>,
    /// How far from where it was to stand the object came to rest, metres.
    pub off_m: Option<f64>,
    /// How far it tipped from upright, radians.
    pub tilt_rad: Option<f64>,
    /// Whether another object was moved by more than 2 cm.
    pub disturbed: bool,
    /// What was touched that should not have been, and the object's first slip.
    pub incidents: Vec<Incident>,
    /// Wall-clock time of the last placement search and of the last motion search, milliseconds.
    pub plan_ms: [f64; 2],
    /// Length of the last motion, seconds of robot time.
    pub robot_s: f64,
}

impl RobotTrial {
    /// A trial of which nothing has come yet.
    pub(crate) fn new(object: String, condition: TableCondition, seed: u64, goal: GoalTerm) -> Self {
        Self {
            object,
            condition,
            seed,
            goal,
            planned: false,
            grasped: false,
            placed: false,
            cause: None,
            detail: String::new(),
            failed_attempts: Vec::new(),
            excluded: Excluded::default(),
            heeded: None,
            aside_m: None,
            in_hand: None,
            off_m: None,
            tilt_rad: None,
            disturbed: false,
            incidents: Vec::new(),
            plan_ms: [0.0; 2],
            robot_s: 0.0,
        }
    }
}

/// Runs a trial.
///
/// # Errors
/// [`RobotTrialError`] when the planner refuses the request or the settings are out of range.
pub fn robot_trial(
    problem: &Problem,
    condition: TableCondition,
    models: &dyn PlacementModels,
    settings: &RobotTrialSettings,
) -> Result<(RobotTrial, Strip), RobotTrialError> {
    let query = problem.index_of(problem.query).unwrap_or(0);
    let name = problem.truth.objects.get(query).map_or_else(String::new, |o| o.shape.name.to_string());
    let mut trial = RobotTrial::new(name, condition, problem.seed, problem.goal);
    let mut cell = CellWorld::with_scene(problem.truth.clone(), settings.cell.clone(), settings.arm, settings.hand);
    let mut strip = vec![cell.true_picture(true).color];
    let mut run = CellRun::new(&mut cell, settings);
    // What is seen now; the problem itself is how things stood at the start, by which others are judged.
    let mut view = problem.clone();
    for attempt in 0..settings.attempts.max(1) {
        let (placements, plan) = match planned(&view, attempt, run.cell.arm.q_rad(), models, settings, &mut trial) {
            Ok(Ok(planned)) => planned,
            Ok(Err((cause, detail))) => {
                if attempt == 0 || trial.cause.is_some_and(Cause::is_unserved) {
                    (trial.cause, trial.detail) = (Some(cause), detail.clone());
                }
                if cause.is_unserved() && attempt + 1 < settings.attempts {
                    trial.failed_attempts.push(FailedAttempt { cause: Some(cause), detail });
                    continue;
                }
                break;
            }
            Err(refused) if attempt == 0 => return Err(refused),
            // What was lost is not seen any more, or cannot be taken.
            Err(_) => break,
        };
        trial.planned = true;
        trial.robot_s = plan.duration_ms * 1e-3;
        let world_from_tcp = wire::isometry(&plan.grasp.world_from_tcp, "grasp.world_from_tcp")?;
        let seen_at = view.truth.objects[query].world_from_object;
        trial.aside_m = Some((world_from_tcp.translation.vector - seen_at.translation.vector).xy().norm());
        let wanted = placements[plan.placement] * seen_at;
        let mut watch = CarryWatch::new(query);
        let reply = run.carry_out(plan, &view.truth, &mut watch, &mut strip)?;
        run.come_to_rest();
        strip.push(run.cell.true_picture(true).color);
        trial.incidents.append(&mut watch.incidents);
        judge(problem, run.cell, &wanted, &reply, &watch, &mut trial);
        let may_go_on = attempt + 1 < settings.attempts && reply.outcome != ExecutionOutcome::Stopped;
        match may_go_on.then(|| run.seen_again(&view, reply.outcome)).flatten() {
            // The robot does not know the truth: it goes by what it felt and sees.
            Some(seen) => {
                trial.failed_attempts.push(FailedAttempt { cause: trial.cause, detail: trial.detail.clone() });
                view = seen;
            }
            None => break,
        }
    }
    Ok((trial, strip))
}

type Planned = (Vec<Isometry3<f64>>, MotionPlan);

/// Ranked placements and a motion to one of them, or what was in the way.
fn planned(
    problem: &Problem,
    attempt: usize,
    start: &Joints,
    models: &dyn PlacementModels,
    settings: &RobotTrialSettings,
    trial: &mut RobotTrial,
) -> Result<Result<Planned, (Cause, String)>, RobotTrialError> {
    let scene = Arc::new(problem.observed.clone());
    let scene_id = scene.id();
    let request = PlaceRequest {
        count: settings.count,
        variant: settings.variant,
        seed: problem.seed + attempt as u64,
        region: vec![settings.region.clone()],
        robot: Some(ReachingRobot { name: "panda".to_owned(), world_from_base: Some(RigidTransform(settings.motion.world_from_base)) }),
        ..PlaceRequest::new(scene_id.clone(), problem.query, vec![problem.goal])
    };
    let started = Instant::now();
    let result = match plan(&PreparedScene::new(scene.clone()), &request, models, &mut |_| ControlFlow::Continue(())) {
        // It is believed to carry another object.
        Err(error) if error.code == ErrorCode::FailedPrecondition => return Ok(Err((Cause::NoPlacement, error.message))),
        answered => answered?,
    };
    trial.plan_ms[0] = started.elapsed().as_secs_f64() * 1e3;
    if result.placements.is_empty() {
        return Ok(Err((Cause::NoPlacement, format!("{:?}", result.rejections))));
    }
    let wire_placements: Vec<RigidTransform> = result.placements.iter().map(|p| p.placed_from_observed).collect();
    let placements = wire_placements
        .iter()
        .map(|p| from_row_major(&p.0).map_err(|e| CallError::internal(e.to_string())))
        .collect::<Result<Vec<Isometry3<f64>>, CallError>>()?;
    let planning_scene = wire::planning_scene(&scene)?;
    let motion: PickPlaceSettings = settings.motion.planning()?;
    let asked =
        PickPlaceRequest { scene: &planning_scene, query: problem.query, placements: &placements, start, grasps: None, seed: request.seed };
    let started = Instant::now();
    let found = pick_place(&asked, &motion);
    trial.plan_ms[1] = started.elapsed().as_secs_f64() * 1e3;
    let request = MotionPlanRequest {
        seed: request.seed,
        ..MotionPlanRequest::new(scene_id, "panda".to_owned(), problem.query, wire_placements, *start)
    };
    match found {
        Ok(plan) => {
            trial.heeded = Some(plan.heeded);
            Ok(Ok((placements, wire::motion_plan(&plan, &request, scene.stamp_ns, &settings.motion.terms()?))))
        }
        Err(error) => {
            let cause = if matches!(error, PickPlaceError::NoGrasp(_)) { Cause::NoGrasp } else { Cause::NoMotion };
            Ok(Err((cause, error.to_string())))
        }
    }
}

/// How far the object may move in the hand and still be in it, metres.
const IN_HAND_M: f64 = 0.08;

fn judge(problem: &Problem, cell: &CellWorld, wanted: &Isometry3<f64>, reply: &ExecuteReply, watch: &CarryWatch, trial: &mut RobotTrial) {
    let after = cell.truth();
    let query = problem.index_of(problem.query).unwrap_or(0);
    let stands = after.objects[query].world_from_object;
    let shift = watch.shift_of_lift();
    trial.in_hand = watch.shift_in_hand();
    trial.grasped = shift.is_some_and(|s| s.by_m < IN_HAND_M);
    let off_m = (stands.translation.vector - wanted.translation.vector).norm();
    trial.off_m = Some(off_m);
    // Against the start, so that one that was tipped at an earlier attempt and moved as it lay does not pass.
    trial.tilt_rad = Some(tilt(&problem.truth.objects[query].world_from_object, &stands));
    trial.disturbed = after
        .objects
        .iter()
        .zip(&problem.truth.objects)
        .filter(|(_, before)| before.id != problem.query)
        .any(|(a, b)| (a.world_from_object.translation.vector - b.world_from_object.translation.vector).norm() > OTHERS_MOVED_M);
    let n = after.objects.len();
    let anchor = problem.index_of(problem.goal.anchor).unwrap_or(0);
    let holds = after.relations(&problem.viewer)[query * n + anchor][problem.goal.relation.index()] == problem.goal.holds;
    let dropped = trial.in_hand.is_none_or(|s| s.by_m >= IN_HAND_M);
    trial.cause = if reply.outcome == ExecutionOutcome::Stopped {
        Some(Cause::Stopped)
    } else if !trial.grasped {
        Some(Cause::GraspLost)
    } else if dropped || reply.outcome == ExecutionOutcome::GraspLost {
        Some(Cause::Dropped)
    } else if off_m > STABLE_M {
        Some(Cause::Moved)
    } else if trial.tilt_rad.is_some_and(|tilt| tilt > TILT_RAD) {
        Some(Cause::Tipped)
    } else if trial.disturbed {
        Some(Cause::Disturbed)
    } else if !holds {
        Some(Cause::GoalNotTrue)
    } else {
        None
    };
    trial.placed = trial.cause.is_none();
    trial.detail = reply.reason.clone().unwrap_or_default();
}
