//! A robot on both networks: the cell's keys on one side, joint states and controllers on the other.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use repose_geometry::transform::to_row_major;
use repose_proto::robot::{EmergencyStop, RobotCommand, RobotMode};
use repose_proto::{CallError, Payload, RigidTransform};
use repose_ros_messages::{
    FollowJointTrajectoryFeedback, FollowJointTrajectoryGoal, FollowJointTrajectoryResult, GripperCommandGoal, GripperCommandResult,
    JointState,
};
use repose_runtime::{Session, Traffic, refuse_a_second_driver};
use tokio::sync::mpsc;
use tokio::time::MissedTickBehavior;

use super::goal::goal_of;
use super::side::{Do, RosSide, Told};
use crate::config::{RobotConfig, Ros2Config};
use crate::error::BridgeError;
use crate::node::{ActionClient, ActionTypes, GoalHandle, Heard, Node, now_ns};
use crate::report::Reports;
use crate::tree::Tree;
use crate::wire::names::Qos;

/// Between two steps.
const STEP: Duration = Duration::from_millis(4);
/// Between two states.
const STATES: Duration = Duration::from_millis(20);
/// Commands and stops that may wait for the next step.
const WAITING: usize = 64;
/// How much longer than its trajectory a result is waited for.
const RESULT_MARGIN: Duration = Duration::from_secs(30);

type ArmClient = ActionClient<FollowJointTrajectoryGoal, FollowJointTrajectoryResult, FollowJointTrajectoryFeedback>;
type HandClient = ActionClient<GripperCommandGoal, GripperCommandResult, GripperCommandResult>;

/// The controllers, and the way back of what they tell.
struct Controllers {
    arm: Arc<ArmClient>,
    hand: Option<Arc<HandClient>>,
    patience: Duration,
    told: mpsc::Sender<Told>,
    /// The ids of goals under way, by number.
    ids: BTreeMap<u64, GoalHandle>,
}

/// Runs a robot until its session closes.
///
/// # Errors
/// When another driver of that name is there, or a network refuses.
pub async fn run(
    session: Session,
    node: Node,
    config: Arc<Ros2Config>,
    robot: RobotConfig,
    tree: Tree,
    reports: Reports,
) -> Result<(), BridgeError> {
    refuse_a_second_driver(&session, &robot.name).await?;
    let cell = session.cell().clone();
    let mut stops = session.subscribe_queue(&cell.robot_estop(&robot.name), WAITING).await?;
    let mut commands = session.subscribe_queue(&cell.robot_command(&robot.name), WAITING).await?;
    let states = session.publisher(cell.robot_state(&robot.name), Traffic::RobotState);
    let mut joints = node.subscribe::<JointState>(&robot.joint_states, "sensor_msgs/msg/JointState", Qos::DEFAULT).await?;
    let (mut controllers, mut told) = Controllers::of(&node, &robot).await?;

    let mut side = RosSide::new(robot.clone());
    let started = Instant::now();
    let now_ms = || started.elapsed().as_millis() as u64;
    let mut steps = tokio::time::interval(STEP);
    steps.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let (mut next_state, mut shown, mut feedback) = (Instant::now(), None, 0u64);
    let (arm, hand) = (controllers.arm.clone(), controllers.hand.clone());
    loop {
        tokio::select! {
            biased;
            sample = stops.recv() => match sample {
                // Whatever comes here stops the arm: its form is of no matter.
                Some(sample) => side.emergency_stop(&EmergencyStop::read(&sample.payload.bytes)),
                None => return Ok(()),
            },
            Some(told) = told.recv() => side.told(told, now_ms()),
            message = joints.recv() => match message {
                Some(Ok(state)) => side.joints(&state, now_ms()),
                Some(Err(error)) => reports.warn(&robot.name, format!("{}: {error}", robot.joint_states)),
                None => return Ok(()),
            },
            sample = commands.recv() => {
                let Some(sample) = sample else { return Ok(()) };
                let taken = sample.payload.decode_json::<RobotCommand>().and_then(|command| side.command(&command, now_ms(), now_ms()));
                match taken {
                    Ok(todo) => todo.into_iter().for_each(|todo| controllers.carry_out(todo)),
                    // Repeats are refused as a matter of course.
                    Err(error) => tracing::debug!(robot = robot.name, %error, "a command was not taken"),
                }
            }
            heard = arm.heard() => feedback += u64::from(matches!(heard, Heard::Feedback(_))),
            () = drained(hand.as_deref()) => {}
            _ = steps.tick() => {}
        }
        if robot.world_from_base.is_none()
            && let Some(pose) = tree.newest(&config.world_frame, &robot.base_frame)
        {
            side.stands(RigidTransform(to_row_major(&pose)));
        }
        side.step(now_ms()).into_iter().for_each(|todo| controllers.carry_out(todo));
        let Some(state) = due(&mut side, &mut next_state, shown, now_ms()) else { continue };
        if shown != Some(state.mode) {
            let why = state.stop.as_ref().map(|stop| format!("{}: {}", stop.kind, stop.reason));
            tracing::info!(robot = robot.name, mode = ?state.mode, why, "robot");
            reports.robot(&robot.name, state.mode, why);
        }
        shown = Some(state.mode);
        reports.count(&robot.name, "feedback", feedback);
        // What the network refuses now it may take with the next state.
        let _ = states.put(Payload::json(&state)?).await;
    }
}

/// The state, where it is time for one or the mode is another.
fn due(side: &mut RosSide, next: &mut Instant, shown: Option<RobotMode>, now_ms: u64) -> Option<repose_proto::robot::RobotState> {
    let state = side.state(now_ms, now_ns())?;
    let now = Instant::now();
    if now < *next && shown == Some(state.mode) {
        return None;
    }
    *next = now + STATES;
    Some(state)
}

/// Takes what the hand's controller tells by itself, which nobody needs.
async fn drained(hand: Option<&HandClient>) {
    match hand {
        Some(hand) => drop(hand.heard().await),
        None => std::future::pending().await,
    }
}

impl Controllers {
    async fn of(node: &Node, robot: &RobotConfig) -> Result<(Self, mpsc::Receiver<Told>), BridgeError> {
        let (told, receiver) = mpsc::channel(WAITING);
        let arm = Arc::new(ActionClient::new(node, &robot.trajectory_action, ActionTypes::FOLLOW_JOINT_TRAJECTORY).await?);
        let hand = match &robot.gripper_action {
            Some(action) => Some(Arc::new(ActionClient::new(node, action, ActionTypes::GRIPPER_COMMAND).await?)),
            None => None,
        };
        let patience = Duration::from_millis(robot.controller_timeout_ms);
        Ok((Self { arm, hand, patience, told, ids: BTreeMap::new() }, receiver))
    }

    /// Has something done; what comes of it is told.
    fn carry_out(&mut self, todo: Do) {
        let (told, patience) = (self.told.clone(), self.patience);
        match todo {
            Do::Follow(number, trajectory) => {
                let id = new_id();
                self.ids.retain(|held, _| held + 8 > number);
                self.ids.insert(number, id);
                let arm = self.arm.clone();
                let last = trajectory.points.last().map_or(0.0, |point| point.time_from_start.as_ms());
                let longest = Duration::from_secs_f64(last * 1e-3) + RESULT_MARGIN;
                tracing::info!(action = arm.name(), points = trajectory.points.len(), duration_ms = last, "trajectory");
                tokio::spawn(async move { follow(&arm, (number, id), goal_of(trajectory), (patience, longest), &told).await });
            }
            Do::Cancel(number) => {
                let Some(id) = self.ids.get(&number).copied() else { return };
                let arm = self.arm.clone();
                tokio::spawn(async move {
                    if let Err(error) = arm.cancel(id, patience).await {
                        tracing::error!(action = arm.name(), %error, "a goal could not be canceled");
                    }
                });
            }
            Do::Grip(number, position, max_effort) => {
                let Some(hand) = self.hand.clone() else { return };
                tokio::spawn(async move {
                    let goal = GripperCommandGoal { position, max_effort };
                    let result = grip(&hand, goal, patience).await;
                    if let Err(error) = &result {
                        tracing::warn!(action = hand.name(), %error, "the gripper's goal came to nothing");
                    }
                    drop(told.send(Told::Gripped(number, result.ok())).await);
                });
            }
        }
    }
}

/// Sends the arm's goal and waits for its result, telling each step.
async fn follow(
    arm: &ArmClient,
    (number, id): (u64, GoalHandle),
    goal: FollowJointTrajectoryGoal,
    (patience, longest): (Duration, Duration),
    told: &mpsc::Sender<Told>,
) {
    let answer = match arm.send(id, goal, patience).await {
        Ok(true) => Told::Accepted(number),
        Ok(false) => Told::Refused(number, format!("{} refused the goal", arm.name())),
        Err(error) => Told::Refused(number, error.to_string()),
    };
    let accepted = matches!(answer, Told::Accepted(_));
    drop(told.send(answer).await);
    if accepted {
        let ended = match arm.result(id, longest).await {
            Ok(response) => Told::Ended(number, response.status, response.result),
            Err(error) => Told::Lost(number, error.to_string()),
        };
        drop(told.send(ended).await);
    }
}

async fn grip(hand: &HandClient, goal: GripperCommandGoal, patience: Duration) -> Result<GripperCommandResult, BridgeError> {
    let id = new_id();
    if !hand.send(id, goal, patience).await? {
        return Err(CallError::precondition(format!("{} refused the goal", hand.name())).into());
    }
    Ok(hand.result(id, RESULT_MARGIN).await?.result)
}

fn new_id() -> GoalHandle {
    GoalHandle { uuid: *uuid::Uuid::new_v4().as_bytes() }
}
