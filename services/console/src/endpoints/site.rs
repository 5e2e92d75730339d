//! A cell with one of its cameras and robots, as the executive has it from a page: every viewer sees how far it is.

use std::sync::Arc;
use std::time::Duration;

use repose_executive::Site;
use repose_proto::motion::MotionPlan;
use repose_proto::robot::RobotState;
use repose_proto::{CallError, Payload, Scene, SceneSummary, Service};
use repose_runtime::{Answer, Caller, robot_state};

use super::calls::{execute, moving, shown};
use crate::cell::{Camera, Cell};
use crate::messages::Stage;

/// The cell, camera and robot.
pub struct PageSite {
    cell: Arc<Cell>,
    camera: Arc<Camera>,
    robot: String,
    deadline: Duration,
    /// Whether it is a sequence that is carried out.
    in_sequence: bool,
}

impl PageSite {
    /// These; `deadline` is of a call that does not move the robot.
    pub fn of(cell: Arc<Cell>, camera: Arc<Camera>, robot: String, deadline: Duration) -> Self {
        Self { cell, camera, robot, deadline, in_sequence: false }
    }

    /// The same for a sequence, whose steps show how far it is.
    pub fn for_sequence(self) -> Self {
        Self { in_sequence: true, ..self }
    }

    /// The cell.
    pub fn cell(&self) -> &Arc<Cell> {
        &self.cell
    }
}

impl Site for PageSite {
    fn robot(&self) -> &str {
        &self.robot
    }

    fn camera(&self) -> &str {
        self.camera.name()
    }

    fn planner(&self) -> &Caller {
        self.cell.caller(Service::Planner)
    }

    fn motion(&self) -> &Caller {
        self.cell.caller(Service::Motion)
    }

    fn deadline(&self) -> Duration {
        self.deadline
    }

    async fn newest(&self) -> Result<SceneSummary, CallError> {
        self.cell.newest(self.camera.name()).await
    }

    async fn scene(&self, scene_id: &str) -> Result<Scene, CallError> {
        self.cell.scene(scene_id).await
    }

    async fn state(&self) -> Result<RobotState, CallError> {
        robot_state(self.cell.session(), &self.robot, self.deadline).await
    }

    async fn moving(&mut self, method: &str, payload: Payload, plan: Option<&MotionPlan>) -> Result<Answer, CallError> {
        match plan {
            Some(plan) => execute(&self.cell, plan).await,
            None => moving(&self.cell, method, payload, None).await,
        }
    }

    fn begins(&self, stage: repose_executive::Stage) {
        use repose_executive::Stage as Begun;
        let stage = match stage {
            Begun::Looking => Stage::Looking,
            Begun::Placing => Stage::Placing,
            Begun::Planning => Stage::Planning,
            Begun::Moving => Stage::Moving,
        };
        if self.in_sequence {
            self.cell.update_step(|step| step.stage = stage);
        }
    }

    fn planned(&self, plan: &MotionPlan) {
        if let Ok(state) = self.cell.robot(&self.robot) {
            self.cell.show_plan(shown(plan, &state));
        }
    }

    fn goes_on(&self) -> bool {
        let mut ended = true;
        self.cell.update(|activity| ended = activity.sequence.as_ref().is_none_or(|s| s.ended));
        !ended
    }
}
