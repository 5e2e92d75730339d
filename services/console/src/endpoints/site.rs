//! A cell with one of its cameras and robots, as the executive has it from a page: every viewer sees how far it is.

use std::sync::Arc;
use std::time::Duration;

use repose_executive::{MoveStage, Site};
use repose_proto::motion::MotionPlan;
use repose_proto::robot::RobotState;
use repose_proto::{CallError, Payload, Scene, SceneSummary, Service};
use repose_runtime::{Answer, Caller, robot_state};

use super::calls::{execute, moving, shown};
use crate::cell::{Camera, WatchedCell};
use crate::stage::GoalStage;

/// The cell, camera and robot.
pub struct PageSite {
    cell: Arc<WatchedCell>,
    camera: Arc<Camera>,
    robot: String,
    deadline: Duration,
    shown_in: ShownIn,
}

/// What shows how far a move is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ShownIn {
    /// Nothing but the motion itself.
    Nothing,
    /// The sequence that is carried out.
    Sequence,
    /// The arrangement that is brought about.
    Arrangement,
}

impl PageSite {
    /// These; `deadline` is of a call that does not move the robot.
    pub fn of(cell: Arc<WatchedCell>, camera: Arc<Camera>, robot: String, deadline: Duration) -> Self {
        Self { cell, camera, robot, deadline, shown_in: ShownIn::Nothing }
    }

    /// The same for a sequence, whose steps show how far it is.
    pub fn for_sequence(self) -> Self {
        Self { shown_in: ShownIn::Sequence, ..self }
    }

    /// The same for goals that are brought about together.
    pub fn for_arrangement(self) -> Self {
        Self { shown_in: ShownIn::Arrangement, ..self }
    }

    /// The cell.
    pub fn cell(&self) -> &Arc<WatchedCell> {
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
            Some(plan) => execute(&self.cell, uuid::Uuid::new_v4().to_string(), plan).await,
            None => moving(&self.cell, method, payload, None).await,
        }
    }

    fn begins(&self, stage: MoveStage) {
        let stage = match stage {
            MoveStage::Looking => GoalStage::Looking,
            MoveStage::Placing => GoalStage::Placing,
            MoveStage::Planning => GoalStage::Planning,
            MoveStage::Moving => GoalStage::Moving,
        };
        match self.shown_in {
            ShownIn::Nothing => {}
            ShownIn::Sequence => self.cell.update_step(|step| step.stage = stage),
            ShownIn::Arrangement => self.cell.update_arrangement(|shown| shown.stage = stage),
        }
    }

    fn planned(&self, plan: &MotionPlan) {
        if let Ok(state) = self.cell.robot(&self.robot) {
            self.cell.show_plan(shown(plan, &state));
        }
    }

    fn goes_on(&self) -> bool {
        let mut goes_on = false;
        self.cell.update(|activity| {
            goes_on = match self.shown_in {
                ShownIn::Nothing => false,
                ShownIn::Sequence => activity.sequence.as_ref().is_some_and(|s| !s.ending),
                ShownIn::Arrangement => activity.arrangement.as_ref().is_some_and(|a| !a.ending),
            };
        });
        goes_on
    }
}
