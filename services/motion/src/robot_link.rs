//! The link to robots: follows a robot's state, drives an [`Execution`], and clears latched stops.
//!
//! Only this file puts robot commands. It decides nothing about motion: it carries states in, commands out, and the clock.

use std::collections::BTreeSet;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use repose_proto::motion::{ExecuteProgress, ExecuteReply, MotionPhase, MotionPlan, RobotResetReply, RobotResetRequest};
use repose_proto::robot::{RobotCommand, RobotMode, RobotState, StopState};
use repose_proto::{CallError, ErrorCode, Payload, keys};
use repose_runtime::{Publisher, RuntimeError, Session, Subscription, Traffic, now_ns, read_robot_state};
use tokio::time::MissedTickBehavior;

use crate::config::MotionConfig;
use crate::execution::{Execution, ExecutionAction, ExecutionSettings, ExecutionTask, next_owner};

/// Comes to its end when an arm that is driven is to come to rest, with the reason. Where nothing has been commanded by then, nothing is, and the
/// reason is the error.
pub type ToRest = Pin<Box<dyn Future<Output = CallError> + Send>>;

/// Commands robots of one cell. Cheap to clone.
#[derive(Clone)]
pub struct RobotLink {
    session: Session,
    commander: String,
    settings: ExecutionSettings,
    period: Duration,
    timeout: Duration,
    busy: Arc<Mutex<BTreeSet<String>>>,
}

/// A robot that this process commands; free again when dropped.
struct Claim {
    robot: String,
    busy: Arc<Mutex<BTreeSet<String>>>,
}

impl Drop for Claim {
    fn drop(&mut self) {
        self.busy.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.robot);
    }
}

impl RobotLink {
    /// A link that commands under the configured name.
    ///
    /// # Errors
    /// When the configuration is out of range.
    pub fn new(session: Session, config: &MotionConfig) -> Result<Self, RuntimeError> {
        let commander = config.commander.clone().unwrap_or_else(|| format!("motion-{}-{:x}", std::process::id(), now_ns()));
        keys::validate_chunk("commander", &commander).map_err(|e| RuntimeError::Config {
            section: "motion".to_owned(),
            file: None,
            message: e.to_string(),
        })?;
        Ok(Self {
            session,
            commander,
            settings: config.execution()?,
            period: Duration::from_millis(config.command_period_ms),
            timeout: Duration::from_millis(config.robot_timeout_ms),
            busy: Arc::default(),
        })
    }

    /// The name under which this process commands.
    pub fn commander(&self) -> &str {
        &self.commander
    }

    /// Carries a plan out. After `to_rest` the arm slows down on its path, and the execution ends when it stands.
    ///
    /// # Errors
    /// `unavailable` when the robot shows no state; `failed_precondition` and `invalid_argument` as [`Execution::begin`], also while another
    /// execution runs; that of `to_rest` where it comes before the first command. Once the robot has been commanded the outcome is a reply, unless
    /// the network fails.
    pub async fn execute(
        &self,
        plan: MotionPlan,
        task: ExecutionTask,
        to_rest: ToRest,
        progress: impl Fn(ExecuteProgress),
    ) -> Result<ExecuteReply, CallError> {
        let robot = plan.robot.clone();
        let begin = |state: &RobotState, now_ms| Execution::begin(plan, task, state, now_ms, self.settings);
        self.drive(&robot, begin, to_rest, progress).await
    }

    /// Carries phases out from where the robot stands.
    ///
    /// # Errors
    /// As [`Self::execute`], with the conditions of [`Execution::from_here`].
    pub async fn follow(
        &self,
        robot: &str,
        phases: Vec<MotionPhase>,
        task: ExecutionTask,
        to_rest: ToRest,
    ) -> Result<ExecuteReply, CallError> {
        let begin = |state: &RobotState, now_ms| Execution::from_here(phases, task, state, now_ms, self.settings);
        self.drive(robot, begin, to_rest, |_| {}).await
    }

    /// Drives one execution from its beginning to its reply.
    async fn drive(
        &self,
        robot: &str,
        begin: impl FnOnce(&RobotState, u64) -> Result<(Execution, Vec<ExecutionAction>), CallError>,
        mut to_rest: ToRest,
        progress: impl Fn(ExecuteProgress),
    ) -> Result<ExecuteReply, CallError> {
        let claim = self.claim(robot)?;
        let (mut states, first) = tokio::select! {
            // First, so that it is also looked at when the state has come: there is no wait between that and the first command.
            biased;
            why = &mut to_rest => return Err(why),
            shown = self.states(&claim.robot) => shown?,
        };
        let commands = self.commands(&claim.robot);
        let started = Instant::now();
        let now_ms = || started.elapsed().as_millis() as u64;
        if first.task.is_none() {
            tracing::warn!(
                robot,
                "this robot's side knows no tasks: it latches no stop when its commander is lost at rest, and does not say when it handled objects"
            );
        }
        let (mut execution, mut steps) = begin(&first, now_ms())?;
        let mut ticks = tokio::time::interval(self.period);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut halting = false;
        loop {
            for step in steps.drain(..) {
                match step {
                    ExecutionAction::Send(command) => {
                        let put = commands.put(Payload::json(&command)?).await;
                        // The arm may have moved: made again, the same call would have it move a second time.
                        put.map_err(|error| CallError { retryable: false, ..CallError::from(error) })?;
                    }
                    ExecutionAction::Progress(phase) => progress(phase),
                    ExecutionAction::Done(reply) => {
                        tracing::info!(robot, outcome = ?reply.outcome, phase = %reply.phase, reason = reply.reason, "execution ended");
                        return Ok(reply);
                    }
                }
            }
            steps = tokio::select! {
                sample = states.recv() => match sample.as_ref().map(read_robot_state) {
                    Some(Ok(state)) => execution.on_state(&state, now_ms()),
                    Some(Err(_)) => Vec::new(),
                    None => execution.abandon("the network closed"),
                },
                _ = ticks.tick() => execution.on_tick(now_ms()),
                why = &mut to_rest, if !halting => {
                    tracing::warn!(robot, reason = why.message, "the arm comes to rest");
                    halting = true;
                    execution.cancel(&why.message, now_ms())
                }
            };
        }
    }

    /// What a robot says of itself now.
    ///
    /// # Errors
    /// `unavailable` when it shows no state.
    pub async fn state(&self, robot: &str) -> Result<RobotState, CallError> {
        Ok(self.states(robot).await?.1)
    }

    /// Clears a latched stop, the one that is named where one is, and waits until the robot shows it cleared. A stop that latches meanwhile stays.
    ///
    /// # Errors
    /// `unavailable` when the robot shows no state; `failed_precondition` when the stop does not clear in time or another one has latched.
    pub async fn reset(&self, wanted: &RobotResetRequest) -> Result<RobotResetReply, CallError> {
        let claim = self.claim(&wanted.robot)?;
        let (mut states, mut state) = self.states(&claim.robot).await?;
        if state.mode != RobotMode::Stopped {
            return Ok(RobotResetReply { was_stopped: false });
        }
        // A robot may be stopped without saying why.
        let stop = state.stop.clone();
        let another = |latched: &StopState| {
            let message = format!("another stop has latched meanwhile: {} ({})", latched.reason, latched.kind);
            CallError::precondition(message).at("robot")
        };
        if let (Some(wanted), Some(latched)) = (&wanted.stop, &stop)
            && wanted != latched
        {
            return Err(another(latched));
        }
        let commands = self.commands(&claim.robot);
        let owner = next_owner(&self.commander, &state)?;
        let deadline = tokio::time::Instant::now() + self.timeout;
        let mut seq = 0;
        let mut ticks = tokio::time::interval(self.period);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                sample = states.recv() => match sample.as_ref().map(read_robot_state) {
                    Some(Ok(newer)) => state = newer,
                    Some(Err(_)) => {}
                    None => return Err(CallError::new(ErrorCode::Unavailable, "the network closed")),
                },
                _ = ticks.tick() => {
                    seq += 1;
                    // It names the stop that it clears: no other that may latch before it arrives.
                    let clearing = RobotCommand { clear_stop: true, clears: stop.clone(), ..RobotCommand::new(owner.clone(), seq, self.settings.ttl_ms) };
                    commands.put(Payload::json(&clearing)?).await?;
                }
                () = tokio::time::sleep_until(deadline) => {
                    let why = stop.map_or_else(|| "the robot does not say why".to_owned(), |stop| format!("{}: {}", stop.kind, stop.reason));
                    return Err(CallError::precondition(format!("the stop did not clear: {why}")).at("robot"));
                }
            }
            if state.mode != RobotMode::Stopped {
                return Ok(RobotResetReply { was_stopped: true });
            }
            if let Some(latched) = state.stop.as_ref().filter(|latched| stop.as_ref() != Some(*latched)) {
                return Err(another(latched));
            }
        }
    }

    fn claim(&self, robot: &str) -> Result<Claim, CallError> {
        if !self.busy.lock().unwrap_or_else(PoisonError::into_inner).insert(robot.to_owned()) {
            return Err(CallError::precondition(format!("robot {robot} is being commanded already")).at("robot"));
        }
        Ok(Claim { robot: robot.to_owned(), busy: self.busy.clone() })
    }

    fn commands(&self, robot: &str) -> Publisher {
        self.session.publisher(self.session.cell().robot_command(robot), Traffic::RobotCommand)
    }

    /// A robot's states, and the first of them that can be read.
    ///
    /// # Errors
    /// `unavailable` on `robot` when there is none in time: what a robot's side says is no fault of the request.
    async fn states(&self, robot: &str) -> Result<(Subscription, RobotState), CallError> {
        let mut states = self.session.subscribe_latest(&self.session.cell().robot_state(robot)).await?;
        let mut unread = None;
        let readable = async {
            loop {
                match read_robot_state(&states.recv().await?) {
                    Ok(state) => return Some(state),
                    Err(error) => unread = Some(error),
                }
            }
        };
        let first = tokio::time::timeout(self.timeout, readable).await.ok().flatten();
        let silent = || match &unread {
            None => format!("robot {robot} shows no state"),
            Some(error) => format!("robot {robot} shows no state that can be read: {error}"),
        };
        let first = first.ok_or_else(|| CallError::new(ErrorCode::Unavailable, silent()).at("robot"))?;
        Ok((states, first))
    }
}
