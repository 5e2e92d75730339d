//! Whenever a commander is lost within an execution, the robot's side latches a stop, and an operator brings the arm back.
//!
//! The real execution drives the real arm's controller, without processes and physics, so that many moments take seconds: the hand is a stand-in
//! that finds the object where the plan closes it. `lost_processes.rs` does the same with processes.

use nalgebra::Isometry3;
use repose_motion::execution::{Execution, ExecutionAction, ExecutionSettings, ExecutionTask};
use repose_motion::path::timing::Trajectory;
use repose_motion::pick_place::{PickPlaceRequest, PickPlaceSettings, pick_place};
use repose_motion::recovery::{Recovery, RecoverySettings};
use repose_motion::scene::ArmSurroundings;
use repose_motion::{MotionConfig, synthetic, wire};
use repose_panda::READY;
use repose_proto::motion::{ExecuteReply, ExecutionOutcome, MotionPhase, MotionPlan, MotionPlanRequest, Phase};
use repose_proto::robot::{GripperCommand, Owner, RobotCommand, RobotMode, RobotState, TaskState};
use repose_proto::{RigidTransform, limits};
use repose_simulator::robot::Arm;

/// Moments of an execution at which something is lost.
const MOMENTS: u64 = 40;
/// How long after it the robot must have latched a stop and stand, milliseconds: the time to live, a state, and braking.
const LATCHED_WITHIN_MS: u64 = 1500;
/// Speed of the fingers, metres per millisecond, and the width of the object between them, metres.
const FINGERS_M_MS: f64 = 0.000_12;
const OBJECT_M: f64 = 0.05;
/// Between two states, and between two ticks of the commander, milliseconds.
const STATE_MS: u64 = 10;
const TICK_MS: u64 = 50;

/// The robot's side on a clock of its own.
struct Robot {
    arm: Arm,
    now_ms: u64,
    width_m: f64,
    goal_m: f64,
    settled_ms: u64,
    /// Whether there is something to close on.
    has_object: bool,
}

impl Robot {
    fn new() -> Self {
        Self { arm: Arm::default(), now_ms: 0, width_m: 0.08, goal_m: 0.08, settled_ms: 0, has_object: true }
    }

    fn step(&mut self) {
        self.now_ms += 1;
        let least_m = if self.has_object { OBJECT_M } else { 0.0 };
        let aim_m = if self.goal_m < self.width_m { self.goal_m.max(least_m) } else { self.goal_m };
        let before_m = self.width_m;
        self.width_m += (aim_m - self.width_m).clamp(-FINGERS_M_MS, FINGERS_M_MS);
        self.settled_ms = if self.width_m == before_m { self.settled_ms + 1 } else { 0 };
        let now_s = self.now_ms as f64 * 1e-3;
        self.arm.set_grips(self.grips(), now_s);
        self.arm.tick(now_s);
        if let Some(GripperCommand { width_m, .. }) = self.arm.take_gripper() {
            (self.goal_m, self.settled_ms) = (width_m, 0);
        }
    }

    fn grips(&self) -> bool {
        self.settled_ms > 0 && self.width_m > self.goal_m + 0.001
    }

    fn take(&mut self, command: &RobotCommand) {
        // What it ignores, it ignores.
        let _ignored = self.arm.command(command, self.now_ms as f64 * 1e-3);
    }

    fn state(&self) -> RobotState {
        let settled = self.settled_ms > 50;
        RobotState {
            v: limits::VERSION,
            seq: self.now_ms,
            stamp_ns: 0,
            robot_ms: self.now_ms as f64,
            q_rad: *self.arm.q_rad(),
            dq_rad_s: *self.arm.dq_rad_s(),
            gripper_width_m: self.width_m,
            gripper_settled: settled,
            gripper_holding: settled && self.grips(),
            mode: self.arm.mode(),
            stop: self.arm.stop().cloned(),
            owner: self.arm.owner().cloned(),
            last_command: self.arm.last_command(),
            stream_ms: self.arm.stream_ms(),
            task: Some(TaskState { id: self.arm.task().map(str::to_owned) }),
            held: self.arm.held().cloned(),
            model: None,
            world_from_base: None,
            since_handling_ms: None,
            horizon_ms: None,
        }
    }

    fn stands(&self) -> bool {
        self.arm.dq_rad_s().iter().all(|v| *v == 0.0)
    }
}

/// What is lost.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Lost {
    /// The motion process.
    Commander,
    /// Everything between the two: the router, or the robot's link.
    Link,
}

fn plan() -> MotionPlan {
    let scene = synthetic::scene();
    let aside = Isometry3::translation(0.0, 0.45, 0.0);
    let request = PickPlaceRequest { scene: &scene, query: 1, placements: &[aside], start: &READY, grasps: None, seed: 3 };
    let planned = pick_place(&request, &PickPlaceSettings::default()).expect("a plan");
    let request = MotionPlanRequest::new("0".repeat(64), "panda".to_owned(), 1, vec![RigidTransform::IDENTITY], READY);
    wire::motion_plan(&planned, &request, 0, &MotionConfig::default().terms().expect("terms"))
}

fn task(id: &str) -> ExecutionTask {
    ExecutionTask { commander: "motion-1".to_owned(), id: id.to_owned(), grasps: None }
}

/// Drives an execution to its reply, or until something is lost; then on for a while. What the commander says, where it is left to say it.
fn drive(
    robot: &mut Robot,
    (mut execution, mut steps): (Execution, Vec<ExecutionAction>),
    lost: Option<(Lost, u64)>,
) -> Option<ExecuteReply> {
    let (mut reply, mut phase) = (None, None);
    for elapsed_ms in 0.. {
        let (gone, cut) = match lost {
            Some((what, at_ms)) if elapsed_ms >= at_ms => (what == Lost::Commander, true),
            _ => (false, false),
        };
        for step in steps.drain(..) {
            match step {
                ExecutionAction::Send(command) if !cut => robot.take(&command),
                ExecutionAction::Send(_) => {}
                ExecutionAction::Progress(progress) => phase = Some(progress.phase),
                ExecutionAction::Done(done) => reply = Some(done),
            }
        }
        if lost.is_none() && reply.is_some() || lost.is_some_and(|(_, at_ms)| elapsed_ms > at_ms + LATCHED_WITHIN_MS) {
            break;
        }
        // The object stays where it was released.
        if phase == Some(Phase::Retreat) {
            robot.has_object = false;
        }
        robot.step();
        if reply.is_none() && !gone {
            if elapsed_ms % STATE_MS == 0 && !cut {
                steps.extend(execution.on_state(&robot.state(), elapsed_ms));
            }
            if elapsed_ms % TICK_MS == 0 {
                steps.extend(execution.on_tick(elapsed_ms));
            }
        }
        assert!(elapsed_ms < 300_000, "the execution never ended");
    }
    reply
}

fn phases(name: Phase, trajectory: &Trajectory) -> Vec<MotionPhase> {
    vec![MotionPhase { name, gripper: None, set_points: wire::set_points(trajectory, 10.0) }]
}

/// What an operator does: reset, open, retreat, home.
fn brought_back(robot: &mut Robot) {
    let stop = robot.arm.stop().cloned();
    let owner = Owner { id: "motion-2".to_owned(), epoch: robot.arm.owner().map_or(1, |owner| owner.epoch + 1) };
    robot.take(&RobotCommand { clear_stop: true, clears: stop, ..RobotCommand::new(owner, 1, 500) });
    assert_eq!((robot.arm.mode(), robot.arm.task()), (RobotMode::Idle, None), "the stop and the task are cleared");
    let follow = |robot: &mut Robot, phases: Vec<MotionPhase>| {
        let name = phases[0].name;
        let begun = Execution::from_here(phases, task("recovery"), &robot.state(), 0, ExecutionSettings::default()).expect("it begins");
        let reply = drive(robot, begun, None).expect("a reply");
        assert_eq!(reply.outcome, ExecutionOutcome::Done, "{name}: {:?}", reply.reason);
    };
    let open = GripperCommand { width_m: 0.08, force_n: 30.0 };
    follow(robot, vec![MotionPhase { name: Phase::Release, gripper: Some(open), set_points: Vec::new() }]);
    assert!(!robot.grips(), "the hand is empty");
    let (around, settings) = (ArmSurroundings::of(&synthetic::wire_scene(0)), RecoverySettings::of(&PickPlaceSettings::default(), 1.0));
    // Where the hand has no room behind it, it is in free space already.
    let retreat = Recovery::new(robot.arm.q_rad(), 0.08, Some(&around), &settings).retreat();
    if let Ok((trajectory, _)) = retreat {
        follow(robot, phases(Phase::Retreat, &trajectory));
    }
    let home = Recovery::new(robot.arm.q_rad(), 0.08, Some(&around), &settings).home(&|| false);
    if let Some(trajectory) = home.unwrap_or_else(|error| panic!("{error}")) {
        follow(robot, phases(Phase::Home, &trajectory));
    }
    assert!((0..7).all(|i| (robot.arm.q_rad()[i] - READY[i]).abs() < 1e-3), "it is in its ready pose");
    assert_eq!((robot.arm.mode(), robot.arm.task()), (RobotMode::Idle, None));
}

#[test]
fn whenever_the_commander_or_the_link_is_lost_the_robot_latches_and_can_be_brought_back() {
    let plan = plan();
    let begin =
        |robot: &Robot| Execution::begin(plan.clone(), task("t1"), &robot.state(), 0, ExecutionSettings::default()).expect("it begins");
    let mut robot = Robot::new();
    let begun = begin(&robot);
    assert_eq!(drive(&mut robot, begun, None).map(|reply| reply.outcome), Some(ExecutionOutcome::Done), "undisturbed it is carried out");
    assert_eq!((robot.arm.mode(), robot.arm.task()), (RobotMode::Idle, None));
    let whole_ms = robot.now_ms;
    let mut held = 0;
    for moment in 0..MOMENTS {
        for lost in [Lost::Commander, Lost::Link] {
            let mut robot = Robot::new();
            // Between the first command and the last, never on a multiple of the commander's ticks.
            let at_ms = 20 + moment * (whole_ms - 120) / MOMENTS;
            let begun = begin(&robot);
            let reply = drive(&mut robot, begun, Some((lost, at_ms)));
            assert_eq!(robot.arm.mode(), RobotMode::Stopped, "{lost:?} lost after {at_ms} ms of {whole_ms}: not latched");
            assert!(robot.stands(), "{lost:?} lost after {at_ms} ms: it still moves");
            let stop = robot.arm.stop().expect("a stop");
            assert_eq!((stop.kind.as_str(), robot.arm.task()), ("commander_silent", Some("t1")));
            held += u32::from(robot.grips());
            assert!(reply.is_none_or(|reply| reply.outcome == ExecutionOutcome::Stopped), "nobody takes it for done");
            brought_back(&mut robot);
        }
    }
    assert!(held > 10, "{held} moments had the object in the hand");
}
