//! The commander's side of one execution: a state machine from robot states and ticks to commands, progress and one outcome.
//!
//! Each phase moves the gripper and waits until it has settled, then streams its set-points in overlapping windows that reach a horizon
//! beyond what the robot says it has followed. Every phase ends at rest, and the object's loss is noticed there. A command that the robot does
//! not show as taken is repeated under its number: a robot that has taken it, and says so late, does not act on it twice.
//!
//! An execution is a task of the robot: its first command opens the task, every tick keeps it alive, and its last command closes it. Where the
//! commands end without that, the robot's side latches a stop. So it does when the task is closed with an object in the hand: a cancelled
//! execution slows down on its path, comes to rest, waits for fingers that move, and closes its task.

mod checks;
mod fingers;
mod halt;
pub mod keep_out;
mod settings;

use repose_panda::START_TOLERANCE_RAD;
use repose_proto::motion::{ExecuteProgress, ExecuteReply, ExecutionOutcome, MotionPhase, MotionPlan, Phase};
use repose_proto::robot::{HeldObject, Owner, RobotCommand, RobotMode, RobotState, SetPoint, Task};
use repose_proto::{CallError, limits};

pub use checks::{check_age, check_base, check_free, check_unmoved, next_owner};
pub use settings::ExecutionSettings;

use checks::{apart, check_model, check_phases, check_start};
use fingers::Fingers;
use halt::Halt;

/// Who executes, and as which task.
#[derive(Debug, Clone, PartialEq)]
pub struct ExecutionTask {
    /// The commander's name: a chunk of a key.
    pub commander: String,
    /// The task's id: that of the request.
    pub id: String,
    /// What is in the hand from the grasp on.
    pub grasps: Option<HeldObject>,
}

/// The next action of an execution's driver.
#[derive(Debug, Clone, PartialEq)]
pub enum ExecutionAction {
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
/// Ticks that are further apart than this, milliseconds, are so because this process waited for a core or was stopped.
const LONGEST_TICK_MS: u64 = 400;
/// Share of the width at the grasp by which the fingers close further when the object has gone.
const CLOSED_SHARE: f64 = 0.3;

/// One plan on its way.
#[derive(Debug)]
pub struct Execution {
    phases: Vec<MotionPhase>,
    settings: ExecutionSettings,
    owner: Owner,
    task: ExecutionTask,
    /// Whether the robot's side knows tasks.
    knows_tasks: bool,
    seq: u64,
    /// The last of its commands that the robot has shown as taken; 0 before the first.
    shown_seq: u64,
    phase: usize,
    stage: Stage,
    /// How wide the object held the fingers apart, metres.
    grasp_width_m: f64,
    /// Where the fingers were when the phase began, and where they stand since when.
    fingers: Fingers,
    last_state: RobotState,
    last_state_ms: u64,
    /// Since when the robot is silent: its last state came then, or later where this process stood still itself.
    silent_since_ms: u64,
    last_tick_ms: u64,
    /// Set when it was cancelled on its way.
    halt: Option<Halt>,
    /// Set when it was cancelled while the fingers moved: why.
    cancelled: Option<String>,
    over: bool,
}

/// What is waited for.
#[derive(Debug, Clone, PartialEq)]
enum Stage {
    /// The gripper, since the command `taken.first_seq`.
    Gripper { taken: Taken, settled_since_ms: Option<f64> },
    /// The arm, on the phase's stream.
    Stream { taken: Taken, since_ms: f64 },
    /// Fingers that have closed further on the way: on what has slipped between them, or on nothing.
    Slip { taken: Taken, since_ms: f64 },
    /// The end of the task; then the reply holds.
    Closing { taken: Taken, reply: ExecuteReply },
}

/// Whether the robot has taken the first command of a stage.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Taken {
    first_seq: u64,
    sent_at_ms: u64,
}

impl Execution {
    /// Begins a plan on a robot in `state`, and what to do first. `now_ms` is any steady clock that later calls go on with; the scene's age is by
    /// the robot's clock, that of the state.
    ///
    /// # Errors
    /// `failed_precondition` when a stop is latched; when the robot moves, has a task or something in its hand, is another model, or has its base
    /// elsewhere than motions are planned for or its joints elsewhere than the plan starts; when the scene is too old, or was seen before the hand last
    /// took or put something; or when no epoch is left. `invalid_argument` when the plan has no phases, or its phases do not join.
    pub fn begin(
        plan: MotionPlan,
        task: ExecutionTask,
        state: &RobotState,
        now_ms: u64,
        settings: ExecutionSettings,
    ) -> Result<(Self, Vec<ExecutionAction>), CallError> {
        check_phases(&plan.start_joints_rad, &plan.phases)?;
        check_free(state)?;
        check_model(state, settings.model)?;
        check_base(state, &settings.world_from_base)?;
        check_start(&plan, state)?;
        check_age(plan.scene_stamp_ns, plan.max_scene_age_ms, state.stamp_ns)?;
        check_unmoved(plan.scene_stamp_ns, "the robot", state)?;
        Self::start(plan.phases, task, state, now_ms, settings)
    }

    /// Begins phases from where the robot stands, whatever it has in its hand.
    ///
    /// # Errors
    /// `failed_precondition` when a stop is latched, the robot moves, has a task, is another model or has its base elsewhere, or no epoch is left;
    /// `invalid_argument` when there are no phases, or they do not join.
    pub fn from_here(
        phases: Vec<MotionPhase>,
        task: ExecutionTask,
        state: &RobotState,
        now_ms: u64,
        settings: ExecutionSettings,
    ) -> Result<(Self, Vec<ExecutionAction>), CallError> {
        check_phases(&state.q_rad, &phases)?;
        check_free(state)?;
        check_model(state, settings.model)?;
        check_base(state, &settings.world_from_base)?;
        Self::start(phases, task, state, now_ms, settings)
    }

    fn start(
        phases: Vec<MotionPhase>,
        task: ExecutionTask,
        state: &RobotState,
        now_ms: u64,
        settings: ExecutionSettings,
    ) -> Result<(Self, Vec<ExecutionAction>), CallError> {
        let owner = next_owner(&task.commander, state)?;
        let taken = Taken { first_seq: 1, sent_at_ms: now_ms };
        let mut execution = Self {
            phases,
            settings,
            owner,
            task,
            knows_tasks: state.task.is_some(),
            seq: 0,
            shown_seq: 0,
            phase: 0,
            stage: Stage::Gripper { taken, settled_since_ms: None },
            grasp_width_m: 0.0,
            fingers: Fingers::of(state),
            last_state: state.clone(),
            last_state_ms: now_ms,
            silent_since_ms: now_ms,
            last_tick_ms: now_ms,
            halt: None,
            cancelled: None,
            over: false,
        };
        let steps = execution.enter_phase(now_ms);
        Ok((execution, steps))
    }

    /// Takes a state of the robot.
    pub fn on_state(&mut self, state: &RobotState, now_ms: u64) -> Vec<ExecutionAction> {
        if self.over {
            return Vec::new();
        }
        self.last_state = state.clone();
        self.last_state_ms = now_ms;
        self.silent_since_ms = now_ms;
        self.fingers.see(state);
        if let (RobotMode::Stopped, stop) = (state.mode, &state.stop) {
            let reason = stop.as_ref().map_or_else(|| "the robot stopped".to_owned(), |s| format!("{}: {}", s.kind, s.reason));
            return self.stopped(reason);
        }
        if let Some(owner) = &state.owner
            && *owner != self.owner
            && owner.epoch >= self.owner.epoch
        {
            return self.stopped(format!("{} has taken the robot over", owner.id));
        }
        let shown_seq = state.last_command.filter(|_| state.owner.as_ref() == Some(&self.owner)).unwrap_or(0);
        if shown_seq < self.shown_seq {
            // It would take a repeated command for a new one, wherever the arm stands by now.
            return self.stopped("the robot's side has started anew, and knows nothing of this task".to_owned());
        }
        self.shown_seq = shown_seq;
        if let (Some(halt), Stage::Stream { .. }) = (&self.halt, &self.stage) {
            let stands = state.mode == RobotMode::Idle && self.is_taken(halt.first_seq());
            return if stands { self.end_halt(now_ms) } else { Vec::new() };
        }
        match &self.stage {
            &Stage::Gripper { taken, settled_since_ms } if self.is_taken(taken.first_seq) => {
                self.watch_gripper(taken, settled_since_ms, now_ms)
            }
            &Stage::Slip { since_ms, .. } => self.watch_slip(since_ms, now_ms),
            Stage::Closing { taken, reply } if self.is_taken(taken.first_seq) => {
                let reply = reply.clone();
                self.done(reply)
            }
            &Stage::Stream { since_ms, .. } if self.has_arrived() || state.robot_ms - since_ms > self.longest_ms() => {
                self.end_stream(now_ms)
            }
            _ => Vec::new(),
        }
    }

    /// To be called every 20 to 100 ms: extends the stream, repeats what was not taken, keeps the task alive, and notices silence.
    pub fn on_tick(&mut self, now_ms: u64) -> Vec<ExecutionAction> {
        if self.over {
            return Vec::new();
        }
        // States that came while this process stood still may be read only after this tick.
        let stood_still_ms = now_ms.saturating_sub(self.last_tick_ms + LONGEST_TICK_MS);
        self.last_tick_ms = now_ms;
        self.silent_since_ms = now_ms.min(self.silent_since_ms + stood_still_ms);
        let silent_ms = now_ms - self.silent_since_ms;
        if silent_ms > self.settings.state_timeout_ms {
            return self.stopped(format!("the robot's state has been silent for {silent_ms} ms"));
        }
        if let (true, Stage::Stream { .. }) = (self.halt.is_some(), &self.stage) {
            return self.go_on_halting(now_ms);
        }
        let (Stage::Gripper { taken, .. } | Stage::Stream { taken, .. } | Stage::Slip { taken, .. } | Stage::Closing { taken, .. }) =
            self.stage;
        if !self.is_taken(taken.first_seq) {
            return self.send_again(taken, now_ms);
        }
        match self.stage {
            // Once a robot that asks for it has its whole stream, nothing of it is to be said again.
            Stage::Stream { .. } if self.has_whole_stream() => self.kept_alive(),
            Stage::Stream { .. } => vec![ExecutionAction::Send(self.window(false))],
            Stage::Gripper { .. } | Stage::Slip { .. } | Stage::Closing { .. } => self.kept_alive(),
        }
    }

    /// Cancels: a moving arm slows down on its path, moving fingers settle, and the execution ends when the robot stands. With an object in its
    /// hand it then latches a stop.
    pub fn cancel(&mut self, reason: &str, now_ms: u64) -> Vec<ExecutionAction> {
        if self.over || self.halt.is_some() {
            return Vec::new();
        }
        match self.stage {
            Stage::Closing { .. } => Vec::new(),
            Stage::Gripper { .. } | Stage::Slip { .. } => {
                self.cancelled.get_or_insert_with(|| reason.to_owned());
                Vec::new()
            }
            Stage::Stream { taken, .. } => self.begin_halt(reason, taken, now_ms),
        }
    }

    /// Ends the execution where nothing can be sent any more: the robot comes to rest by its own rules, and latches.
    pub fn abandon(&mut self, reason: &str) -> Vec<ExecutionAction> {
        if self.over { Vec::new() } else { self.stopped(reason.to_owned()) }
    }

    /// A command that asks for nothing, where the robot's side waits for one.
    fn kept_alive(&mut self) -> Vec<ExecutionAction> {
        if self.knows_tasks { vec![ExecutionAction::Send(self.command())] } else { Vec::new() }
    }

    fn current(&self) -> &MotionPhase {
        &self.phases[self.phase]
    }

    /// Whether the robot has taken this owner's command `first_seq` or a later one.
    fn is_taken(&self, first_seq: u64) -> bool {
        self.last_state.owner.as_ref() == Some(&self.owner) && self.last_state.last_command.is_some_and(|seq| seq >= first_seq)
    }

    fn enter_phase(&mut self, now_ms: u64) -> Vec<ExecutionAction> {
        let progress = ExecuteProgress { phase: self.current().name, done: self.phase, of: self.phases.len() };
        let mut steps = vec![ExecutionAction::Progress(progress)];
        self.fingers = Fingers::of(&self.last_state);
        steps.extend(if self.current().gripper.is_some() { self.start_gripper(now_ms) } else { self.enter_stream(now_ms) });
        steps
    }

    fn start_gripper(&mut self, sent_at_ms: u64) -> Vec<ExecutionAction> {
        let mut command = RobotCommand { gripper: self.current().gripper, ..self.command() };
        if let (Phase::Grasp, Some(task)) = (self.current().name, &mut command.task) {
            task.grasps.clone_from(&self.task.grasps);
        }
        let taken = Taken { first_seq: command.seq, sent_at_ms };
        self.stage = Stage::Gripper { taken, settled_since_ms: None };
        vec![ExecutionAction::Send(command)]
    }

    /// Begins the phase's stream, unless the robot would refuse it, and latch a stop, because it stands elsewhere.
    fn enter_stream(&mut self, now_ms: u64) -> Vec<ExecutionAction> {
        let Some(first) = self.current().set_points.first() else { return self.end_phase(now_ms) };
        if let Some(joint) = apart(&first.q_rad, &self.last_state.q_rad, START_TOLERANCE_RAD) {
            let (stands, starts) = (self.last_state.q_rad[joint], first.q_rad[joint]);
            let reason = format!("joint {joint} stands at {stands:.4} rad but the phase starts at {starts:.4} rad");
            return self.end(ExecutionOutcome::Stopped, Some(reason), now_ms);
        }
        self.start_stream(now_ms)
    }

    fn start_stream(&mut self, sent_at_ms: u64) -> Vec<ExecutionAction> {
        let command = self.window(true);
        let taken = Taken { first_seq: command.seq, sent_at_ms };
        self.stage = Stage::Stream { taken, since_ms: self.last_state.robot_ms };
        vec![ExecutionAction::Send(command)]
    }

    /// Sends the first command of a stage again, the same under its number: it is lost, or the state that shows it as taken is late.
    fn send_again(&mut self, taken: Taken, now_ms: u64) -> Vec<ExecutionAction> {
        if now_ms.saturating_sub(taken.sent_at_ms) > self.settings.take_timeout_ms {
            return self.stopped("the robot does not take commands".to_owned());
        }
        // Nothing else was sent since.
        self.seq = taken.first_seq - 1;
        match self.stage {
            // Fingers that may not have been told before a cancel are not told after it: the number alone is used up.
            Stage::Gripper { .. } if self.cancelled.is_some() => vec![ExecutionAction::Send(self.command())],
            Stage::Gripper { .. } => self.start_gripper(taken.sent_at_ms),
            Stage::Stream { .. } => self.start_stream(taken.sent_at_ms),
            // Its stream was taken long ago.
            Stage::Slip { .. } => self.kept_alive(),
            Stage::Closing { .. } => vec![ExecutionAction::Send(self.closing())],
        }
    }

    fn has_arrived(&self) -> bool {
        let (&Stage::Stream { taken, .. }, Some(end)) = (&self.stage, self.current().set_points.last()) else { return false };
        let state = &self.last_state;
        let tolerance_rad = if self.phase + 1 == self.phases.len() { ARRIVED_RAD } else { START_TOLERANCE_RAD };
        let near = apart(&end.q_rad, &state.q_rad, tolerance_rad).is_none();
        self.is_taken(taken.first_seq) && state.mode == RobotMode::Idle && near && state.stream_ms.is_none_or(|ms| ms >= end.t_ms - 1.0)
    }

    /// How much robot time the current stream may take.
    fn longest_ms(&self) -> f64 {
        self.current().set_points.last().map_or(0.0, |p| p.t_ms) + self.settings.lag_ms
    }

    fn end_stream(&mut self, now_ms: u64) -> Vec<ExecutionAction> {
        if !self.has_arrived() {
            // An arm that is held up on the last straight way to the object has a finger on it, or on what stands beside it.
            if self.current().name == Phase::Approach {
                return self.end(
                    ExecutionOutcome::GraspLost,
                    Some("the hand met something before it was at the object".to_owned()),
                    now_ms,
                );
            }
            return self.end_on_the_way(self.behind(), now_ms);
        }
        self.end_phase(now_ms)
    }

    /// What is to be said of a robot that is not at its stream's end in time.
    fn behind(&self) -> String {
        let (state, end) = (&self.last_state, self.current().set_points.last());
        let (end_ms, end_rad) = end.map_or((0.0, state.q_rad), |end| (end.t_ms, end.q_rad));
        let off_rad = state.q_rad.iter().zip(end_rad).map(|(q, end)| (q - end).abs()).fold(0.0, f64::max);
        let followed_ms = state.stream_ms.unwrap_or(end_ms);
        let late_ms = self.settings.lag_ms;
        format!(
            "the robot did not follow its set-points: {late_ms:.0} ms after their end it is at {followed_ms:.0} of {end_ms:.0} ms, {off_rad:.4} rad \
             from their last, and {:?}",
            state.mode
        )
    }

    fn end_phase(&mut self, now_ms: u64) -> Vec<ExecutionAction> {
        let carrying = self.current().name.is_carrying();
        let closed_m = self.grasp_width_m - self.last_state.gripper_width_m;
        if carrying
            && !self.last_state.gripper_holding
            && closed_m > CLOSED_SHARE * self.grasp_width_m
            && let Stage::Stream { taken, .. } = self.stage
        {
            self.stage = Stage::Slip { taken, since_ms: self.last_state.robot_ms };
            return Vec::new();
        }
        self.next_phase(now_ms)
    }

    fn next_phase(&mut self, now_ms: u64) -> Vec<ExecutionAction> {
        // One that asks for nothing is passed over: here, for a plan from elsewhere may have more of them than could begin and end each in the other.
        while self.phase + 1 < self.phases.len() {
            self.phase += 1;
            if self.current().gripper.is_some() || !self.current().set_points.is_empty() {
                return self.enter_phase(now_ms);
            }
        }
        self.end(ExecutionOutcome::Done, None, now_ms)
    }

    /// The next command, empty.
    fn command(&mut self) -> RobotCommand {
        self.seq += 1;
        let task = self.knows_tasks.then(|| Task { id: self.task.id.clone(), open: true, grasps: None });
        RobotCommand { task, ..RobotCommand::new(self.owner.clone(), self.seq, self.settings.ttl_ms) }
    }

    /// The next command: the task's last.
    fn closing(&mut self) -> RobotCommand {
        let mut command = self.command();
        command.task.iter_mut().for_each(|task| task.open = false);
        command
    }

    /// Whether the first command, which the robot has taken, had all set-points of the stream.
    fn has_whole_stream(&self) -> bool {
        let end_ms = self.current().set_points.last().map_or(0.0, |p| p.t_ms);
        self.last_state.horizon_ms.is_some_and(|wanted_ms| wanted_ms as f64 >= end_ms)
    }

    /// The set-points from where the robot is on its stream (or the beginning) to the horizon beyond it.
    fn window(&mut self, starts_stream: bool) -> RobotCommand {
        let followed_ms = if starts_stream { 0.0 } else { self.last_state.stream_ms.unwrap_or(0.0) };
        let points = &self.current().set_points;
        let first = points.partition_point(|p| p.t_ms <= followed_ms).saturating_sub(1);
        let wanted_ms = self.last_state.horizon_ms.unwrap_or(0).max(limits::MIN_COMMAND_HORIZON_MS);
        let reach_ms = followed_ms + self.settings.horizon_ms.max(wanted_ms as f64);
        // One set-point beyond the horizon, so that it is covered whole.
        let end = (points.partition_point(|p| p.t_ms < reach_ms) + 1).min(points.len());
        let (set_points, ends_stream): (Vec<SetPoint>, bool) = (points[first..end].to_vec(), end == points.len());
        RobotCommand { set_points, starts_stream, ends_stream, ..self.command() }
    }

    /// Ends at a robot that stands and listens: closes the task, and is over when the robot shows that.
    fn end(&mut self, outcome: ExecutionOutcome, reason: Option<String>, now_ms: u64) -> Vec<ExecutionAction> {
        let reply = self.reply(outcome, reason);
        if !self.knows_tasks {
            return self.done(reply);
        }
        let command = self.closing();
        self.stage = Stage::Closing { taken: Taken { first_seq: command.seq, sent_at_ms: now_ms }, reply };
        vec![ExecutionAction::Send(command)]
    }

    /// Ends where nothing is to be sent any more: a stop is latched, another commands, or the robot's side will latch one.
    fn stopped(&mut self, reason: String) -> Vec<ExecutionAction> {
        let reply = match &self.stage {
            // What ended it before is what counts, and what became of it is said too.
            Stage::Closing { reply, .. } if reply.outcome != ExecutionOutcome::Done => {
                let before = reply.reason.as_deref().unwrap_or("ended early");
                self.reply(reply.outcome, Some(format!("{before}; {reason}")))
            }
            _ => self.reply(ExecutionOutcome::Stopped, Some(reason)),
        };
        self.done(reply)
    }

    fn reply(&self, outcome: ExecutionOutcome, reason: Option<String>) -> ExecuteReply {
        ExecuteReply { outcome, phase: self.current().name, reason, joints_rad: self.last_state.q_rad }
    }

    fn done(&mut self, reply: ExecuteReply) -> Vec<ExecutionAction> {
        self.over = true;
        vec![ExecutionAction::Done(ExecuteReply { joints_rad: self.last_state.q_rad, ..reply })]
    }
}
