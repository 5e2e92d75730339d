//! What a robot of ROS 2 does of what its cell commands, by the rules that the simulated robot is under too.
//!
//! The rules of the contract are those of [`Arm`], which follows every stream in step with the controller: owners and epochs, repeats, times to
//! live, limits, stops that latch, commanders that fall silent. A controller takes whole trajectories, so a stream has to come whole
//! ([`HORIZON_MS`] asks for that); it is followed in thought before the controller gets it, and one that breaks a rule never does. The arm
//! counts as started when the controller accepts, and as arrived when the controller says so. A controller that refuses, aborts or falls silent
//! latches a stop, the arm's and the hand's alike, and so does the start of this process. A stop, whoever latches it, cancels every goal that is not
//! known to have ended, again and again until each has, and is not cleared before the arm's have; the hand's goal too, unless something is between the
//! fingers, and also after the stop: a hand's controller that is gone does not keep the arm stopped. What processes before this one left is such a
//! goal, and at an emergency stop what other clients may have sent. Then the arm stands where its joints are measured, and so does one that nobody
//! here moves and whose joints are moved all the same.
//!
//! Another trajectory takes the place of one on its way from [`REPLACE_LEAD_MS`] ahead: see there.
//!
//! Pure: events and time come in, what is to be done goes out.

use repose_panda::held_off::HELD_OFF_RAD;
use repose_proto::robot::{EmergencyStop, RobotCommand, RobotMode, RobotState, SetPoint};
use repose_proto::{CallError, RigidTransform};
use repose_robot_side::{Arm, ArmSettings, StateDetails, TICK_S, state_of};
use repose_ros_messages::{FollowJointTrajectoryResult, JointState, status};

use super::events::{Do, HandTold, Told};
use super::goal::{Goal, GoalState, Handover, REPLACE_LEAD_MS};
use super::hand::Hand;
use super::measured::Measured;
use super::unended::Unended;
use crate::config::RobotConfig;

/// How far ahead set-points are asked for, milliseconds: the whole of any stream.
pub const HORIZON_MS: u64 = 600_000;
/// Joints that were not told of for so long are not known any more, milliseconds.
const JOINTS_OLD_MS: u64 = 500;
/// Longest time that a step makes up for while no controller moves the arm, seconds.
const CATCH_UP_S: f64 = 0.06;
/// By how much joint states, and a controller's word that it has begun, may be late, milliseconds. An arm on its way follows when its joints are
/// where the stream has them within that time.
const LATE_MS: f64 = 250.0;
/// How far the joints may be measured from where a stream starts, radians: a controller goes to its first point within milliseconds from where they
/// are.
const START_OFF_RAD: f64 = 0.02;
/// How far a controller is taken to be ahead of the arm's stream at most when another goal comes to it, milliseconds.
const MOST_AHEAD_MS: u64 = 50;
/// By how much a result may follow the end of the trajectory before it is overdue, beside the controller's time, milliseconds.
const SLACK_MS: f64 = 1000.0;

/// One robot.
pub struct RosSide {
    config: RobotConfig,
    settings: ArmSettings,
    arm: Option<Arm>,
    measured: Measured,
    hand: Hand,
    /// The goal that the arm follows.
    goal: Option<Goal>,
    /// That one, and those before it and of others that may not have ended.
    unended: Unended,
    goals: u64,
    /// The least time that the controller has taken to accept a goal, milliseconds, and no more than [`MOST_AHEAD_MS`].
    accepts_in_ms: u64,
    /// When the arm last arrived on a goal, milliseconds.
    arrived_ms: Option<u64>,
    /// The stream that the controller has.
    stream: Vec<SetPoint>,
    world_from_base: Option<RigidTransform>,
    stepped_ms: u64,
    owed_s: f64,
    ticks: u64,
    states: u64,
}

impl RosSide {
    /// A robot of which nothing is known yet.
    pub fn new(config: RobotConfig, settings: ArmSettings) -> Self {
        Self {
            measured: Measured::new(&config),
            hand: Hand::found(config.gripper_action.is_some()),
            world_from_base: config.world_from_base,
            config,
            settings,
            arm: None,
            goal: None,
            unended: Unended::default(),
            goals: 0,
            accepts_in_ms: MOST_AHEAD_MS,
            arrived_ms: None,
            stream: Vec::new(),
            stepped_ms: 0,
            owed_s: 0.0,
            ticks: 0,
            states: 0,
        }
    }

    /// The joints that nobody has told of yet; those of fingers where there is a hand to move.
    pub fn missing(&self) -> Vec<&str> {
        let fingers = self.config.gripper_action.iter().flat_map(|_| self.measured.missing_fingers());
        self.measured.missing().into_iter().chain(fingers).collect()
    }

    /// What is to be said of joints that nobody tells of: there is no state without the arm's, and without the fingers' nobody knows how far they are
    /// apart.
    pub fn untold(&self, now_ms: u64) -> Option<String> {
        let (topic, missing) = (&self.config.joint_states, self.missing());
        if !missing.is_empty() {
            let names = missing.join(", ");
            return Some(format!("{topic} does not tell of {names}: set joints and finger_joints to the names that are told there"));
        }
        let is_old = self.measured.age_ms(now_ms).is_none_or(|age_ms| age_ms > JOINTS_OLD_MS);
        is_old.then(|| format!("{topic} has not told of all joints for more than {JOINTS_OLD_MS} ms: the robot shows no state meanwhile"))
    }

    /// Says where its base stands.
    pub fn stands(&mut self, world_from_base: RigidTransform) {
        self.world_from_base = Some(world_from_base);
    }

    /// What is to be said of a robot whose place is not known. Commanders would take it to be where they are configured to.
    pub fn unknown_base(&self) -> Option<String> {
        let frame = &self.config.base_frame;
        let say = || {
            format!(
                "the base is not known: frame {frame} is not in the tree of fixed frames (/tf_static) under the world's; set base_frame or \
                 world_from_base"
            )
        };
        self.world_from_base.is_none().then(say)
    }

    /// Takes joint states.
    pub fn joints(&mut self, state: &JointState, now_ms: u64) {
        let whole = self.measured.take(state, now_ms);
        if let Some(width_m) = self.measured.width_m() {
            self.hand.measured(width_m, now_ms);
        }
        let Some(q_rad) = self.measured.q_rad().filter(|_| whole) else { return };
        let (is_on_its_way, may_be_late) = (self.is_on_its_way(&q_rad), self.may_be_late(now_ms));
        let settings = self.settings;
        if self.arm.is_none() {
            // What an earlier process had sent is whole in the controller, and may still move the arm.
            self.unended.others_may_have_sent();
        }
        let arm = self.arm.get_or_insert_with(|| Arm::found_at(q_rad, settings, now_ms as f64 * 1e-3, None));
        // While the controller has not begun, the arm's stream has not either.
        if !is_on_its_way && self.goal.is_none_or(|goal| goal.state != GoalState::Sent) {
            arm.measured(&q_rad);
        }
        // Others may move an arm that nobody here does. The next stream of an open task begins where the last one ended.
        let is_free = arm.mode() == RobotMode::Idle && self.goal.is_none() && arm.task().is_none() && !may_be_late;
        if arm.stop().is_some() || (is_free && self.measured.off_rad(arm.q_rad()) > HELD_OFF_RAD) {
            arm.settle(&q_rad);
        }
    }

    /// Whether the joints may have been told of as they were before the arm arrived.
    fn may_be_late(&self, now_ms: u64) -> bool {
        self.arrived_ms.is_some_and(|arrived_ms| (now_ms.saturating_sub(arrived_ms) as f64) < LATE_MS)
    }

    /// Whether the controller's stream has, had or will have the joints here within [`LATE_MS`].
    fn is_on_its_way(&self, q_rad: &[f64; 7]) -> bool {
        let Some(now_ms) = self.goal.and(self.arm.as_ref()).and_then(Arm::stream_ms) else { return false };
        let tolerance_rad = self.config.following_tolerance_rad;
        let near = |point: &SetPoint| point.q_rad.iter().zip(q_rad).all(|(set, measured)| (set - measured).abs() <= tolerance_rad);
        self.stream.iter().any(|point| (point.t_ms - now_ms).abs() <= LATE_MS && near(point))
    }

    /// Takes an emergency stop. Whoever moves the arm: other clients may have goals at the same controller.
    pub fn emergency_stop(&mut self, stop: &EmergencyStop) {
        if let Some(arm) = &mut self.arm {
            arm.emergency_stop(stop);
            self.unended.others_may_have_sent();
        }
    }

    /// The process is to end: what moves the arm is canceled.
    pub fn end(&mut self) {
        let is_under_way = !self.unended.is_empty();
        if let Some(arm) = self.arm.as_mut().filter(|arm| is_under_way && arm.stop().is_none()) {
            arm.fault("driver_ended", "the bridge is ending".to_owned());
        }
    }

    /// Whether every goal of the arm has ended.
    pub fn has_ended(&self) -> bool {
        self.unended.is_empty()
    }

    /// Why a stop cannot be cleared now.
    fn not_ready(&self) -> Option<String> {
        if !self.unended.is_empty() {
            return Some("a controller may still be carrying out a goal".to_owned());
        }
        self.unknown_base()
    }

    /// Takes a command that came at `received_ms`.
    ///
    /// # Errors
    /// Why it was not taken.
    pub fn command(&mut self, command: &RobotCommand, received_ms: u64, now_ms: u64) -> Result<Option<Do>, CallError> {
        let is_stopped = self.arm.as_ref().is_some_and(|arm| arm.stop().is_some());
        if let Some(why) = self.not_ready().filter(|_| command.clear_stop && is_stopped) {
            return Err(CallError::precondition(format!("the stop cannot be cleared: {why}")));
        }
        let may_be_late = self.may_be_late(now_ms);
        let Some(arm) = &mut self.arm else { return Err(CallError::precondition("the joints are not known yet")) };
        let was_moving = arm.mode() == RobotMode::Moving;
        let refused = |why: String| CallError::precondition(format!("command {} of {}: {why}", command.seq, command.owner.id));
        let first = command.set_points.first();
        let off_rad = first.filter(|_| command.starts_stream).map_or(0.0, |first| self.measured.off_rad(&first.q_rad));
        if off_rad > START_OFF_RAD && may_be_late && arm.mode() == RobotMode::Idle {
            return Err(refused("the joints are not told of yet where the stream starts".to_owned()));
        }
        arm.late_command(command, received_ms as f64 * 1e-3, now_ms as f64 * 1e-3).map_err(|why| refused(why.to_string()))?;
        if arm.mode() != RobotMode::Moving || command.set_points.is_empty() {
            return Ok(None);
        }
        if command.starts_stream {
            if off_rad > START_OFF_RAD {
                arm.fault("start_pose_mismatch", format!("a joint was measured {off_rad:.4} rad from where the stream starts"));
                return Ok(None);
            }
            if !command.ends_stream {
                let reason = "a controller of ROS takes whole trajectories, and the command's set-points end before its stream does";
                arm.fault("horizon_too_short", reason.to_owned());
                return Ok(None);
            }
            let at = Handover { from_ms: command.set_points[0].t_ms, lead_ms: 0.0 };
            self.stream.clone_from(&command.set_points);
            return Ok(self.follow(at, GoalState::Sent, now_ms));
        }
        if !was_moving {
            return Ok(None);
        }
        let kept = self.stream.partition_point(|p| p.t_ms < command.set_points[0].t_ms);
        let stream = [&self.stream[..kept], &command.set_points[..]].concat();
        Ok(self.replace(stream, now_ms))
    }

    /// Hands another stream to a controller that is on its way, where it is another one for it. The controller is ahead of the arm's stream when that
    /// comes to it: its word that it has begun took a while to come, and this takes a while to get there. Both together are what it takes to accept
    /// a goal.
    fn replace(&mut self, stream: Vec<SetPoint>, now_ms: u64) -> Option<Do> {
        let followed_ms = self.arm.as_ref().and_then(Arm::stream_ms).unwrap_or(0.0);
        // A goal that was not accepted yet still is to be begun; one that was goes on under the new one.
        let (state, ahead_ms) = match self.goal {
            Some(Goal { state: GoalState::Sent, since_ms, .. }) => {
                (GoalState::Sent, now_ms.saturating_sub(since_ms).min(self.accepts_in_ms))
            }
            _ => (GoalState::Accepted, self.accepts_in_ms),
        };
        let at = Handover { from_ms: followed_ms + ahead_ms as f64, lead_ms: REPLACE_LEAD_MS };
        let is_the_same = at.rest(&self.stream) == at.rest(&stream);
        self.stream = stream;
        if is_the_same { None } else { self.follow(at, state, now_ms) }
    }

    /// Hands the stream to the controller, unless the arm would break a rule on it.
    fn follow(&mut self, at: Handover, state: GoalState, now_ms: u64) -> Option<Do> {
        let arm = self.arm.as_mut()?;
        let end_ms = self.stream.last()?.t_ms;
        let left_ms = end_ms - arm.stream_ms().unwrap_or(0.0);
        if let Some((kind, reason)) = broken_rule(arm, left_ms, now_ms) {
            arm.fault(&kind, reason);
            return None;
        }
        if !self.unended.has_room() {
            arm.fault("controller_silent", "too many goals of the controller have not ended".to_owned());
            return None;
        }
        self.goals += 1;
        self.unended.sent(self.goals);
        let duration_ms = left_ms.max(at.lead_ms);
        self.goal = Some(Goal { number: self.goals, state, since_ms: now_ms, duration_ms });
        Some(Do::Follow(self.goals, at.trajectory(&self.config.joints, &self.stream)))
    }

    /// Takes an answer of the arm's controller.
    pub fn told(&mut self, told: Told, now_ms: u64) {
        let (Told::Accepted(number)
        | Told::Refused(number, _)
        | Told::Unanswered(number, _)
        | Told::Ended(number, ..)
        | Told::Lost(number, _)
        | Told::Ending(number)
        | Told::NotThere(number)) = &told;
        match &told {
            Told::Accepted(_) => self.unended.accepted(*number),
            Told::Ended(_, status::SUCCEEDED, _) => self.unended.arrived(*number),
            Told::Refused(..) | Told::Ended(..) => self.unended.ended(*number),
            Told::Ending(_) => self.unended.ending(*number, now_ms),
            Told::NotThere(_) => self.unended.not_there(*number, now_ms, self.config.controller_timeout_ms),
            Told::Unanswered(..) | Told::Lost(..) => {}
        }
        // Of a goal whose place another has taken, or that is being canceled, nothing else is to be learnt.
        let Some(goal) = self.goal.filter(|goal| goal.number == *number) else { return };
        let Some(arm) = &mut self.arm else { return };
        let mut fault = |kind: &str, reason: String| {
            self.goal = None;
            if arm.stop().is_none() {
                arm.fault(kind, reason);
            }
        };
        match told {
            Told::Accepted(_) if goal.state == GoalState::Sent => {
                self.accepts_in_ms = self.accepts_in_ms.min(now_ms.saturating_sub(goal.since_ms));
                self.goal = Some(Goal { state: GoalState::Accepted, since_ms: now_ms, ..goal });
                self.owed_s = 0.0;
            }
            Told::Accepted(_) | Told::Ending(_) | Told::NotThere(_) => {}
            Told::Refused(_, why) => fault("controller_refused", why),
            Told::Unanswered(_, why) | Told::Lost(_, why) => fault("controller_silent", why),
            Told::Ended(_, status::SUCCEEDED, _) => {
                self.goal = None;
                self.arrived_ms = Some(now_ms);
            }
            Told::Ended(_, state, result) => {
                let FollowJointTrajectoryResult { error_code, error_string } = result;
                fault("controller_aborted", format!("the goal ended {}: {error_string} (error {error_code})", status::name(state)));
            }
        }
    }

    /// Takes an answer of the hand's controller.
    pub fn told_by_hand(&mut self, told: HandTold, now_ms: u64) {
        let failure = match told {
            HandTold::Refused(number, why) => self.hand.refused(number).then_some(why),
            HandTold::Stalled(number) => {
                self.hand.stalled(number);
                None
            }
            HandTold::Ended(number, state, result) => {
                let was_there = self.hand.is_there();
                let was_to = self.hand.ended(number, &result, result.position / self.config.gripper_position_per_width, now_ms);
                // Some controllers abort a goal that something stalls, and some one to grasp that finds nothing: neither is a failure of theirs.
                let is_done = state == status::SUCCEEDED || result.stalled || result.reached_goal || was_there || self.hand.is_there();
                (was_to && !is_done).then(|| format!("the hand's goal ended {} at {:.4} m", status::name(state), result.position))
            }
            HandTold::Lost(number, why) => self.hand.lost(number, now_ms).then_some(why),
            HandTold::NotThere(number) => {
                self.hand.not_there(number, now_ms, self.config.controller_timeout_ms);
                None
            }
        };
        if let (Some(why), Some(arm)) = (failure, self.arm.as_mut().filter(|arm| arm.stop().is_none())) {
            arm.fault("gripper_failed", why);
        }
    }

    /// Goes on to `now_ms`, and what is to be done.
    pub fn step(&mut self, now_ms: u64) -> Vec<Do> {
        let since_s = now_ms.saturating_sub(std::mem::replace(&mut self.stepped_ms, now_ms)) as f64 * 1e-3;
        let Some(arm) = &mut self.arm else { return Vec::new() };
        arm.set_grips(self.hand.state().holding, now_ms as f64 * 1e-3);
        if arm.mode() == RobotMode::Moving && self.measured.age_ms(now_ms).is_none_or(|age_ms| age_ms > JOINTS_OLD_MS) {
            arm.fault("joint_states_silent", format!("no joint states for more than {JOINTS_OLD_MS} ms"));
        }
        // A stream begins when its controller accepts it, which then goes on whether or not this process gets to it.
        let goal = self.goal.filter(|_| arm.stop().is_none()).map(|goal| goal.state);
        self.owed_s = match goal {
            Some(GoalState::Sent) => 0.0,
            Some(GoalState::Accepted) => self.owed_s + since_s,
            None => self.owed_s + since_s.min(CATCH_UP_S),
        };
        while self.owed_s >= TICK_S {
            self.owed_s -= TICK_S;
            self.ticks += 1;
            arm.tick(now_ms as f64 * 1e-3);
        }
        let mut todo = Vec::new();
        if let Some(action) = arm.take_gripper() {
            if self.config.gripper_action.is_some() {
                self.goals += 1;
                self.hand.sent(self.goals, action.width_m);
                todo.push(Do::Grip(self.goals, action.width_m * self.config.gripper_position_per_width, action.force_n));
            } else {
                arm.fault("no_gripper", "the configuration names no gripper_action".to_owned());
            }
        }
        self.watch_goal(now_ms);
        let is_stopped = self.arm.as_ref().is_some_and(|arm| arm.stop().is_some());
        if is_stopped {
            self.goal = None;
            todo.extend(self.unended.to_cancel(now_ms).into_iter().map(Do::Cancel));
        }
        if is_stopped || self.hand.is_given_up() {
            todo.extend(self.hand.to_cancel(now_ms).map(Do::CancelGrip));
        }
        todo
    }

    /// Latches a stop where the controller is overdue.
    fn watch_goal(&mut self, now_ms: u64) {
        let (Some(goal), Some(arm)) = (self.goal, &mut self.arm) else { return };
        let waited_ms = now_ms.saturating_sub(goal.since_ms) as f64;
        let patience_ms = self.config.controller_timeout_ms as f64;
        let overdue = match goal.state {
            GoalState::Sent => waited_ms > patience_ms,
            GoalState::Accepted => waited_ms > goal.duration_ms + patience_ms + SLACK_MS,
        };
        if overdue && arm.stop().is_none() {
            arm.fault("controller_silent", format!("no word of its goal for {waited_ms:.0} ms"));
        }
    }

    /// What is to be said of goals that have not ended though they were canceled.
    pub fn overdue_cancels(&self, now_ms: u64) -> Option<String> {
        self.unended.overdue(now_ms, self.config.controller_timeout_ms)
    }

    /// What it shows of itself; nothing while its joints are not known.
    pub fn state(&mut self, now_ms: u64, stamp_ns: u64) -> Option<RobotState> {
        let arm = self.arm.as_ref()?;
        self.measured.age_ms(now_ms).filter(|age_ms| *age_ms <= JOINTS_OLD_MS)?;
        self.states += 1;
        let shown = StateDetails {
            seq: self.states,
            stamp_ns,
            robot_ms: self.ticks as f64 * TICK_S * 1e3,
            gripper: self.hand.state(),
            world_from_base: self.world_from_base,
        };
        let mut state = state_of(arm, &shown);
        // The arm's own stream may be over before the controller says that it is there.
        if state.mode == RobotMode::Idle && self.goal.is_some() {
            state.mode = RobotMode::Moving;
        }
        state.horizon_ms = Some(HORIZON_MS);
        Some(state)
    }
}

/// The rule that the arm would break on its stream, by following it in thought.
fn broken_rule(arm: &Arm, duration_ms: f64, now_ms: u64) -> Option<(String, String)> {
    let mut rehearsed = arm.clone();
    let ticks = (duration_ms + SLACK_MS) as usize;
    for _ in 0..ticks {
        rehearsed.tick(now_ms as f64 * 1e-3);
        if rehearsed.mode() != RobotMode::Moving {
            break;
        }
    }
    match rehearsed.stop() {
        Some(stop) => Some((stop.kind.clone(), stop.reason.clone())),
        None if rehearsed.mode() == RobotMode::Moving => {
            Some(("invalid_command".to_owned(), "the stream does not come to rest".to_owned()))
        }
        None => None,
    }
}
