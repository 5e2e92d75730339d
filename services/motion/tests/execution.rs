//! An execution against a robot that follows its set-points, and against one that does not.

use repose_motion::execution::{Execution, ExecutionSettings, Step};
use repose_proto::ErrorCode;
use repose_proto::motion::{ExecutionOutcome, Grasp, MotionPhase, MotionPlan};
use repose_proto::robot::{GripperCommand, Owner, RobotCommand, RobotMode, RobotState, SetPoint, StopState};
use repose_proto::{Message, RigidTransform};

const NOW_NS: u64 = 1_000_000_000_000;
const NAMES: [&str; 8] = ["standoff", "approach", "grasp", "lift", "transfer", "lower", "release", "retreat"];

/// Joint 1 goes to and fro by 0.1 rad in each moving phase, one second each.
fn plan() -> MotionPlan {
    let mut at = 0.0;
    let phases = NAMES.map(|name| {
        let gripper = ["standoff", "grasp", "release"].contains(&name).then_some(GripperCommand { width_m: 0.05, force_n: 30.0 });
        let moves = !["grasp", "release"].contains(&name);
        let from = at;
        if moves {
            at = 0.1 - at;
        }
        let set_points = (0..=if moves { 50 } else { -1 })
            .map(|k| SetPoint { t_ms: 20.0 * f64::from(k), q_rad: joints(from + (at - from) * f64::from(k) / 50.0), dq_rad_s: [0.0; 7] })
            .collect();
        MotionPhase { name: name.to_owned(), gripper, set_points }
    });
    MotionPlan {
        scene_id: "0".repeat(64),
        robot: "panda".to_owned(),
        query: 1,
        placement: 0,
        not_chosen: Vec::new(),
        grasp: Grasp { world_from_tcp: RigidTransform::IDENTITY, width_m: 0.05, score: 1.0 },
        start_joints_rad: joints(0.0),
        start_tolerance_rad: 0.01,
        scene_stamp_ns: NOW_NS - 1_000_000_000,
        max_scene_age_ms: 2000,
        phases: phases.into(),
        duration_ms: 6000.0,
    }
}

fn joints(first: f64) -> [f64; 7] {
    [first, -0.7, 0.0, -2.3, 0.0, 1.5, 0.7]
}

/// A robot that takes every command and follows its stream, 10 ms at a time.
struct Robot {
    state: RobotState,
    points: Vec<SetPoint>,
    ends: bool,
    holds: bool,
    deaf: bool,
}

impl Robot {
    fn new() -> Self {
        let state = RobotState {
            v: 1,
            seq: 0,
            stamp_ns: NOW_NS,
            robot_ms: 0.0,
            q_rad: joints(0.0),
            dq_rad_s: [0.0; 7],
            gripper_width_m: 0.08,
            gripper_settled: true,
            gripper_holding: false,
            mode: RobotMode::Idle,
            stop: None,
            owner: None,
            last_command: None,
            stream_ms: None,
        };
        Self { state, points: Vec::new(), ends: false, holds: true, deaf: false }
    }

    fn take(&mut self, command: &RobotCommand) {
        if self.deaf {
            return;
        }
        command.validate().unwrap();
        assert!(self.state.owner.as_ref() != Some(&command.owner) || self.state.last_command.is_none_or(|seq| command.seq > seq), "replay");
        self.state.owner = Some(command.owner.clone());
        self.state.last_command = Some(command.seq);
        if let Some(gripper) = command.gripper {
            self.state.gripper_holding =
                self.holds && gripper.width_m < 0.08 && self.state.robot_ms > 1000.0 && self.state.robot_ms < 5000.0;
        }
        if command.starts_stream {
            assert_eq!(self.state.mode, RobotMode::Idle, "a stream starts at rest");
            self.points.clear();
            self.state.stream_ms = Some(0.0);
            self.state.mode = RobotMode::Moving;
        }
        if let (Some(first), Some(last)) = (command.set_points.first(), command.set_points.last()) {
            assert!(command.ends_stream || last.t_ms - self.state.stream_ms.unwrap() >= 200.0, "the horizon is long enough");
            self.points.retain(|p| p.t_ms < first.t_ms);
            self.points.extend_from_slice(&command.set_points);
            self.ends = command.ends_stream;
        }
    }

    fn advance(&mut self) {
        self.state.seq += 1;
        self.state.robot_ms += 10.0;
        if self.state.mode == RobotMode::Moving {
            let time = self.state.stream_ms.unwrap() + 10.0;
            self.state.stream_ms = Some(time);
            let point = self.points.iter().rfind(|p| p.t_ms <= time).unwrap();
            self.state.q_rad = point.q_rad;
            let last = self.points.last().unwrap();
            assert!(time <= last.t_ms || self.ends, "the robot ran out of set-points");
            if time >= last.t_ms {
                self.state.mode = RobotMode::Idle;
            }
        }
    }
}

/// Runs to the end; what was told on the way, and the last step.
fn run(robot: &mut Robot, mut meddle: impl FnMut(&mut Robot, &mut Execution, u64) -> Vec<Step>) -> (Vec<String>, Step) {
    let (mut execution, mut steps) = Execution::begin(plan(), "motion-1", &robot.state, NOW_NS, 0, ExecutionSettings::default()).unwrap();
    let mut phases = Vec::new();
    for now_ms in (0..20_000).step_by(10) {
        robot.advance();
        steps.extend(meddle(robot, &mut execution, now_ms));
        if !robot.deaf {
            steps.extend(execution.on_state(&robot.state, now_ms));
        }
        if now_ms % 50 == 0 {
            steps.extend(execution.on_tick(now_ms));
        }
        for step in steps.drain(..) {
            match step {
                Step::Send(command) => robot.take(&command),
                Step::Progress(progress) => phases.push(progress.phase),
                done @ Step::Done(_) => return (phases, done),
            }
        }
    }
    panic!("the execution never ended; phases {phases:?}");
}

fn outcome(step: &Step) -> (ExecutionOutcome, String, String) {
    let Step::Done(reply) = step else { panic!("{step:?}") };
    (reply.outcome, reply.phase.clone(), reply.reason.clone().unwrap_or_default())
}

#[test]
fn a_robot_that_follows_runs_through_all_phases() {
    let mut robot = Robot::new();
    let (phases, done) = run(&mut robot, |_, _, _| Vec::new());
    assert_eq!(phases, NAMES);
    assert_eq!(outcome(&done), (ExecutionOutcome::Done, "retreat".to_owned(), String::new()));
    assert!((robot.state.q_rad[0] - 0.0).abs() < 1e-9, "six moves to and fro");
}

#[test]
fn fingers_that_close_on_nothing_end_it_at_the_grasp() {
    let mut robot = Robot::new();
    robot.holds = false;
    let (_, done) = run(&mut robot, |_, _, _| Vec::new());
    assert_eq!((outcome(&done).0, outcome(&done).1), (ExecutionOutcome::GraspLost, "grasp".to_owned()));
}

#[test]
fn an_object_lost_on_the_way_is_noticed_at_the_end_of_the_phase() {
    let mut robot = Robot::new();
    let (phases, done) = run(&mut robot, |robot, _, _| {
        if robot.state.robot_ms > 3800.0 {
            robot.state.gripper_holding = false;
        }
        Vec::new()
    });
    assert_eq!((outcome(&done).0, outcome(&done).1.as_str()), (ExecutionOutcome::GraspLost, "transfer"), "{phases:?}");
}

#[test]
fn a_latched_stop_ends_it_with_the_reason() {
    let mut robot = Robot::new();
    let (_, done) = run(&mut robot, |robot, _, _| {
        if robot.state.robot_ms > 700.0 {
            robot.state.mode = RobotMode::Stopped;
            robot.state.stop = Some(StopState { kind: "estop".to_owned(), reason: "button".to_owned(), estop_id: None });
        }
        Vec::new()
    });
    assert_eq!(outcome(&done), (ExecutionOutcome::Stopped, "standoff".to_owned(), "estop: button".to_owned()));
}

#[test]
fn another_owner_ends_it() {
    let mut robot = Robot::new();
    let (_, done) = run(&mut robot, |robot, _, _| {
        if robot.state.robot_ms > 700.0 {
            robot.state.owner = Some(Owner { id: "motion-2".to_owned(), epoch: 2 });
        }
        Vec::new()
    });
    assert!(outcome(&done).2.contains("motion-2"));
}

#[test]
fn a_silent_robot_and_a_deaf_one_end_it() {
    let mut robot = Robot::new();
    let (_, done) = run(&mut robot, |robot, _, _| {
        robot.deaf = robot.state.robot_ms > 700.0;
        Vec::new()
    });
    assert!(outcome(&done).2.contains("silent"));

    let mut robot = Robot::new();
    let (_, done) = run(&mut robot, |robot, execution, now_ms| {
        robot.deaf = true;
        execution.on_state(&robot.state.clone(), now_ms)
    });
    assert!(outcome(&done).2.contains("does not take commands"));
}

#[test]
fn a_cancel_ends_it_and_nothing_is_sent_afterwards() {
    let mut robot = Robot::new();
    let (_, done) = run(&mut robot, |robot, execution, now_ms| {
        if robot.state.robot_ms < 900.0 {
            return Vec::new();
        }
        let steps = execution.cancel("cancelled");
        assert!(execution.on_tick(now_ms).is_empty() && execution.on_state(&robot.state, now_ms).is_empty());
        steps
    });
    assert_eq!(outcome(&done).2, "cancelled");
}

#[test]
fn a_plan_that_does_not_fit_the_world_is_refused() {
    let begin = |plan: MotionPlan, state: &RobotState| {
        Execution::begin(plan, "motion-1", state, NOW_NS, 0, ExecutionSettings::default()).map(|_| ()).unwrap_err()
    };
    let idle = Robot::new().state;
    let refused = |error: repose_proto::CallError, field: &str| {
        assert_eq!((error.code, error.field.as_deref()), (ErrorCode::FailedPrecondition, Some(field)));
    };
    refused(begin(plan(), &RobotState { mode: RobotMode::Stopped, ..idle.clone() }), "robot");
    refused(begin(plan(), &RobotState { mode: RobotMode::Moving, ..idle.clone() }), "robot");
    refused(begin(plan(), &RobotState { q_rad: joints(0.05), ..idle.clone() }), "start_joints_rad");
    refused(begin(MotionPlan { max_scene_age_ms: 500, ..plan() }, &idle), "scene_stamp_ns");
    let mut torn = plan();
    torn.phases[1].set_points.iter_mut().for_each(|p| p.q_rad[0] += 0.5);
    assert_eq!(begin(torn, &idle).code, ErrorCode::InvalidArgument);
}
