//! The simulated cell in robot time: plans carried out, the arm brought back, and fresh views, as the services do it over the network.

use repose_geometry::Image;
use repose_motion::execution::{Execution, ExecutionAction, ExecutionTask};
use repose_motion::recovery::Recovery;
use repose_motion::wire;
use repose_panda::FINGER_OPENING_MAX_M;
use repose_proto::motion::{ExecuteReply, ExecutionOutcome, MotionPhase, MotionPlan, Phase};
use repose_proto::robot::{GripperCommand, RobotState};
use repose_simulator::cell_world::CellWorld;
use repose_simulator::scene::SimulatedScene;
use repose_tracking::holds;

use crate::scenes::carry_watch::CarryWatch;
use crate::scenes::problem::{Problem, frame_of_picture};
use crate::scenes::robot_scene::arm_in_view;
use crate::scenes::robot_settings::{RobotTrialError, RobotTrialSettings};

/// The pictures of a trial: before, and of each attempt lifted, lowered, placed. Those of steps not come to are missing.
pub type Strip = Vec<Image<[u8; 3]>>;

/// A cell in which one execution follows another, on one clock.
pub struct CellRun<'a> {
    /// The cell.
    pub cell: &'a mut CellWorld,
    settings: &'a RobotTrialSettings,
    now_ms: u64,
    seq: u64,
}

/// Between two states of the robot, milliseconds.
const STATE_MS: u64 = 10;

impl<'a> CellRun<'a> {
    /// Of a cell whose clock begins.
    pub fn new(cell: &'a mut CellWorld, settings: &'a RobotTrialSettings) -> Self {
        Self { cell, settings, now_ms: 0, seq: 0 }
    }

    /// Drives the arm with a plan, state by state; pictures are taken when the lift and when the lowering have ended.
    ///
    /// # Errors
    /// As [`Execution::begin`].
    pub fn carry_out(
        &mut self,
        plan: MotionPlan,
        scene: &SimulatedScene,
        watch: &mut CarryWatch,
        strip: &mut Strip,
    ) -> Result<ExecuteReply, RobotTrialError> {
        let (state, settings) = (self.state(), self.settings.motion.execution()?);
        let begun = Execution::begin(plan, task(), &state, self.now_ms, settings)?;
        let mut progress = |phase: Phase, cell: &mut CellWorld, watch: &mut CarryWatch| {
            watch.begins(phase, cell);
            if matches!(phase, Phase::Transfer | Phase::Release) {
                strip.push(cell.true_picture(true).color);
            }
        };
        Ok(self.follow(begun, Some((watch, scene)), &mut progress))
    }

    /// Waits until the world is at rest, as long as the settings allow.
    pub fn come_to_rest(&mut self) {
        let mut waited_s = 0.0;
        while waited_s < self.settings.rest_s && (waited_s < 0.5 || !self.cell.at_rest()) {
            self.cell.step(f64::INFINITY);
            waited_s += self.cell.step_s();
        }
        self.now_ms += (waited_s * 1e3).round() as u64;
    }

    /// The problem as it is seen after an execution, where that calls for another attempt: the grasp was lost, or the goal does not hold in a
    /// fresh view. The hand is opened and the arm brought home first. None where there is nothing to try again, or the arm does not get home.
    pub fn seen_again(&mut self, problem: &Problem, outcome: ExecutionOutcome) -> Option<Problem> {
        if outcome == ExecutionOutcome::Done {
            let seen = self.view(problem)?;
            let yaw_rad = seen.observed.meta.view_yaw_rad;
            if holds(&seen.observed, yaw_rad, problem.query, &[problem.goal]).iter().all(|holds| *holds) {
                return None;
            }
        }
        self.bring_back(problem)?;
        self.come_to_rest();
        self.view(problem)
    }

    /// Opens the hand, backs off along the fingers where that is free, and goes home.
    fn bring_back(&mut self, problem: &Problem) -> Option<()> {
        let gripper = GripperCommand { width_m: FINGER_OPENING_MAX_M, force_n: self.settings.motion.grip_force_n };
        self.recover(vec![MotionPhase { name: Phase::Release, gripper: Some(gripper), set_points: Vec::new() }])?;
        let (settings, period_ms) = (self.settings.motion.recovery().ok()?, self.settings.motion.terms().ok()?.set_point_period_ms);
        for name in [Phase::Retreat, Phase::Home] {
            let surroundings = wire::surroundings(&self.view(problem)?.observed).ok()?;
            let state = self.state();
            let recovery = Recovery::new(&state.q_rad, state.gripper_width_m, Some(&surroundings), &settings);
            let way = match name {
                // The way home may be free all the same.
                Phase::Retreat => recovery.retreat().ok().map(|(way, _)| way),
                _ => recovery.home(&|| false).ok()?,
            };
            if let Some(way) = way {
                self.recover(vec![MotionPhase { name, gripper: None, set_points: wire::set_points(&way, period_ms) }])?;
            }
        }
        Some(())
    }

    fn recover(&mut self, phases: Vec<MotionPhase>) -> Option<()> {
        let (state, settings) = (self.state(), self.settings.motion.execution().ok()?);
        let begun = Execution::from_here(phases, task(), &state, self.now_ms, settings).ok()?;
        let reply = self.follow(begun, None, &mut |_, _, _| {});
        (reply.outcome == ExecutionOutcome::Done).then_some(())
    }

    /// What the camera sees now, the robot in the picture, with true masks.
    fn view(&mut self, problem: &Problem) -> Option<Problem> {
        let truth = self.cell.truth();
        let picture = self.cell.sensed_picture(&self.settings.sensor, true);
        let (state, stamp_ns) = (self.state(), self.now_ns());
        let robot = arm_in_view(state.q_rad, state.gripper_width_m, state.gripper_holding);
        let mut frame = frame_of_picture(picture, &problem.camera, &problem.world_from_camera);
        (frame.robots, frame.stamp_ns) = (vec![robot], stamp_ns);
        let observed = repose_perception::segment(&frame, &repose_perception::Settings::default()).ok()?;
        Some(Problem { truth, frame, observed, ..problem.clone() })
    }

    fn now_ns(&self) -> u64 {
        self.now_ms * 1_000_000
    }

    fn state(&mut self) -> RobotState {
        self.seq += 1;
        self.cell.robot_state(self.seq, self.now_ns())
    }

    /// Drives the arm until an execution is over; `progress` is told of each phase.
    fn follow(
        &mut self,
        (mut execution, mut actions): (Execution, Vec<ExecutionAction>),
        mut watched: Option<(&mut CarryWatch, &SimulatedScene)>,
        progress: &mut dyn FnMut(Phase, &mut CellWorld, &mut CarryWatch),
    ) -> ExecuteReply {
        let begun_ms = self.now_ms;
        let steps_per_state = (STATE_MS as f64 * 1e-3 / self.cell.step_s()).round().max(1.0) as usize;
        loop {
            let now_s = self.now_ms as f64 * 1e-3;
            for action in actions.drain(..) {
                match action {
                    ExecutionAction::Send(command) => {
                        if let Err(why) = self.cell.arm.command(&command, now_s) {
                            tracing::debug!(seq = command.seq, %why, "command ignored");
                        }
                    }
                    ExecutionAction::Progress(told) => {
                        if let Some((watch, _)) = &mut watched {
                            progress(told.phase, self.cell, watch);
                        }
                    }
                    ExecutionAction::Done(reply) => return reply,
                }
            }
            for _ in 0..steps_per_state {
                self.cell.step(now_s);
            }
            if let Some((watch, scene)) = &mut watched {
                watch.look(self.cell, scene);
            }
            self.now_ms += STATE_MS;
            let state = self.state();
            actions = execution.on_state(&state, self.now_ms);
            if self.now_ms % self.settings.motion.command_period_ms < STATE_MS {
                actions.extend(execution.on_tick(self.now_ms));
            }
            if (self.now_ms - begun_ms) as f64 * 1e-3 > self.settings.longest_s {
                actions.extend(execution.cancel("the trial's time is up", self.now_ms));
            }
        }
    }
}

fn task() -> ExecutionTask {
    ExecutionTask { commander: "evaluation".to_owned(), id: "trial".to_owned(), grasps: None }
}
