//! A plan and a robot for tests: it takes every command and follows its stream, checking what the contract says of both.
#![allow(dead_code, reason = "each test uses its share")]

use repose_motion::execution::ExecutionTask;
use repose_proto::motion::{Grasp, MotionPhase, MotionPlan, Phase};
use repose_proto::robot::{GripperCommand, RobotCommand, RobotMode, RobotState, SetPoint, StopState, TaskState};
use repose_proto::{Message, RigidTransform};

/// The wall clock of these tests, nanoseconds.
pub const NOW_NS: u64 = 1_000_000_000_000;
/// The phases of a plan.
pub const PHASES: [Phase; 8] =
    [Phase::Standoff, Phase::Approach, Phase::Grasp, Phase::Lift, Phase::Transfer, Phase::Lower, Phase::Release, Phase::Retreat];

/// Joint 1 goes to and fro by 0.1 rad in each moving phase, one second each.
pub fn plan() -> MotionPlan {
    let mut at = 0.0;
    let phases = PHASES.map(|name| {
        let gripper = [Phase::Standoff, Phase::Grasp, Phase::Release]
            .contains(&name)
            .then_some(GripperCommand { width_m: if name == Phase::Grasp { 0.0 } else { 0.05 }, force_n: 30.0 });
        let moves = ![Phase::Grasp, Phase::Release].contains(&name);
        let from = at;
        if moves {
            at = 0.1 - at;
        }
        let set_points = (0..=if moves { 50 } else { -1 })
            .map(|k| SetPoint { t_ms: 20.0 * f64::from(k), q_rad: joints(from + (at - from) * f64::from(k) / 50.0), dq_rad_s: [0.0; 7] })
            .collect();
        MotionPhase { name, gripper, set_points }
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
        heeded: None,
    }
}

/// The task that tests execute as.
pub fn task() -> ExecutionTask {
    ExecutionTask { commander: "motion-1".to_owned(), id: "t1".to_owned(), grasps: None }
}

/// The ready pose with another first joint.
pub fn joints(first: f64) -> [f64; 7] {
    [first, -0.7, 0.0, -2.3, 0.0, 1.5, 0.7]
}

/// A robot that takes every command and follows its stream, 10 ms at a time.
pub struct Robot {
    /// What it shows.
    pub state: RobotState,
    points: Vec<SetPoint>,
    ends: bool,
    /// Whether its fingers find anything.
    pub holds: bool,
    /// Whether it takes no commands.
    pub deaf: bool,
    /// Whether it stops when the last command outlives its time to live, counted in robot time.
    pub heeds_ttl: bool,
    expires_ms: f64,
    /// The stop that the last clearing command named.
    pub cleared: Option<StopState>,
    /// Gripper actions taken.
    pub actions: usize,
    /// The number of the one, from 1, that it does not carry out, and that one.
    pub refuses: usize,
    pub refused: Option<GripperCommand>,
    /// What the last gripper action was to grasp.
    pub grasps: Option<repose_proto::robot::HeldObject>,
}

impl Robot {
    /// At rest, without an owner.
    pub fn new() -> Self {
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
            task: Some(TaskState::default()),
            held: None,
            model: None,
            world_from_base: None,
            since_handling_ms: None,
            horizon_ms: None,
        };
        Self {
            state,
            points: Vec::new(),
            ends: false,
            holds: true,
            deaf: false,
            heeds_ttl: false,
            expires_ms: 0.0,
            cleared: None,
            actions: 0,
            refuses: 0,
            refused: None,
            grasps: None,
        }
    }

    /// Takes a command.
    pub fn take(&mut self, command: &RobotCommand) {
        if self.deaf {
            return;
        }
        command.validate().unwrap();
        self.expires_ms = self.state.robot_ms + command.ttl_ms as f64;
        if self.state.owner.as_ref() == Some(&command.owner) && self.state.last_command == Some(command.seq) {
            return;
        }
        assert!(self.state.owner.as_ref() != Some(&command.owner) || self.state.last_command.is_none_or(|seq| command.seq > seq), "replay");
        self.state.owner = Some(command.owner.clone());
        self.state.last_command = Some(command.seq);
        if command.clear_stop {
            self.cleared.clone_from(&command.clears);
            self.state.mode = RobotMode::Idle;
            self.state.stop = None;
        }
        if let (Some(task), Some(shown)) = (&command.task, &mut self.state.task) {
            assert!(shown.id.as_ref().is_none_or(|open| *open == task.id), "one task at a time");
            shown.id = task.open.then(|| task.id.clone());
            if !task.open && self.state.gripper_holding {
                self.state.mode = RobotMode::Stopped;
                let reason = format!("task {} was closed with an object in the hand", task.id);
                self.state.stop = Some(StopState { kind: "task_unfinished".to_owned(), reason, estop_id: None });
            }
        }
        assert!(self.state.task.is_none() == command.task.is_none() || command.clear_stop, "tasks are for robots that know them");
        if let Some(gripper) = command.gripper {
            self.actions += 1;
            if self.actions == self.refuses {
                self.refused = Some(gripper);
            } else {
                self.act(gripper);
            }
            self.grasps = command.task.as_ref().and_then(|task| task.grasps.clone());
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

    /// Carries a gripper action out, at once.
    pub fn act(&mut self, gripper: GripperCommand) {
        self.state.gripper_holding = self.holds && gripper.width_m == 0.0;
        self.state.gripper_width_m = if self.state.gripper_holding { 0.03 } else { gripper.width_m };
    }

    /// Ten milliseconds of robot time.
    pub fn advance(&mut self) {
        self.state.seq += 1;
        self.state.robot_ms += 10.0;
        let lost = self.state.open_task().is_some() && self.state.robot_ms > self.expires_ms;
        assert!(!self.heeds_ttl || !lost, "the commander is silent within its task");
        if self.state.mode == RobotMode::Moving {
            assert!(!self.heeds_ttl || self.ends || self.state.robot_ms <= self.expires_ms, "the commander is silent");
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
