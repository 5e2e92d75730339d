//! A running system at the hands of a command that has a robot carry things out: Ctrl-C stops the robot.

use std::time::Duration;

use repose_executive::Site;
use repose_proto::motion::MotionPlan;
use repose_proto::robot::RobotState;
use repose_proto::{CallError, Payload, Scene, SceneSummary, Service};
use repose_runtime::{Answer, Caller, Session};

use crate::client::{self, ConnectArgs};
use crate::failure::Failure;
use crate::moving::{self, Interrupts};

/// The running system.
pub struct Terminal<'a> {
    session: &'a Session,
    planner: Caller,
    motion: Caller,
    camera: &'a str,
    robot: &'a str,
    deadline: Duration,
    interrupts: Interrupts,
}

impl<'a> Terminal<'a> {
    /// Finds its services, and listens for Ctrl-C from now on.
    pub async fn of(session: &'a Session, connect: &'a ConnectArgs, robot: &'a str) -> Result<Self, Failure> {
        Ok(Self {
            session,
            planner: session.caller(Service::Planner).await?,
            motion: session.caller(Service::Motion).await?,
            camera: &connect.camera,
            robot,
            deadline: Duration::from_millis(connect.deadline_ms),
            interrupts: Interrupts::listen()?,
        })
    }
}

impl Site for Terminal<'_> {
    fn robot(&self) -> &str {
        self.robot
    }

    fn camera(&self) -> &str {
        self.camera
    }

    fn planner(&self) -> &Caller {
        &self.planner
    }

    fn motion(&self) -> &Caller {
        &self.motion
    }

    fn deadline(&self) -> Duration {
        self.deadline
    }

    async fn newest(&self) -> Result<SceneSummary, CallError> {
        client::newest_scene(self.session, self.camera, self.deadline, client::PATIENCE).await.map_err(Failure::into_error)
    }

    async fn scene(&self, scene_id: &str) -> Result<Scene, CallError> {
        client::whole_scene(self.session, scene_id, self.deadline).await.map_err(Failure::into_error)
    }

    async fn state(&self) -> Result<RobotState, CallError> {
        client::robot_state(self.session, self.robot, self.deadline).await.map_err(Failure::into_error)
    }

    async fn moving(&mut self, method: &str, payload: Payload, _: Option<&MotionPlan>) -> Result<Answer, CallError> {
        moving::call(self.session, &self.motion, (self.robot, method), payload, &mut self.interrupts, None).await
    }
}
