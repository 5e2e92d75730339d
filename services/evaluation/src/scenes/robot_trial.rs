//! One trial of the robot's table: a placement and a motion are planned from what was seen, the simulated Panda carries them out by friction
//! alone, and ground truth says what came of it.
//!
//! The same state machine that commands robots over the network drives the arm here, in robot time and with nothing between the two.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

use nalgebra::{Isometry3, Vector3};
use repose_geometry::Image;
use repose_geometry::transform::from_row_major;
use repose_motion::believed::Heeded;
use repose_motion::execution::{Execution, ExecutionAction, ExecutionSettings, ExecutionTask};
use repose_motion::pick_place::plan::PickPlaceError;
use repose_motion::pick_place::{PickPlaceRequest, PickPlaceSettings, pick_place};
use repose_motion::wire;
use repose_motion::{MotionConfig, config::ConfigError};
use repose_panda::{READY, base_from_hand};
use repose_planner::{PlacementModels, PreparedScene, plan};
use repose_proto::motion::{ExecuteReply, ExecutionOutcome, MotionPlan, MotionPlanRequest, Phase};
use repose_proto::place::{ReachingRobot, RegionBox, Variant};
use repose_proto::{CallError, ErrorCode, GoalTerm, PlaceRequest, RigidTransform};
use repose_simulator::cell::CellSettings;
use repose_simulator::cell_world::CellWorld;
use repose_simulator::robot::{ArmSettings, HandSettings};
use repose_simulator::scene::SimulatedScene;
use serde::Serialize;

use crate::scenes::carry_watch::{CarryWatch, Incident, Shift};
use crate::scenes::outcome::{OTHERS_MOVED_M, STABLE_M, TILT_RAD};
use crate::scenes::problem::Problem;
use crate::scenes::robot_scene::{Excluded, TableCondition};

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
    /// A placement and a motion to it were found.
    pub planned: bool,
    /// The object was in the hand when the lift had ended.
    pub grasped: bool,
    /// It stands upright within 5 cm of where it was to stand, nothing else was moved, and the goal holds.
    pub placed: bool,
    /// Why not.
    pub cause: Option<Cause>,
    /// The same for a person.
    pub detail: String,
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
    /// Wall-clock time of the placement search and of the motion search, milliseconds.
    pub plan_ms: [f64; 2],
    /// Length of the motion, seconds of robot time.
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

/// How a trial is run.
#[derive(Debug, Clone)]
pub struct RobotTrialSettings {
    /// The cell.
    pub cell: CellSettings,
    /// The arm's controller.
    pub arm: ArmSettings,
    /// The hand.
    pub hand: HandSettings,
    /// How motions are planned and what a plan says of them.
    pub motion: MotionConfig,
    /// Which method plans the placement.
    pub variant: Variant,
    /// Placements asked of the planner, for motion to choose from.
    pub count: u32,
    /// Where placements may be: what the arm reaches from above, world frame.
    pub region: RegionBox,
    /// How long an execution may take, seconds of robot time.
    pub longest_s: f64,
    /// How long the world may take to come to rest afterwards, seconds.
    pub rest_s: f64,
}

impl Default for RobotTrialSettings {
    fn default() -> Self {
        Self {
            cell: CellSettings::default(),
            arm: ArmSettings::default(),
            hand: HandSettings::default(),
            motion: MotionConfig::default(),
            variant: Variant::default(),
            count: 5,
            region: RegionBox { min_m: [0.28, -0.42, -0.05], max_m: [0.78, 0.42, 0.7], inside: true },
            longest_s: 180.0,
            rest_s: 4.0,
        }
    }
}

/// The pictures of a trial: before, lifted, lowered, placed. Those of steps not come to are missing.
pub type Strip = Vec<Image<[u8; 3]>>;

/// A trial that could not be run at all.
#[derive(Debug, thiserror::Error)]
pub enum RobotTrialError {
    /// The planner refused the request.
    #[error(transparent)]
    Call(#[from] CallError),
    /// Motion's settings are out of range.
    #[error(transparent)]
    Config(#[from] ConfigError),
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
    let (placements, plan) = match planned(problem, models, settings, &mut trial)? {
        Ok(planned) => planned,
        Err((cause, detail)) => {
            (trial.cause, trial.detail) = (Some(cause), detail);
            return Ok((trial, strip));
        }
    };
    trial.planned = true;
    trial.robot_s = plan.duration_ms * 1e-3;
    let world_from_tcp = wire::isometry(&plan.grasp.world_from_tcp, "grasp.world_from_tcp")?;
    let center = problem.truth.objects[query].world_from_object.translation.vector;
    trial.aside_m = Some((world_from_tcp.translation.vector - center).xy().norm());
    let wanted = placements[plan.placement] * problem.truth.objects[query].world_from_object;
    let mut carried = carried_out(&mut cell, query, plan, &problem.truth, settings, &mut strip)?;
    trial.incidents = std::mem::take(&mut carried.incidents);
    let mut waited_s = 0.0;
    while waited_s < settings.rest_s && (waited_s < 0.5 || !cell.at_rest()) {
        cell.step(f64::INFINITY);
        waited_s += cell.step_s();
    }
    strip.push(cell.true_picture(true).color);
    judge(problem, &cell, &wanted, &carried, &mut trial);
    Ok((trial, strip))
}

type Planned = (Vec<Isometry3<f64>>, MotionPlan);

/// Ranked placements and a motion to one of them, or what was in the way.
fn planned(
    problem: &Problem,
    models: &dyn PlacementModels,
    settings: &RobotTrialSettings,
    trial: &mut RobotTrial,
) -> Result<Result<Planned, (Cause, String)>, RobotTrialError> {
    let scene = Arc::new(problem.observed.clone());
    let scene_id = scene.id();
    let request = PlaceRequest {
        count: settings.count,
        variant: settings.variant,
        seed: problem.seed,
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
    let asked = PickPlaceRequest {
        scene: &planning_scene,
        query: problem.query,
        placements: &placements,
        start: &READY,
        grasps: None,
        seed: problem.seed,
    };
    let started = Instant::now();
    let found = pick_place(&asked, &motion);
    trial.plan_ms[1] = started.elapsed().as_secs_f64() * 1e3;
    let request = MotionPlanRequest {
        seed: problem.seed,
        ..MotionPlanRequest::new(scene_id, "panda".to_owned(), problem.query, wire_placements, READY)
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

/// What was seen of the object while the plan was carried out.
struct Carried {
    reply: ExecuteReply,
    /// Its pose in the hand when the fingers had closed, when the lift and when the lowering had ended.
    grasped: Option<Isometry3<f64>>,
    lifted: Option<Isometry3<f64>>,
    lowered: Option<Isometry3<f64>>,
    incidents: Vec<Incident>,
}

/// Drives the arm with the plan, state by state.
fn carried_out(
    cell: &mut CellWorld,
    query: usize,
    plan: MotionPlan,
    scene: &SimulatedScene,
    settings: &RobotTrialSettings,
    strip: &mut Strip,
) -> Result<Carried, RobotTrialError> {
    const STATE_MS: u64 = 10;
    let execution_settings: ExecutionSettings = settings.motion.execution()?;
    let mut now_ms: u64 = 0;
    let mut seq = 1;
    let stamp_ns = plan.scene_stamp_ns;
    let (mut grasped, mut lifted, mut lowered) = (None, None, None);
    let mut watch = CarryWatch::new(query);
    let task = ExecutionTask { commander: "evaluation".to_owned(), id: "trial".to_owned(), grasps: None };
    let (mut execution, mut steps) = Execution::begin(plan, task, &cell.robot_state(seq, stamp_ns), now_ms, execution_settings)?;
    let steps_per_state = (STATE_MS as f64 * 1e-3 / cell.step_s()).round().max(1.0) as usize;
    loop {
        for step in steps.drain(..) {
            match step {
                ExecutionAction::Send(command) => {
                    if let Err(why) = cell.arm.command(&command, now_ms as f64 * 1e-3) {
                        tracing::debug!(seq = command.seq, %why, "command ignored");
                    }
                }
                ExecutionAction::Progress(progress) => {
                    watch.begins(progress.phase, cell);
                    let in_hand = || base_from_hand(cell.arm.q_rad()).inverse() * cell.world_from_objects()[query];
                    match progress.phase {
                        Phase::Lift => grasped = Some(in_hand()),
                        Phase::Transfer => {
                            lifted = Some(in_hand());
                            strip.push(cell.true_picture(true).color);
                        }
                        Phase::Release => {
                            lowered = Some(in_hand());
                            strip.push(cell.true_picture(true).color);
                        }
                        _ => {}
                    }
                }
                ExecutionAction::Done(reply) => return Ok(Carried { reply, grasped, lifted, lowered, incidents: watch.incidents }),
            }
        }
        for _ in 0..steps_per_state {
            cell.step(now_ms as f64 * 1e-3);
        }
        watch.look(cell, scene);
        now_ms += STATE_MS;
        seq += 1;
        steps = execution.on_state(&cell.robot_state(seq, stamp_ns + now_ms * 1_000_000), now_ms);
        if now_ms % settings.motion.command_period_ms < STATE_MS {
            steps.extend(execution.on_tick(now_ms));
        }
        if now_ms as f64 * 1e-3 > settings.longest_s {
            steps.extend(execution.cancel("the trial's time is up", now_ms));
        }
    }
}

/// How far the object may move in the hand and still be in it, metres.
const IN_HAND_M: f64 = 0.08;

fn judge(problem: &Problem, cell: &CellWorld, wanted: &Isometry3<f64>, carried: &Carried, trial: &mut RobotTrial) {
    let after = cell.truth();
    let query = problem.index_of(problem.query).unwrap_or(0);
    let stands = after.objects[query].world_from_object;
    let shift = carried.grasped.as_ref().zip(carried.lifted.as_ref()).map(|(a, b)| Shift::between(a, b));
    trial.in_hand = carried.grasped.as_ref().zip(carried.lowered.as_ref()).map(|(a, b)| Shift::between(a, b));
    trial.grasped = shift.is_some_and(|s| s.by_m < IN_HAND_M);
    let off_m = (stands.translation.vector - wanted.translation.vector).norm();
    trial.off_m = Some(off_m);
    trial.tilt_rad = Some((stands.rotation * Vector3::z()).angle(&(wanted.rotation * Vector3::z())));
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
    trial.cause = if carried.reply.outcome == ExecutionOutcome::Stopped {
        Some(Cause::Stopped)
    } else if !trial.grasped {
        Some(Cause::GraspLost)
    } else if dropped || carried.reply.outcome == ExecutionOutcome::GraspLost {
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
    trial.detail = carried.reply.reason.clone().unwrap_or_default();
}
