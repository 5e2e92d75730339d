//! A cell with one of its cameras and robots, as the executive has it from a page: every viewer sees how far it is.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use repose_executive::{MoveStage, Site};
use repose_proto::motion::MotionPlan;
use repose_proto::robot::RobotState;
use repose_proto::{CallError, Payload, Scene, SceneSummary, Service};
use repose_runtime::{Answer, Caller, robot_state};

use super::calls::{execute, moving, shown};
use crate::arm::PlanShown;
use crate::cell::{Camera, WatchedCell};
use crate::stage::GoalStage;

/// The cell, camera and robot.
pub struct PageSite {
    cell: Arc<WatchedCell>,
    camera: Arc<Camera>,
    robot: String,
    deadline: Duration,
    shown_in: ShownIn,
    on_display: OnDisplay,
}

/// The motion that is displayed as the one to come. It goes with the site at the latest: one that was not carried out, because of a stop for instance, is
/// carried out by nobody.
struct OnDisplay {
    cell: Arc<WatchedCell>,
    plan: Mutex<Option<String>>,
}

impl OnDisplay {
    fn show(&self, shown: Arc<PlanShown>) {
        *self.plan.lock().unwrap_or_else(PoisonError::into_inner) = Some(shown.plan.clone());
        self.cell.show_plan(shown);
    }
}

impl Drop for OnDisplay {
    fn drop(&mut self) {
        if let Some(plan) = self.plan.get_mut().unwrap_or_else(PoisonError::into_inner).take() {
            self.cell.hide_plan(|shown| shown.plan == plan);
        }
    }
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
        let on_display = OnDisplay { cell: cell.clone(), plan: Mutex::default() };
        Self { cell, camera, robot, deadline, shown_in: ShownIn::Nothing, on_display }
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
        // What this belongs to is waited for by a console that is to end, and begins no other move.
        self.cell.moves().check()?;
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
            self.on_display.show(shown(plan, &state));
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
        goes_on && !self.cell.moves().are_ending()
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;
    use repose_runtime::{Call, Handler, Moves, Session};

    use super::*;
    use crate::viewers::{Outbox, Outgoing, ViewerMessage};

    const PLAN: &str = include_str!("../../../../proto/tests/golden/MotionPlan.v1.json");

    /// Whether a viewer who comes now is shown a motion to come.
    async fn is_shown(cell: &WatchedCell) -> bool {
        let outbox = Arc::new(Outbox::default());
        cell.audience().join(1, outbox.clone());
        cell.audience().leave(1);
        loop {
            match outbox.next().await.expect("a plan is told, or that there is none") {
                Outgoing::Whole(ViewerMessage::Text(text)) if text.contains(r#""kind":"plan""#) => {
                    return !text.contains(r#""shown":null"#);
                }
                _ => {}
            }
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_motion_that_was_not_carried_out_is_shown_no_longer_than_what_it_was_planned_for() {
        let session = Session::embedded().await.expect("a session");
        let cell = WatchedCell::follow(&session, "cell", Arc::default(), Moves::of("the console")).await.expect("a cell");
        let plan: MotionPlan = serde_json::from_str(PLAN).expect("a plan");
        let shown = |id: &str| Arc::new(PlanShown::new(id.to_owned(), &plan, &Isometry3::identity()));
        let cell = Arc::new(cell);
        let on_display = || OnDisplay { cell: cell.clone(), plan: Mutex::default() };
        let (sequence, earlier) = (on_display(), on_display());
        earlier.show(shown("earlier"));
        sequence.show(shown("of the sequence"));
        drop(earlier);
        assert!(is_shown(&cell).await, "it is another's");
        drop(sequence);
        assert!(!is_shown(&cell).await);
    }

    /// Motion that carries nothing out.
    struct Refusing;

    #[async_trait::async_trait]
    impl Handler for Refusing {
        async fn call(&self, _: Call) -> Result<Payload, CallError> {
            Err(CallError::precondition("the arm is elsewhere"))
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_robot_that_moves_takes_its_own_motion_to_come_from_the_pages_and_no_other_robots() {
        let session = Session::embedded().await.expect("a session");
        let motion = session.start(Service::Motion, Arc::new(Refusing)).await.expect("a worker");
        let cell = WatchedCell::follow(&session, "cell", Arc::default(), Moves::of("the console")).await.expect("a cell");
        let plan: MotionPlan = serde_json::from_str(PLAN).expect("a plan");
        let of = |robot: &str| MotionPlan { robot: robot.to_owned(), ..plan.clone() };
        cell.show_plan(Arc::new(PlanShown::new("to come".to_owned(), &of("left"), &Isometry3::identity())));
        for (robot, is_left) in [("right", true), ("left", false)] {
            execute(&cell, robot.to_owned(), &of(robot)).await.expect_err("motion refuses");
            assert_eq!(is_shown(&cell).await, is_left, "robot {robot} was to move");
        }
        motion.drain().await;
    }
}
