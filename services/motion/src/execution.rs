//! The commander's side of one execution: a state machine from robot states and ticks to commands, progress and one outcome.
//!
//! Each phase moves the gripper and waits until it has settled, then streams its set-points in overlapping windows that reach a horizon
//! beyond what the robot says it has followed. Every phase ends at rest, and the object's loss is noticed there. What the robot does not show
//! as taken is sent again under its number, so that a robot that has taken it, and says so late, does not act on it twice. A cancelled execution slows down on its path and ends at rest; on a stop, a new owner or silence the stream just
//! ends, and the robot's own rules bring it to rest.

use repose_panda::START_TOLERANCE_RAD;
use repose_proto::motion::{ExecuteProgress, ExecuteReply, ExecutionOutcome, MotionPhase, MotionPlan, Phase};
use repose_proto::robot::{Owner, RobotCommand, RobotMode, RobotState, SetPoint};
use repose_proto::{CallError, limits};

use crate::halt::halted;

/// How an execution talks to the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExecutionSettings {
    /// How far ahead of the robot the set-points reach, milliseconds of robot time, at least 200. Default 1000.
    pub horizon_ms: f64,
    /// How long a command may be acted on after receipt, milliseconds. Default 500.
    pub ttl_ms: u64,
    /// How long to wait for the robot to take a command before it is sent again, milliseconds. Default 400.
    pub take_timeout_ms: u64,
    /// How often a command that was not taken is sent again. Default 5.
    pub resends: u32,
    /// How long the robot's state may be silent, milliseconds. Default 1500.
    pub state_timeout_ms: u64,
    /// How long the gripper may take to settle, milliseconds of robot time; then what it has reached decides. Default 3000.
    pub gripper_timeout_ms: f64,
    /// How far ahead of the robot a cancelled stream begins to slow down, milliseconds of robot time: longer than a state and a command take,
    /// shorter than the horizon. Default 150.
    pub halt_lead_ms: f64,
    /// How far behind its stream the robot may be at the end, milliseconds of robot time. Default 3000.
    pub lag_ms: f64,
}

impl Default for ExecutionSettings {
    fn default() -> Self {
        Self {
            horizon_ms: 1000.0,
            ttl_ms: 500,
            take_timeout_ms: 400,
            resends: 5,
            state_timeout_ms: 1500,
            gripper_timeout_ms: 3000.0,
            halt_lead_ms: 150.0,
            lag_ms: 3000.0,
        }
    }
}

/// What the driver of an execution is to do next.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// Put this command.
    Send(RobotCommand),
    /// Tell the caller.
    Progress(ExecuteProgress),
    /// It is over.
    Done(ExecuteReply),
}

/// How near to the plan's end the arm must be to have reached it, radians per joint. Where a phase follows, the robot's tolerance of its first
/// set-point decides.
const ARRIVED_RAD: f64 = 0.02;
/// How far apart the end of one phase and the start of the next may be, radians per joint.
const JOINED_RAD: f64 = 1e-3;
/// How long a gripper is given before its settling is believed, milliseconds of robot time.
const SETTLED_MS: f64 = 100.0;
/// How far from its commanded width a gripper that does not settle may stand to have reached it, metres.
const REACHED_M: f64 = 0.004;
/// Share of the width at the grasp by which the fingers close further when the object has gone.
const CLOSED_SHARE: f64 = 0.3;
/// How far in the future a scene may seem to have been seen: clocks differ, milliseconds.
const CLOCKS_DIFFER_MS: u64 = 2000;

/// One plan on its way.
#[derive(Debug)]
pub struct Execution {
    plan: MotionPlan,
    settings: ExecutionSettings,
    owner: Owner,
    seq: u64,
    phase: usize,
    stage: Stage,
    /// How wide the object held the fingers apart, metres.
    grasp_width_m: f64,
    last_state: RobotState,
    last_state_ms: u64,
    /// Set when it was cancelled.
    halt: Option<Halt>,
    over: bool,
}

/// A cancelled stream on its way to rest.
#[derive(Debug, Clone)]
struct Halt {
    reason: String,
    set_points: Vec<SetPoint>,
    first_seq: u64,
    since_ms: u64,
}

/// What is waited for.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Stage {
    /// The gripper, since the command `taken.first_seq`.
    Gripper { taken: Taken, settled_since_ms: Option<f64> },
    /// The arm, on the phase's stream.
    Stream { taken: Taken, since_ms: f64 },
}

/// Whether the robot has taken the first command of a stage.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Taken {
    first_seq: u64,
    sent_at_ms: u64,
    resends: u32,
}

impl Execution {
    /// Begins a plan on a robot in `state`, and what to do first. `commander` names the sender, `now_ns` is the wall clock (the scene's age),
    /// `now_ms` any steady clock that later calls go on with.
    ///
    /// # Errors
    /// `failed_precondition` when a stop is latched, the robot moves, the arm is not where the plan starts, the scene is too old, or no epoch is
    /// left; `invalid_argument` when the plan has no phases, or its phases do not join.
    pub fn begin(
        plan: MotionPlan,
        commander: &str,
        state: &RobotState,
        now_ns: u64,
        now_ms: u64,
        settings: ExecutionSettings,
    ) -> Result<(Self, Vec<Step>), CallError> {
        check_plan(&plan)?;
        check_robot(&plan, state)?;
        let ahead_ms = plan.scene_stamp_ns.saturating_sub(now_ns) / 1_000_000;
        if ahead_ms > CLOCKS_DIFFER_MS {
            let message = format!("the scene was seen {ahead_ms} ms in the future, at most {CLOCKS_DIFFER_MS} ms are put down to clocks");
            return Err(CallError::precondition(message).at("scene_stamp_ns"));
        }
        let age_ms = now_ns.saturating_sub(plan.scene_stamp_ns) / 1_000_000;
        if age_ms > plan.max_scene_age_ms {
            let message = format!("the scene is {age_ms} ms old, at most {} ms are allowed", plan.max_scene_age_ms);
            return Err(CallError::precondition(message).at("scene_stamp_ns"));
        }
        let owner = next_owner(commander, state)?;
        let taken = Taken { first_seq: 1, sent_at_ms: now_ms, resends: 0 };
        let mut execution = Self {
            plan,
            settings,
            owner,
            seq: 0,
            phase: 0,
            stage: Stage::Gripper { taken, settled_since_ms: None },
            grasp_width_m: 0.0,
            last_state: state.clone(),
            last_state_ms: now_ms,
            halt: None,
            over: false,
        };
        let steps = execution.enter_phase(now_ms);
        Ok((execution, steps))
    }

    /// Takes a state of the robot.
    pub fn on_state(&mut self, state: &RobotState, now_ms: u64) -> Vec<Step> {
        if self.over {
            return Vec::new();
        }
        self.last_state = state.clone();
        self.last_state_ms = now_ms;
        if let (RobotMode::Stopped, stop) = (state.mode, &state.stop) {
            let reason = stop.as_ref().map_or_else(|| "the robot stopped".to_owned(), |s| format!("{}: {}", s.kind, s.reason));
            return self.done(ExecutionOutcome::Stopped, Some(reason));
        }
        if let Some(owner) = &state.owner
            && *owner != self.owner
            && owner.epoch >= self.owner.epoch
        {
            return self.done(ExecutionOutcome::Stopped, Some(format!("{} has taken the robot over", owner.id)));
        }
        if let Some(halt) = &self.halt {
            let taken = Taken { first_seq: halt.first_seq, sent_at_ms: halt.since_ms, resends: 0 };
            let stands = state.mode == RobotMode::Idle && self.is_taken(taken);
            return if stands { self.end_halt() } else { Vec::new() };
        }
        match self.stage {
            Stage::Gripper { taken, settled_since_ms } if self.is_taken(taken) => self.watch_gripper(taken, settled_since_ms, now_ms),
            Stage::Stream { since_ms, .. } if self.has_arrived() || state.robot_ms - since_ms > self.longest_ms() => {
                self.end_stream(now_ms)
            }
            _ => Vec::new(),
        }
    }

    /// To be called every 20 to 100 ms: extends the stream, sends again what was not taken, and notices silence.
    pub fn on_tick(&mut self, now_ms: u64) -> Vec<Step> {
        if self.over {
            return Vec::new();
        }
        let silent_ms = now_ms.saturating_sub(self.last_state_ms);
        if silent_ms > self.settings.state_timeout_ms {
            return self.done(ExecutionOutcome::Stopped, Some(format!("the robot's state has been silent for {silent_ms} ms")));
        }
        if self.halt.is_some() {
            return self.go_on_halting(now_ms);
        }
        let (Stage::Gripper { taken, .. } | Stage::Stream { taken, .. }) = self.stage;
        if !self.is_taken(taken) {
            return self.send_again(taken, now_ms);
        }
        match self.stage {
            Stage::Stream { .. } => vec![Step::Send(self.window(false))],
            Stage::Gripper { .. } => Vec::new(),
        }
    }

    /// Cancels: a moving arm slows down on its path and the execution ends when it stands, without a latched stop; one that stands ends at once.
    pub fn cancel(&mut self, reason: &str, now_ms: u64) -> Vec<Step> {
        if self.over || self.halt.is_some() {
            return Vec::new();
        }
        let Stage::Stream { taken, .. } = self.stage else { return self.done(ExecutionOutcome::Stopped, Some(reason.to_owned())) };
        let followed_ms = self.last_state.stream_ms.filter(|_| self.is_taken(taken)).unwrap_or(0.0);
        let set_points = halted(&self.current().set_points, followed_ms + self.settings.halt_lead_ms);
        self.halt = Some(Halt { reason: reason.to_owned(), set_points, first_seq: self.seq + 1, since_ms: now_ms });
        self.go_on_halting(now_ms)
    }

    /// Ends the execution where nothing can be sent any more: the robot comes to rest by its own rules, and latches.
    pub fn abandon(&mut self, reason: &str) -> Vec<Step> {
        if self.over { Vec::new() } else { self.done(ExecutionOutcome::Stopped, Some(reason.to_owned())) }
    }

    /// Sends the way to rest again while it may have been lost and can still be followed; gives up when the robot should long stand.
    fn go_on_halting(&mut self, now_ms: u64) -> Vec<Step> {
        let Some(halt) = &self.halt else { return Vec::new() };
        let waited_ms = now_ms.saturating_sub(halt.since_ms) as f64;
        let longest_ms = halt.set_points.last().map_or(0.0, |p| p.t_ms) + self.settings.lag_ms;
        if waited_ms > longest_ms {
            return self.end_halt();
        }
        let taken = Taken { first_seq: halt.first_seq, sent_at_ms: halt.since_ms, resends: 0 };
        if self.is_taken(taken) || waited_ms >= self.settings.halt_lead_ms {
            return Vec::new();
        }
        let set_points = halt.set_points.clone();
        vec![Step::Send(RobotCommand { set_points, ends_stream: true, ..self.command() })]
    }

    fn end_halt(&mut self) -> Vec<Step> {
        let reason = self.halt.as_ref().map(|halt| halt.reason.clone());
        self.done(ExecutionOutcome::Stopped, reason)
    }

    fn current(&self) -> &MotionPhase {
        &self.plan.phases[self.phase]
    }

    /// Whether the robot has taken this owner's command `first_seq` or a later one.
    fn is_taken(&self, taken: Taken) -> bool {
        self.last_state.owner.as_ref() == Some(&self.owner) && self.last_state.last_command.is_some_and(|seq| seq >= taken.first_seq)
    }

    fn enter_phase(&mut self, now_ms: u64) -> Vec<Step> {
        let progress = ExecuteProgress { phase: self.current().name, done: self.phase, of: self.plan.phases.len() };
        let mut steps = vec![Step::Progress(progress)];
        steps.extend(if self.current().gripper.is_some() { self.start_gripper(now_ms, 0) } else { self.enter_stream(now_ms) });
        steps
    }

    fn start_gripper(&mut self, now_ms: u64, resends: u32) -> Vec<Step> {
        let command = RobotCommand { gripper: self.current().gripper, ..self.command() };
        let taken = Taken { first_seq: command.seq, sent_at_ms: now_ms, resends };
        self.stage = Stage::Gripper { taken, settled_since_ms: None };
        vec![Step::Send(command)]
    }

    /// Begins the phase's stream, unless the robot would refuse it, and latch a stop, because it stands elsewhere.
    fn enter_stream(&mut self, now_ms: u64) -> Vec<Step> {
        let Some(first) = self.current().set_points.first() else { return self.end_phase(now_ms) };
        if let Some(joint) = apart(&first.q_rad, &self.last_state.q_rad, START_TOLERANCE_RAD) {
            let (stands, starts) = (self.last_state.q_rad[joint], first.q_rad[joint]);
            let reason = format!("joint {joint} stands at {stands:.4} rad but the phase starts at {starts:.4} rad");
            return self.done(ExecutionOutcome::Stopped, Some(reason));
        }
        self.start_stream(now_ms, 0)
    }

    fn start_stream(&mut self, now_ms: u64, resends: u32) -> Vec<Step> {
        let command = self.window(true);
        let taken = Taken { first_seq: command.seq, sent_at_ms: now_ms, resends };
        self.stage = Stage::Stream { taken, since_ms: self.last_state.robot_ms };
        vec![Step::Send(command)]
    }

    /// Sends the first command of a stage again, the same under its number: it is lost, or the state that shows it as taken is late.
    fn send_again(&mut self, taken: Taken, now_ms: u64) -> Vec<Step> {
        if now_ms.saturating_sub(taken.sent_at_ms) < self.settings.take_timeout_ms {
            return Vec::new();
        }
        if taken.resends >= self.settings.resends {
            return self.done(ExecutionOutcome::Stopped, Some("the robot does not take commands".to_owned()));
        }
        // Nothing else was sent since.
        self.seq = taken.first_seq - 1;
        match self.stage {
            Stage::Gripper { .. } => self.start_gripper(now_ms, taken.resends + 1),
            Stage::Stream { .. } => self.start_stream(now_ms, taken.resends + 1),
        }
    }

    fn watch_gripper(&mut self, taken: Taken, settled_since_ms: Option<f64>, now_ms: u64) -> Vec<Step> {
        let robot_ms = self.last_state.robot_ms;
        let since_ms = settled_since_ms.unwrap_or(robot_ms);
        self.stage = Stage::Gripper { taken, settled_since_ms: Some(since_ms) };
        let waited_ms = robot_ms - since_ms;
        let is_settled = self.last_state.gripper_settled && waited_ms >= SETTLED_MS;
        if !is_settled && waited_ms <= self.settings.gripper_timeout_ms {
            return Vec::new();
        }
        let (width_m, wanted_m) = (self.last_state.gripper_width_m, self.current().gripper.map_or(0.0, |g| g.width_m));
        if self.current().name == Phase::Grasp {
            // Fingers that press may tremble for long: standing well apart is holding too.
            if !self.last_state.gripper_holding && width_m <= wanted_m + REACHED_M {
                return self.done(ExecutionOutcome::GraspLost, Some("the gripper closed on nothing".to_owned()));
            }
            self.grasp_width_m = width_m;
        } else if !is_settled && (width_m - wanted_m).abs() > REACHED_M {
            let reason = format!("the gripper stands at {width_m:.3} m and was sent to {wanted_m:.3} m");
            return self.done(ExecutionOutcome::Stopped, Some(reason));
        }
        self.enter_stream(now_ms)
    }

    fn has_arrived(&self) -> bool {
        let (Stage::Stream { taken, .. }, Some(end)) = (self.stage, self.current().set_points.last()) else { return false };
        let state = &self.last_state;
        let tolerance_rad = if self.phase + 1 == self.plan.phases.len() { ARRIVED_RAD } else { START_TOLERANCE_RAD };
        let near = apart(&end.q_rad, &state.q_rad, tolerance_rad).is_none();
        self.is_taken(taken) && state.mode == RobotMode::Idle && near && state.stream_ms.is_none_or(|ms| ms >= end.t_ms - 1.0)
    }

    /// How much robot time the current stream may take.
    fn longest_ms(&self) -> f64 {
        self.current().set_points.last().map_or(0.0, |p| p.t_ms) + self.settings.lag_ms
    }

    fn end_stream(&mut self, now_ms: u64) -> Vec<Step> {
        if !self.has_arrived() {
            return self.done(ExecutionOutcome::Stopped, Some("the robot did not follow its set-points".to_owned()));
        }
        self.end_phase(now_ms)
    }

    fn end_phase(&mut self, now_ms: u64) -> Vec<Step> {
        let carrying = self.current().name.is_carrying();
        let closed_m = self.grasp_width_m - self.last_state.gripper_width_m;
        if carrying && !self.last_state.gripper_holding && closed_m > CLOSED_SHARE * self.grasp_width_m {
            return self.done(ExecutionOutcome::GraspLost, Some("the object was lost on the way".to_owned()));
        }
        if self.phase + 1 == self.plan.phases.len() {
            return self.done(ExecutionOutcome::Done, None);
        }
        self.phase += 1;
        self.enter_phase(now_ms)
    }

    /// The next command, empty.
    fn command(&mut self) -> RobotCommand {
        self.seq += 1;
        RobotCommand {
            v: limits::VERSION,
            seq: self.seq,
            owner: self.owner.clone(),
            ttl_ms: self.settings.ttl_ms,
            starts_stream: false,
            ends_stream: false,
            set_points: Vec::new(),
            gripper: None,
            clear_stop: false,
            clears: None,
        }
    }

    /// The set-points from where the robot is on its stream (or the beginning) to the horizon beyond it.
    fn window(&mut self, starts_stream: bool) -> RobotCommand {
        let followed_ms = if starts_stream { 0.0 } else { self.last_state.stream_ms.unwrap_or(0.0) };
        let points = &self.current().set_points;
        let first = points.partition_point(|p| p.t_ms <= followed_ms).saturating_sub(1);
        let reach_ms = followed_ms + self.settings.horizon_ms.max(limits::MIN_COMMAND_HORIZON_MS as f64);
        // One set-point beyond the horizon, so that it is covered whole.
        let end = (points.partition_point(|p| p.t_ms < reach_ms) + 1).min(points.len());
        let (set_points, ends_stream): (Vec<SetPoint>, bool) = (points[first..end].to_vec(), end == points.len());
        RobotCommand { set_points, starts_stream, ends_stream, ..self.command() }
    }

    fn done(&mut self, outcome: ExecutionOutcome, reason: Option<String>) -> Vec<Step> {
        self.over = true;
        vec![Step::Done(ExecuteReply { outcome, phase: self.current().name, reason, joints_rad: self.last_state.q_rad })]
    }
}

fn check_plan(plan: &MotionPlan) -> Result<(), CallError> {
    if plan.phases.is_empty() {
        return Err(CallError::invalid("phases", "the plan has no phases"));
    }
    let mut last = plan.start_joints_rad;
    for (i, phase) in plan.phases.iter().enumerate() {
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

fn check_robot(plan: &MotionPlan, state: &RobotState) -> Result<(), CallError> {
    match state.mode {
        RobotMode::Stopped => {
            let why = state.stop.as_ref().map_or("it does not say why", |stop| stop.reason.as_str());
            return Err(CallError::precondition(format!("a stop is latched ({why}): reset the robot first")).at("robot"));
        }
        RobotMode::Moving => return Err(CallError::precondition("the robot is moving").at("robot")),
        RobotMode::Idle => {}
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
fn apart(a: &[f64; 7], b: &[f64; 7], tolerance_rad: f64) -> Option<usize> {
    (0..7).find(|&i| (a[i] - b[i]).abs().is_nan() || (a[i] - b[i]).abs() > tolerance_rad)
}
