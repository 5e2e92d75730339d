//! A cell with a robot, as the executive sees it: its views, its planner, its robot, and the robot's way home.

use std::time::Duration;

use repose_proto::motion::{ExecutionOutcome, MotionPlan, MotionPlanRequest, RecoverReply, RecoverRequest, RecoveryMove};
use repose_proto::place::{Placement, ReachingRobot};
use repose_proto::robot::{RobotMode, RobotState};
use repose_proto::{CallError, ErrorCode, Message as _, Payload, PlaceRequest, PlaceResult, Scene, SceneRef, SceneSummary};
use repose_runtime::{Answer, CallOptions, Caller, now_ns, reaching_robot};

use crate::tried::Tried;

/// Placements that motion may choose from.
pub const COUNT: u32 = 5;
/// Between two looks for a fresh view.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// A scene and its id.
pub type IdentifiedScene = (String, Scene);

/// The stage of the current move.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MoveStage {
    /// A fresh view is waited for.
    Looking,
    /// The planner searches.
    Placing,
    /// Motion plans.
    Planning,
    /// The robot moves.
    Moving,
}

/// A cell and one of its robots, at the hands of whoever has goals brought about.
pub trait Site: Send + Sync {
    /// The robot.
    fn robot(&self) -> &str;
    /// The camera.
    fn camera(&self) -> &str;
    /// Any of the planners that serve the cell.
    fn planner(&self) -> &Caller;
    /// Any of its motion workers.
    fn motion(&self) -> &Caller;
    /// How long a call may take that does not move the robot.
    fn deadline(&self) -> Duration;
    /// The camera's newest scene.
    fn newest(&self) -> impl Future<Output = Result<SceneSummary, CallError>> + Send;
    /// A scene, whole.
    fn scene(&self, scene_id: &str) -> impl Future<Output = Result<Scene, CallError>> + Send;
    /// What the robot says of itself.
    fn state(&self) -> impl Future<Output = Result<RobotState, CallError>> + Send;
    /// Calls a method of motion that moves the robot; `plan` is what it executes, where it does.
    fn moving(
        &mut self,
        method: &str,
        payload: Payload,
        plan: Option<&MotionPlan>,
    ) -> impl Future<Output = Result<Answer, CallError>> + Send;
    /// A stage of the move begins.
    fn begins(&self, _stage: MoveStage) {}
    /// Motion has planned.
    fn planned(&self, _plan: &MotionPlan) {}
    /// Whether more is to be done: asked before every move.
    fn goes_on(&self) -> bool {
        true
    }

    /// The robot with the pose of its base, where it tells that and its reach is known.
    fn reaching(&self) -> impl Future<Output = Option<ReachingRobot>> + Send {
        async {
            // One that does not answer is named when it is to move.
            let state = self.state().await.ok()?;
            reaching_robot(self.robot(), &state)
        }
    }

    /// Whether the robot stands there free, without a stop.
    fn is_free(&self) -> impl Future<Output = bool> + Send {
        async {
            let is_free = |state: RobotState| state.mode == RobotMode::Idle && state.stop.is_none() && state.open_task().is_none();
            self.state().await.is_ok_and(is_free)
        }
    }

    /// The first scene, with its id, that was seen after an instant.
    ///
    /// # Errors
    /// `deadline_exceeded` where the camera shows nothing new; those of the calls.
    fn view_after(&self, instant_ns: u64) -> impl Future<Output = Result<IdentifiedScene, CallError>> + Send {
        async move {
            self.begins(MoveStage::Looking);
            let give_up = tokio::time::Instant::now() + self.deadline();
            loop {
                let summary = self.newest().await?;
                if summary.stamp_ns > instant_ns {
                    let scene = self.scene(&summary.scene_id).await?;
                    return Ok((summary.scene_id, scene));
                }
                if tokio::time::Instant::now() >= give_up {
                    let message = format!("camera {} has shown nothing new in {} ms", self.camera(), self.deadline().as_millis());
                    return Err(CallError::new(ErrorCode::DeadlineExceeded, message));
                }
                tokio::time::sleep(LOOK_EVERY).await;
            }
        }
    }

    /// The planner's answer on a view.
    ///
    /// # Errors
    /// Those of the call.
    fn placed(&self, request: &PlaceRequest, view: &IdentifiedScene) -> impl Future<Output = Result<PlaceResult, CallError>> + Send {
        async {
            self.begins(MoveStage::Placing);
            Ok(self.planner().place(request, Some(&view.1), CallOptions::within(self.deadline())).await?.0)
        }
    }

    /// Has motion bring the arm back by one move, its way checked against a view where there is one.
    ///
    /// # Errors
    /// `failed_precondition` where the arm cannot be brought back so; those of the call.
    fn bring_back(
        &mut self,
        motion: RecoveryMove,
        view: Option<&IdentifiedScene>,
    ) -> impl Future<Output = Result<RecoverReply, CallError>> + Send {
        async move {
            let payload = recovery(self.robot(), motion, view)?;
            self.moving("recover", payload, None).await?.payload.decode_json()
        }
    }

    /// Opens the hand, brings the arm home, and looks.
    ///
    /// # Errors
    /// `failed_precondition` where the arm was not brought home; those of the calls.
    fn back_and_looking(&mut self) -> impl Future<Output = Result<IdentifiedScene, CallError>> + Send {
        async {
            for wanted in [RecoveryMove::Open, RecoveryMove::Retreat, RecoveryMove::Home] {
                let seen = match wanted {
                    RecoveryMove::Open => None,
                    RecoveryMove::Retreat | RecoveryMove::Home => Some(self.view_after(now_ns()).await?),
                };
                self.begins(MoveStage::Moving);
                match self.bring_back(wanted, seen.as_ref()).await {
                    Ok(reply) if reply.outcome == ExecutionOutcome::Done => {}
                    // The way home may be free all the same.
                    Err(error) if wanted == RecoveryMove::Retreat && error.code == ErrorCode::FailedPrecondition => {}
                    Ok(reply) => {
                        let why = reply.reason.unwrap_or_else(|| "the arm was not brought back".to_owned());
                        return Err(CallError::precondition(why));
                    }
                    Err(error) => return Err(error),
                }
            }
            self.view_after(now_ns()).await
        }
    }

    /// What motion plans for the placements of a request's query, the best first, from where the robot stands.
    ///
    /// # Errors
    /// `failed_precondition` where it can serve none of them ([`is_unserved`]); those of the calls.
    fn motion_for(
        &self,
        request: &PlaceRequest,
        placements: &[Placement],
        view: &IdentifiedScene,
    ) -> impl Future<Output = Result<MotionPlan, CallError>> + Send {
        async {
            self.begins(MoveStage::Planning);
            let state = self.state().await?;
            let placed = placements.iter().map(|p| p.placed_from_observed).collect();
            let wanted = MotionPlanRequest {
                seed: request.seed,
                ..MotionPlanRequest::new(view.0.clone(), self.robot().to_owned(), request.query, placed, state.q_rad)
            };
            self.motion().plan_motion(&wanted, Some(&view.1), CallOptions::within(self.deadline())).await
        }
    }

    /// Has motion plan for the placements of a request's query, the best first, and carry the plan out.
    ///
    /// # Errors
    /// As [`Site::motion_for`]; those of the execution.
    fn carry_out(
        &mut self,
        request: &PlaceRequest,
        placements: &[Placement],
        view: &IdentifiedScene,
    ) -> impl Future<Output = Result<Tried, CallError>> + Send {
        async move {
            let plan = self.motion_for(request, placements, view).await?;
            tracing::info!(query = request.query, placement = plan.placement, seconds = plan.duration_ms / 1e3, "executing");
            self.planned(&plan);
            self.begins(MoveStage::Moving);
            let answer = self.moving("execute", Payload::json(&plan)?, Some(&plan)).await?;
            Ok(Tried::executed(&plan, answer.payload.decode_json()?))
        }
    }
}

/// What motion is asked for one recovery move, its way checked against a view where there is one.
///
/// # Errors
/// `invalid_argument` on the robot's name; where the scene cannot be encoded.
pub fn recovery(robot: &str, motion: RecoveryMove, view: Option<&IdentifiedScene>) -> Result<Payload, CallError> {
    let scene = view.map(|(scene_id, _)| SceneRef { scene_id: scene_id.clone() });
    let request = RecoverRequest { robot: robot.to_owned(), motion, scene };
    request.validate()?;
    Payload::with_scene(&request, view.map(|(_, scene)| scene))
}

/// Whether motion could serve none of the placements or found no grasp: nothing has moved, and other draws may do.
pub fn is_unserved(error: &CallError) -> bool {
    error.code == ErrorCode::FailedPrecondition && matches!(error.field.as_deref(), Some("placements" | "query" | "scene.objects"))
}

/// Whether motion found no grasp on the object, whatever stands around it.
pub fn is_without_grasp(error: &CallError) -> bool {
    error.code == ErrorCode::FailedPrecondition && error.field.as_deref() == Some("query")
}
