//! A robot on both networks: the cell's keys on one side, joint states and controllers on the other.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use repose_geometry::transform::to_row_major;
use repose_proto::robot::{EmergencyStop, RobotCommand, RobotMode, RobotState};
use repose_proto::{Payload, RigidTransform};
use repose_ros_messages::{
    FollowJointTrajectoryFeedback, FollowJointTrajectoryGoal, FollowJointTrajectoryResult, GripperCommandGoal, GripperCommandResult,
    JointState,
};
use repose_runtime::{Sample, Session, Shutdown, Subscription, Traffic, now_ns, refuse_a_second_driver};
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::{Interval, MissedTickBehavior};

use super::events::{Do, HandTold, Told};
use super::goal::goal_of;
use super::side::RosSide;
use super::unended::OTHERS;
use crate::config::{RobotConfig, Ros2Config};
use crate::error::BridgeError;
use crate::node::{ALL_GOALS, ActionClient, ActionTypes, Canceled, GoalHandle, Heard, Node, RosSubscription};
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
    told: mpsc::Sender<Answer>,
    /// What the ids of this process's goals have in common.
    run: [u8; 8],
    arm_unanswered: Unanswered,
    hand_unanswered: Unanswered,
}

/// The newest goal of a controller whose unanswered cancel was logged. Each goal's is logged once: the cancel is sent four times a second for as long as
/// the controller is away, which may be a weekend. For those of others, whose controller may not be there yet, the reports say it.
#[derive(Clone, Default)]
struct Unanswered(Arc<AtomicU64>);

impl Unanswered {
    fn note(&self, action: &str, number: u64, error: &BridgeError) {
        match self.is_news(number) {
            true => tracing::warn!(action, number, %error, "a cancel was not answered; it is sent again until it is"),
            false => tracing::debug!(action, number, %error, "a cancel was not answered"),
        }
    }

    fn is_news(&self, number: u64) -> bool {
        self.0.fetch_max(number, Ordering::Relaxed) < number
    }
}

/// What a controller tells.
enum Answer {
    Arm(Told),
    Hand(HandTold),
}

/// What a robot is told on both networks.
struct Heeded {
    stops: Subscription,
    /// Commands with when they came: their time to live counts from there.
    commands: mpsc::Receiver<(Instant, Sample)>,
    joints: RosSubscription<JointState>,
    told: mpsc::Receiver<Answer>,
    arm: Arc<ArmClient>,
    hand: Option<Arc<HandClient>>,
    steps: Interval,
    ending: Shutdown,
    /// Whether it is ending.
    ends: bool,
    _readers: JoinSet<()>,
}

/// What has come, or that it is time for a step.
enum Event {
    Stop(Sample),
    Told(Answer),
    Joints(Result<JointState, BridgeError>),
    Command(Instant, Sample),
    Feedback,
    /// Something stalls the fingers on their way to this goal of the hand.
    Stalled(GoalHandle),
    Step,
    /// The bridge is to end.
    End,
}

/// Runs a robot until its session closes, or until `ending` and then until nothing moves it any more.
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
    ending: Shutdown,
) -> Result<(), BridgeError> {
    let joined = tokio::select! {
        joined = join(&session, &node, &robot, &ending) => joined?,
        // Nothing was sent that would have to be canceled.
        () = ending.requested() => return Ok(()),
    };
    let (controllers, mut heeded) = joined;
    let states = session.publisher(session.cell().robot_state(&robot.name), Traffic::RobotState);

    let mut side = RosSide::new(robot.clone(), robot.arm("robots")?);
    let started = Instant::now();
    let now_ms = || started.elapsed().as_millis() as u64;
    let (mut next_state, mut shown, mut feedback) = (Instant::now(), None::<(RobotMode, Option<String>)>, 0u64);
    while let Some(event) = heeded.next().await {
        match event {
            // Whatever comes here stops the arm: its form does not matter.
            Event::Stop(sample) => side.emergency_stop(&EmergencyStop::read(&sample.payload.bytes)),
            Event::Told(Answer::Arm(told)) => side.told(told, now_ms()),
            Event::Told(Answer::Hand(told)) => side.told_by_hand(told, now_ms()),
            Event::Joints(Ok(state)) => side.joints(&state, now_ms()),
            Event::Joints(Err(error)) => reports.warn(&robot.name, "joints", &format!("{}: {error}", robot.joint_states)),
            // What would clear the stop, or begin something new, comes too late.
            Event::Command(..) if heeded.ends => {}
            Event::Command(arrived, sample) => {
                let command = sample.payload.decode_json::<RobotCommand>();
                let arrived_ms = arrived.saturating_duration_since(started).as_millis() as u64;
                match command.and_then(|command| side.command(&command, arrived_ms, now_ms())) {
                    Ok(todo) => todo.into_iter().for_each(|todo| controllers.carry_out(todo)),
                    // Repeats are refused as a matter of course.
                    Err(error) => tracing::debug!(robot = robot.name, %error, "a command was not taken"),
                }
            }
            Event::Feedback => feedback += 1,
            Event::Stalled(goal) => {
                controllers.number(goal).into_iter().for_each(|number| side.told_by_hand(HandTold::Stalled(number), now_ms()));
            }
            Event::Step => {}
            Event::End => side.end(),
        }
        if robot.world_from_base.is_none()
            && let Some(pose) = tree.newest(&config.world_frame, &robot.base_frame)
        {
            side.stands(RigidTransform(to_row_major(&pose)));
        }
        side.step(now_ms()).into_iter().for_each(|todo| controllers.carry_out(todo));
        if heeded.ends && side.has_ended() {
            break;
        }
        // They, too, take a while to come at the start.
        let untold = side.untold(now_ms()).filter(|_| now_ms() > robot.controller_timeout_ms);
        reports.standing(&robot.name, "joints", untold);
        let shown_mode = shown.as_ref().map(|(mode, _)| *mode);
        let Some(state) = due(&mut side, &mut next_state, shown_mode, now_ms()) else { continue };
        // Frames take a while to come at the start.
        let lost = side.unknown_base().filter(|_| now_ms() > robot.controller_timeout_ms);
        reports.standing(&robot.name, "base", lost.clone());
        let now_shown = (state.mode, why(&state, side.overdue_cancels(now_ms()).or(lost)));
        if shown.as_ref() != Some(&now_shown) {
            tracing::info!(robot = robot.name, mode = ?now_shown.0, why = now_shown.1, "robot");
            reports.robot(&robot.name, now_shown.0, now_shown.1.clone());
        }
        shown = Some(now_shown);
        reports.count(&robot.name, "feedback", feedback);
        // What the network refuses now it may take with the next state.
        let _ = states.put(Payload::json(&state)?).await;
    }
    Ok(())
}

/// Joins both networks.
async fn join(session: &Session, node: &Node, robot: &RobotConfig, ending: &Shutdown) -> Result<(Controllers, Heeded), BridgeError> {
    refuse_a_second_driver(session, &robot.name).await?;
    let (controllers, told) = Controllers::of(node, robot).await?;
    let heeded = Heeded::of(session, node, robot, &controllers, told, ending).await?;
    Ok((controllers, heeded))
}

/// Why the robot is stopped, with what keeps that from being cleared.
fn why(state: &RobotState, keeps: Option<String>) -> Option<String> {
    let stop = state.stop.as_ref()?;
    let beside = keeps.map_or_else(String::new, |keeps| format!("; {keeps}"));
    Some(format!("{}: {}{beside}", stop.kind, stop.reason))
}

impl Heeded {
    async fn of(
        session: &Session,
        node: &Node,
        robot: &RobotConfig,
        controllers: &Controllers,
        told: mpsc::Receiver<Answer>,
        ending: &Shutdown,
    ) -> Result<Self, BridgeError> {
        let cell = session.cell();
        let mut steps = tokio::time::interval(STEP);
        steps.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut readers = JoinSet::new();
        Ok(Self {
            stops: session.subscribe_queue(&cell.robot_estop(&robot.name), WAITING).await?,
            commands: dated(session.subscribe_queue(&cell.robot_command(&robot.name), WAITING).await?, &mut readers),
            joints: node.subscribe(&robot.joint_states, "sensor_msgs/msg/JointState", Qos::DEFAULT).await?,
            told,
            arm: controllers.arm.clone(),
            hand: controllers.hand.clone(),
            steps,
            ending: ending.clone(),
            ends: false,
            _readers: readers,
        })
    }

    /// What comes next, stops first; none when a session has closed.
    async fn next(&mut self) -> Option<Event> {
        loop {
            return tokio::select! {
                biased;
                sample = self.stops.recv() => sample.map(Event::Stop),
                () = self.ending.requested(), if !self.ends => {
                    self.ends = true;
                    Some(Event::End)
                }
                Some(told) = self.told.recv() => Some(Event::Told(told)),
                message = self.joints.recv() => message.map(Event::Joints),
                command = self.commands.recv() => command.map(|(arrived, sample)| Event::Command(arrived, sample)),
                heard = self.arm.heard() => match heard {
                    Heard::Feedback(_) => Some(Event::Feedback),
                    _ => continue,
                },
                goal = stalled(self.hand.as_deref()) => Some(Event::Stalled(goal)),
                _ = self.steps.tick() => Some(Event::Step),
            };
        }
    }
}

/// What comes on a subscription with when it came, though it may be taken late; `readers` keeps the task.
fn dated(mut samples: Subscription, readers: &mut JoinSet<()>) -> mpsc::Receiver<(Instant, Sample)> {
    let (came, dated) = mpsc::channel(WAITING);
    readers.spawn(async move {
        while let Some(sample) = samples.recv().await {
            if came.send((Instant::now(), sample)).await.is_err() {
                return;
            }
        }
    });
    dated
}

/// The state, where it is time for one or the mode is another.
fn due(side: &mut RosSide, next: &mut Instant, shown: Option<RobotMode>, now_ms: u64) -> Option<RobotState> {
    let state = side.state(now_ms, now_ns())?;
    let now = Instant::now();
    if now < *next && shown == Some(state.mode) {
        return None;
    }
    *next = now + STATES;
    Some(state)
}

/// The next goal of which the hand's controller tells by itself that something stalls the fingers.
async fn stalled(hand: Option<&HandClient>) -> GoalHandle {
    let Some(hand) = hand else { return std::future::pending().await };
    loop {
        if let Heard::Feedback(told) = hand.heard().await
            && told.feedback.stalled
        {
            return told.goal_id;
        }
    }
}

impl Controllers {
    async fn of(node: &Node, robot: &RobotConfig) -> Result<(Self, mpsc::Receiver<Answer>), BridgeError> {
        let (told, receiver) = mpsc::channel(WAITING);
        let arm = Arc::new(ActionClient::new(node, &robot.trajectory_action, ActionTypes::FOLLOW_JOINT_TRAJECTORY).await?);
        let hand = match &robot.gripper_action {
            Some(action) => Some(Arc::new(ActionClient::new(node, action, ActionTypes::GRIPPER_COMMAND).await?)),
            None => None,
        };
        let patience = Duration::from_millis(robot.controller_timeout_ms);
        let run = (uuid::Uuid::new_v4().as_u128() as u64).to_be_bytes();
        let (arm_unanswered, hand_unanswered) = (Unanswered::default(), Unanswered::default());
        Ok((Self { arm, hand, patience, told, run, arm_unanswered, hand_unanswered }, receiver))
    }

    /// The id of the goal of that number.
    fn id(&self, number: u64) -> GoalHandle {
        if number == OTHERS {
            return ALL_GOALS;
        }
        let mut uuid = [0; 16];
        uuid[..8].copy_from_slice(&self.run);
        uuid[8..].copy_from_slice(&number.to_be_bytes());
        GoalHandle { uuid }
    }

    /// The number of the goal of that id, where it is one of this process's.
    fn number(&self, id: GoalHandle) -> Option<u64> {
        let (run, number) = id.uuid.split_at(8);
        (run == self.run).then(|| u64::from_be_bytes(number.try_into().unwrap_or_default()))
    }

    /// Has something done; what comes of it is told.
    fn carry_out(&self, todo: Do) {
        let (told, patience) = (self.told.clone(), self.patience);
        match todo {
            Do::Follow(number, trajectory) => {
                let (id, arm) = (self.id(number), self.arm.clone());
                let last = trajectory.points.last().map_or(0.0, |point| point.time_from_start.as_ms());
                let longest = Duration::from_secs_f64(last * 1e-3) + RESULT_MARGIN;
                tracing::info!(action = arm.name(), points = trajectory.points.len(), duration_ms = last, "trajectory");
                tokio::spawn(async move { follow(&arm, (number, id), goal_of(trajectory), (patience, longest), &told).await });
            }
            Do::Cancel(number) => {
                let (id, arm, unanswered) = (self.id(number), self.arm.clone(), self.arm_unanswered.clone());
                tokio::spawn(async move {
                    // It is canceled again until its end is told, or the controller says that there is nothing to cancel.
                    match arm.cancel(id, patience).await {
                        Ok(Canceled::NotThere) => drop(told.send(Answer::Arm(Told::NotThere(number))).await),
                        Ok(Canceled::Ending) => drop(told.send(Answer::Arm(Told::Ending(number))).await),
                        Ok(answer) => tracing::debug!(action = arm.name(), number, ?answer, "a goal was canceled"),
                        Err(error) => unanswered.note(arm.name(), number, &error),
                    }
                });
            }
            Do::CancelGrip(number) => {
                let Some(hand) = self.hand.clone() else { return };
                let (id, unanswered) = (self.id(number), self.hand_unanswered.clone());
                tokio::spawn(async move {
                    // It is canceled again until its end is told, or, where that was not heard of, the controller says that there is nothing to cancel.
                    match hand.cancel(id, patience).await {
                        Ok(Canceled::NotThere) => drop(told.send(Answer::Hand(HandTold::NotThere(number))).await),
                        Ok(answer) => tracing::debug!(action = hand.name(), number, ?answer, "a goal was canceled"),
                        Err(error) => unanswered.note(hand.name(), number, &error),
                    }
                });
            }
            Do::Grip(number, position, max_effort) => {
                let Some(hand) = self.hand.clone() else { return };
                let id = self.id(number);
                tokio::spawn(async move {
                    let goal = GripperCommandGoal { position, max_effort };
                    drop(told.send(Answer::Hand(grip(&hand, (number, id), goal, patience).await)).await);
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
    told: &mpsc::Sender<Answer>,
) {
    let answer = match arm.send(id, goal, patience).await {
        Ok(true) => Told::Accepted(number),
        Ok(false) => Told::Refused(number, format!("{} refused the goal", arm.name())),
        Err(error) => Told::Unanswered(number, error.to_string()),
    };
    let accepted = matches!(answer, Told::Accepted(_));
    drop(told.send(Answer::Arm(answer)).await);
    if accepted {
        let ended = match arm.result(id, longest).await {
            Ok(response) => Told::Ended(number, response.status, response.result),
            Err(error) => Told::Lost(number, error.to_string()),
        };
        drop(told.send(Answer::Arm(ended)).await);
    }
}

/// Sends the hand's goal and waits for its result; what came of it.
async fn grip(hand: &HandClient, (number, id): (u64, GoalHandle), goal: GripperCommandGoal, patience: Duration) -> HandTold {
    match hand.send(id, goal, patience).await {
        Ok(true) => {}
        Ok(false) => return HandTold::Refused(number, format!("{} refused the goal", hand.name())),
        Err(error) => return HandTold::Lost(number, error.to_string()),
    }
    match hand.result(id, RESULT_MARGIN).await {
        Ok(response) => HandTold::Ended(number, response.status, response.result),
        Err(error) => HandTold::Lost(number, error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cancel_that_is_not_answered_for_a_weekend_is_said_once_a_goal_and_never_of_those_of_others() {
        let unanswered = Unanswered::default();
        let said = [OTHERS, OTHERS, 3, 3, 5, 3, 5].map(|number| unanswered.is_news(number));
        assert_eq!(said, [false, false, true, false, true, false, false]);
    }
}
