//! Asking motion: a plan that picks and places, its execution, and the reset of a latched stop.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::checks::{check_finite, check_range};
use crate::keys::validate_chunk;
use crate::robot::{GripperCommand, SetPoint, StopState};
use crate::{CallError, Message, RigidTransform, SceneRef, limits};

/// A grasp: where the point between the fingertips goes and how wide the gripper is before it closes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Grasp {
    /// Pose of the tool centre point on the observed object; z is the approach, y the opening.
    pub world_from_tcp: RigidTransform,
    /// Opening on approach, metres.
    pub width_m: f64,
    /// Higher is better. External grasps are tried in their order in the request, whatever their scores.
    pub score: f64,
}

impl Grasp {
    /// Checks the pose and the gripper's range.
    ///
    /// # Errors
    /// `invalid_argument` that names the field below `field`.
    pub fn validate(&self, field: &str) -> Result<(), CallError> {
        self.world_from_tcp.validate(&format!("{field}.world_from_tcp"))?;
        check_range(&format!("{field}.width_m"), self.width_m, 0.0..=0.08)?;
        check_finite(&format!("{field}.score"), &[self.score])
    }
}

/// A box in the world that no part of a moving arm, nor what it holds, may enter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct KeepOutZone {
    /// What people call it.
    pub name: String,
    /// Lowest corner, world frame, metres.
    pub min_m: [f64; 3],
    /// Highest corner, world frame, metres.
    pub max_m: [f64; 3],
}

impl KeepOutZone {
    /// Checks the name and the corners.
    ///
    /// # Errors
    /// `invalid_argument` that names the field below `field`.
    pub fn validate(&self, field: &str) -> Result<(), CallError> {
        let length = self.name.chars().count();
        if length == 0 || length > limits::MAX_ZONE_NAME {
            let message = format!("expected 1 to {} characters, got {length}", limits::MAX_ZONE_NAME);
            return Err(CallError::invalid(format!("{field}.name"), message));
        }
        let furthest_m = f64::from(limits::MAX_COORDINATE_M);
        for (corner, values) in [("min_m", &self.min_m), ("max_m", &self.max_m)] {
            values.iter().try_for_each(|v| check_range(&format!("{field}.{corner}"), *v, -furthest_m..=furthest_m))?;
        }
        match (0..3).find(|k| self.min_m[*k] >= self.max_m[*k]) {
            Some(k) => {
                let message = format!("expected more than min_m in every coordinate, got {} over {}", self.max_m[k], self.min_m[k]);
                Err(CallError::invalid(format!("{field}.max_m[{k}]"), message))
            }
            None => Ok(()),
        }
    }
}

/// Plans a pick and a placement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MotionPlanRequest {
    /// The scene. The bulk form of the request encloses it.
    pub scene: SceneRef,
    /// The robot that will move.
    pub robot: String,
    /// The object to move.
    pub query: u16,
    /// Where it may go, best first.
    pub placements: Vec<RigidTransform>,
    /// Where the arm starts, radians.
    pub start_joints_rad: [f64; 7],
    /// Grasps from elsewhere, used instead of our own: best first, tried in this order; 1 to 256 of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub grasps: Option<Vec<Grasp>>,
    /// The source of every random number.
    #[serde(default)]
    pub seed: u64,
}

impl MotionPlanRequest {
    /// A request for the ranked placements of an object, with grasps of motion's own and seed 0.
    pub fn new(scene_id: String, robot: String, query: u16, placements: Vec<RigidTransform>, start_joints_rad: [f64; 7]) -> Self {
        Self { scene: SceneRef { scene_id }, robot, query, placements, start_joints_rad, grasps: None, seed: 0 }
    }
}

impl Message for MotionPlanRequest {
    const SCHEMA: &'static str = "MotionPlanRequest.v1";

    fn validate(&self) -> Result<(), CallError> {
        self.scene.validate()?;
        validate_chunk("robot", &self.robot)?;
        check_range("placements", self.placements.len() as f64, 1.0..=limits::MAX_PLACEMENTS as f64)?;
        for (i, placement) in self.placements.iter().enumerate() {
            placement.validate(&format!("placements[{i}]"))?;
        }
        check_finite("start_joints_rad", &self.start_joints_rad)?;
        if let Some(grasps) = &self.grasps {
            check_range("grasps", grasps.len() as f64, 1.0..=limits::MAX_GRASPS as f64)?;
        }
        self.grasps.iter().flatten().enumerate().try_for_each(|(i, grasp)| grasp.validate(&format!("grasps[{i}]")))
    }
}

/// Why a better-ranked placement was not chosen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NotChosen {
    /// Its rank in the request, from 0.
    pub placement: usize,
    /// What stood in the way.
    pub reason: MotionFailure,
    /// The same for a person.
    pub detail: String,
}

/// What keeps the arm from a placement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MotionFailure {
    /// No grasp on the object was found at all. No placement can be served then: it is what the call's error says, and no plan.
    NoGrasp,
    /// No grasp can be reached at the object.
    PickUnreachable,
    /// Every reachable grasp collides at the object.
    PickBlocked,
    /// No grasp can be reached at the placement.
    PlaceUnreachable,
    /// Every reachable grasp collides at the placement.
    PlaceBlocked,
    /// No collision-free path between the two was found.
    NoPath,
}

impl MotionFailure {
    /// The name on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::NoGrasp => "no_grasp",
            Self::PickUnreachable => "pick_unreachable",
            Self::PickBlocked => "pick_blocked",
            Self::PlaceUnreachable => "place_unreachable",
            Self::PlaceBlocked => "place_blocked",
            Self::NoPath => "no_path",
        }
    }
}

/// How much is heeded of the hidden parts of things, which nobody saw: a plan is looked for with all of them first, and with fewer where those leave
/// no way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Heeded {
    /// All that is believed to be there.
    Everything,
    /// Of what is in the way, all; of what is held, no more than was seen and its far side.
    Obstacles,
    /// Of what is in the way, only what was seen; of what is held, its far side too.
    Held,
}

impl Heeded {
    /// What is ignored, for a person; nothing where that is nothing.
    pub fn ignored_in_words(self) -> Option<&'static str> {
        match self {
            Self::Everything => None,
            Self::Obstacles => Some("no way is clear of what may be hidden of the held object: its unseen lower parts are ignored"),
            Self::Held => Some("no way is clear of what may be hidden: unseen parts of things are ignored, and the arm may touch some"),
        }
    }
}

/// What a stretch of a motion is for. A pick and place has them in this order, the last one only where there is a free way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// Opens the fingers and moves to a short way before the grasp.
    Standoff,
    /// Straight to the grasp.
    Approach,
    /// Closes the fingers.
    Grasp,
    /// Straight up.
    Lift,
    /// To above the placement.
    Transfer,
    /// Straight down to the release height.
    Lower,
    /// Opens the fingers.
    Release,
    /// Back along the fingers.
    Retreat,
    /// Back to where a pick and place started, out of the camera's sight; of an arm that is brought back, to the ready pose.
    Home,
}

impl Phase {
    /// The name on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Standoff => "standoff",
            Self::Approach => "approach",
            Self::Grasp => "grasp",
            Self::Lift => "lift",
            Self::Transfer => "transfer",
            Self::Lower => "lower",
            Self::Release => "release",
            Self::Retreat => "retreat",
            Self::Home => "home",
        }
    }

    /// Whether the object is between the fingers and the arm moves it.
    pub fn is_carrying(self) -> bool {
        matches!(self, Self::Lift | Self::Transfer | Self::Lower)
    }
}

impl std::fmt::Display for Phase {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.as_str())
    }
}

/// One stretch of a plan: the gripper acts first, then the arm follows the set-points.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MotionPhase {
    /// What it is for.
    pub name: Phase,
    /// What the gripper does before the arm moves.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gripper: Option<GripperCommand>,
    /// Timed set-points from the phase's own start (t = 0); may be empty.
    pub set_points: Vec<SetPoint>,
}

/// A complete, timed pick and place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MotionPlan {
    /// The scene that it was planned on.
    pub scene_id: String,
    /// The robot that it is for.
    pub robot: String,
    /// The object that it moves.
    pub query: u16,
    /// The chosen placement's rank in the request, from 0.
    pub placement: usize,
    /// Why not the better ones.
    pub not_chosen: Vec<NotChosen>,
    /// The grasp.
    pub grasp: Grasp,
    /// Where the arm must be at the start, radians.
    pub start_joints_rad: [f64; 7],
    /// How far from that it may be, radians per joint. Never further than the robot takes a stream's first set-point from where it stands.
    pub start_tolerance_rad: f64,
    /// When the scene was seen, nanoseconds since the Unix epoch.
    pub scene_stamp_ns: u64,
    /// How old the scene may be when execution starts, milliseconds.
    pub max_scene_age_ms: u64,
    /// The phases in order.
    pub phases: Vec<MotionPhase>,
    /// Length of the whole motion, milliseconds of robot time.
    pub duration_ms: f64,
    /// How much it heeds of the hidden parts of things. Sent only where that is not everything, so that whoever reads no such field may read all other
    /// plans; plans of earlier workers lack it whatever they heed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub heeded: Option<Heeded>,
}

impl MotionPlan {
    /// What is ignored of the hidden parts of things, for a person; none where all are heeded, or where that is not said.
    pub fn ignored_in_words(&self) -> Option<&'static str> {
        self.heeded.and_then(Heeded::ignored_in_words)
    }
}

impl Message for MotionPlan {
    const SCHEMA: &'static str = "MotionPlan.v1";

    fn validate(&self) -> Result<(), CallError> {
        validate_chunk("robot", &self.robot)?;
        self.grasp.validate("grasp")?;
        check_finite("start_joints_rad", &self.start_joints_rad)?;
        check_range("start_tolerance_rad", self.start_tolerance_rad, 0.0..=1.0)?;
        check_range("duration_ms", self.duration_ms, 0.0..=1e9)?;
        for (i, phase) in self.phases.iter().enumerate() {
            phase.gripper.map_or(Ok(()), |gripper| gripper.validate(&format!("phases[{i}].gripper")))?;
            let mut last_ms = f64::NEG_INFINITY;
            for (j, point) in phase.set_points.iter().enumerate() {
                let field = format!("phases[{i}].set_points[{j}]");
                point.validate(&field)?;
                if point.t_ms <= last_ms {
                    return Err(CallError::invalid(format!("{field}.t_ms"), "times must increase"));
                }
                last_ms = point.t_ms;
            }
        }
        Ok(())
    }
}

/// How an execution ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ExecutionOutcome {
    /// All phases ran.
    Done,
    /// An emergency stop, a reflex of the robot or a cancel ended it.
    Stopped,
    /// The hand did not get to the object, closed on nothing, or lost it on the way.
    GraspLost,
}

/// The outcome of an execution.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ExecuteReply {
    /// How it ended.
    pub outcome: ExecutionOutcome,
    /// The phase that it ended in.
    pub phase: Phase,
    /// Why, when not done.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Where the arm stands, radians.
    pub joints_rad: [f64; 7],
}

impl Message for ExecuteReply {
    const SCHEMA: &'static str = "ExecuteReply.v1";
}

/// Progress of an execution.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ExecuteProgress {
    /// The phase that begins.
    pub phase: Phase,
    /// Phases before it.
    pub done: usize,
    /// Phases in all.
    pub of: usize,
}

impl Message for ExecuteProgress {
    const SCHEMA: &'static str = "ExecuteProgress.v1";
}

/// What brings an arm back from where a stop has left it, in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RecoveryMove {
    /// Opens the fingers; what they held falls or stays where it stands.
    Open,
    /// Backs off along the fingers, as far as the way is free.
    Retreat,
    /// Goes to the ready pose.
    Home,
}

/// Brings an arm back: slowly, checked against a scene where one is named or enclosed. For operators.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RecoverRequest {
    /// The robot.
    pub robot: String,
    /// What it does.
    #[serde(rename = "move")]
    pub motion: RecoveryMove,
    /// The scene that the way is checked against: the newest of a camera that sees the robot. The bulk form of the request encloses it. Without one
    /// the way is only checked against the robot itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene: Option<SceneRef>,
}

impl Message for RecoverRequest {
    const SCHEMA: &'static str = "RecoverRequest.v1";

    fn validate(&self) -> Result<(), CallError> {
        self.scene.as_ref().map_or(Ok(()), SceneRef::validate)?;
        validate_chunk("robot", &self.robot)
    }
}

/// How a recovery ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RecoverReply {
    /// How it ended.
    pub outcome: ExecutionOutcome,
    /// Why, when not done.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// How far the hand backed off, metres; none for another move.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub retreated_m: Option<f64>,
    /// The scene that the way was checked against.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub checked_against: Option<String>,
    /// Where the arm stands, radians.
    pub joints_rad: [f64; 7],
}

impl Message for RecoverReply {
    const SCHEMA: &'static str = "RecoverReply.v1";
}

/// Clears a latched stop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RobotResetRequest {
    /// The robot.
    pub robot: String,
    /// The stop that is to be cleared, as the robot's state shows it: another that has latched since stays. Without it whichever is latched is cleared.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stop: Option<StopState>,
}

impl RobotResetRequest {
    /// Clears whichever stop is latched.
    pub fn new(robot: String) -> Self {
        Self { robot, stop: None }
    }
}

impl Message for RobotResetRequest {
    const SCHEMA: &'static str = "RobotResetRequest.v1";

    fn validate(&self) -> Result<(), CallError> {
        validate_chunk("robot", &self.robot)
    }
}

/// The stop is cleared.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RobotResetReply {
    /// Whether a stop was latched before.
    pub was_stopped: bool,
}

impl Message for RobotResetReply {
    const SCHEMA: &'static str = "RobotResetReply.v1";
}
