//! A cell with a robot, as the executive sees it: its views, its planner, its robot, and the robot's way home.

use std::time::Duration;

use repose_proto::motion::{ExecutionOutcome, MotionPlan, MotionPlanRequest, RecoverReply, RecoverRequest, RecoveryMove};
use repose_proto::place::{Placement, ReachingRobot};
use repose_proto::robot::{RobotMode, RobotState};
use repose_proto::{CallError, ErrorCode, Message as _, Payload, PlaceRequest, PlaceResult, Scene, SceneRef, SceneSummary};
use repose_runtime::{Answer, CallOptions, Caller, lacks_scene, reaching_robot};

use crate::tried::Tried;

/// Placements that motion may choose from.
pub const COUNT: u32 = 5;
/// Between two looks for a fresh view.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// Within this time a camera that works shows something new, scene and all.
pub const SHOWS_WITHIN: Duration = Duration::from_secs(2);

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

/// A camera's `newest` scene, in short, as soon as that was seen after an instant of the camera's clock; where none such comes within `patience`, the newest
/// all the same.
///
/// # Errors
/// Those of `newest`.
pub async fn newest_after<F>(newest: impl Fn() -> F, instant_ns: u64, patience: Duration) -> Result<SceneSummary, CallError>
where
    F: Future<Output = Result<SceneSummary, CallError>>,
{
    let give_up = tokio::time::Instant::now() + patience;
    loop {
        let summary = newest().await?;
        if summary.stamp_ns > instant_ns || tokio::time::Instant::now() >= give_up {
            return Ok(summary);
        }
        tokio::time::sleep(LOOK_EVERY).await;
    }
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
    /// Whether more is to be done: asked before every goal of a sequence, whose attempts belong together, and before every move of an arrangement.
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

    /// The first scene, with its id, that was seen after an instant of its camera's clock.
    ///
    /// # Errors
    /// `deadline_exceeded` where the camera shows nothing new; those of the calls.
    fn view_after(&self, instant_ns: u64) -> impl Future<Output = Result<IdentifiedScene, CallError>> + Send {
        async move {
            self.begins(MoveStage::Looking);
            let summary = newest_after(|| self.newest(), instant_ns, self.deadline()).await?;
            if summary.stamp_ns <= instant_ns {
                let message = format!("camera {} has shown nothing new in {} ms", self.camera(), self.deadline().as_millis());
                return Err(CallError::new(ErrorCode::DeadlineExceeded, message));
            }
            let scene = self.scene(&summary.scene_id).await?;
            Ok((summary.scene_id, scene))
        }
    }

    /// The first scene that was seen from now on, with its id. What is now is told by the robot, whose clock is its cameras': this process's own, on
    /// another host, may be behind theirs, and a scene from before the move would pass for one from after it.
    ///
    /// # Errors
    /// As [`Site::view_after`]; `unavailable` where the robot tells no state.
    fn fresh_view(&self) -> impl Future<Output = Result<IdentifiedScene, CallError>> + Send {
        async { self.view_after(self.state().await?.stamp_ns).await }
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
            let recovery = AskedRecovery::new(self.robot(), motion, view)?;
            let mut answer = self.moving("recover", recovery.by_id()?, None).await;
            if let Some(whole) = recovery.again(&answer) {
                answer = self.moving("recover", whole?, None).await;
            }
            answer?.payload.decode_json()
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
                    RecoveryMove::Retreat | RecoveryMove::Home => Some(self.fresh_view().await?),
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
            self.fresh_view().await
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
            if let Some(ignored) = plan.ignored_in_words() {
                tracing::warn!(query = request.query, "{ignored}");
            }
            self.planned(&plan);
            self.begins(MoveStage::Moving);
            let answer = self.moving("execute", Payload::json(&plan)?, Some(&plan)).await?;
            Ok(Tried::executed(&plan, answer.payload.decode_json()?))
        }
    }
}

/// What motion is asked for one recovery move, its way checked against a view where there is one.
pub struct AskedRecovery<'a> {
    request: RecoverRequest,
    view: Option<&'a IdentifiedScene>,
}

impl<'a> AskedRecovery<'a> {
    /// One move of a robot.
    ///
    /// # Errors
    /// `invalid_argument` on the robot's name.
    pub fn new(robot: &str, motion: RecoveryMove, view: Option<&'a IdentifiedScene>) -> Result<Self, CallError> {
        let scene = view.map(|(scene_id, _)| SceneRef { scene_id: scene_id.clone() });
        let request = RecoverRequest { robot: robot.to_owned(), motion, scene };
        request.validate()?;
        Ok(Self { request, view })
    }

    /// What motion is asked first: with the view by its id, for perception is nearer to motion than most who ask.
    ///
    /// # Errors
    /// Where it cannot be encoded.
    pub fn by_id(&self) -> Result<Payload, CallError> {
        Payload::json(&self.request)
    }

    /// What it is asked after that answer: with the view itself, where it has not moved because it does not hold the view, or holds it as it was seen
    /// too long ago. None where the answer stands.
    pub fn again(&self, answer: &Result<Answer, CallError>) -> Option<Result<Payload, CallError>> {
        let (_, scene) = self.view.filter(|_| answer.as_ref().is_err_and(is_blind))?;
        Some(Payload::with_scene(&self.request, Some(scene)))
    }
}

fn is_blind(error: &CallError) -> bool {
    lacks_scene(error) || (error.code == ErrorCode::FailedPrecondition && error.field.as_deref() == Some("scene"))
}

/// Whether motion could serve none of the placements or found no grasp: nothing has moved, and other draws may do.
pub fn is_unserved(error: &CallError) -> bool {
    error.code == ErrorCode::FailedPrecondition && matches!(error.field.as_deref(), Some("placements" | "query" | "scene.objects"))
}

/// Whether motion found no grasp on the object, whatever stands around it.
pub fn is_without_grasp(error: &CallError) -> bool {
    error.code == ErrorCode::FailedPrecondition && error.field.as_deref() == Some("query")
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};

    use repose_made_scenes::SceneBuilder;
    use repose_proto::Service;
    use repose_runtime::{Session, now_ns};
    use serde_json::json;

    use super::*;

    /// A cell whose clock, the robot's and the camera's, is so far ahead of this host's; every look shows the next frame.
    struct Elsewhere {
        planner: Caller,
        motion: Caller,
        robot_ns: u64,
        looks: AtomicU64,
        /// Whether motion has what is seen.
        has_scenes: bool,
        /// What motion was sent: whether it was a scene.
        sent: Vec<bool>,
    }

    impl Elsewhere {
        /// Seen in steps of 100 ms, the first of them long before now.
        fn stamp_ns(&self, look: u64) -> u64 {
            self.robot_ns - 250_000_000 + look * 100_000_000
        }
    }

    impl Site for Elsewhere {
        fn robot(&self) -> &str {
            "panda"
        }

        fn camera(&self) -> &str {
            "front"
        }

        fn planner(&self) -> &Caller {
            &self.planner
        }

        fn motion(&self) -> &Caller {
            &self.motion
        }

        fn deadline(&self) -> Duration {
            Duration::from_secs(10)
        }

        async fn newest(&self) -> Result<SceneSummary, CallError> {
            let look = self.looks.fetch_add(1, Ordering::Relaxed);
            let scene = Scene { stamp_ns: self.stamp_ns(look), ..SceneBuilder::table().object(1, [0.5, 0.0], [0.05; 3]).scene() };
            Ok(scene.summary(look.to_string()))
        }

        async fn scene(&self, scene_id: &str) -> Result<Scene, CallError> {
            let look = scene_id.parse().map_err(|_| CallError::internal("a look's number"))?;
            Ok(Scene { stamp_ns: self.stamp_ns(look), ..SceneBuilder::table().scene() })
        }

        async fn state(&self) -> Result<RobotState, CallError> {
            let still = [0.0; 7];
            let state = json!({"v": 1, "seq": 1, "stamp_ns": self.robot_ns, "robot_ms": 0.0, "q_rad": still, "dq_rad_s": still,
                "gripper_width_m": 0.04, "gripper_settled": true, "gripper_holding": false, "mode": "idle"});
            serde_json::from_value(state).map_err(|e| CallError::internal(e.to_string()))
        }

        async fn moving(&mut self, method: &str, payload: Payload, _: Option<&MotionPlan>) -> Result<Answer, CallError> {
            self.sent.push(payload.is_bulk());
            match self.has_scenes || payload.is_bulk() {
                true => Err(CallError::precondition(format!("{method}: nothing moves here"))),
                false => Err(CallError::not_found("scene_id", "it is not here")),
            }
        }
    }

    async fn elsewhere(robot_ns: u64, has_scenes: bool) -> Elsewhere {
        let session = Session::embedded().await.expect("a session");
        let caller = async |service| session.caller(service).await.expect("a caller");
        let (planner, motion) = (caller(Service::Planner).await, caller(Service::Motion).await);
        Elsewhere { planner, motion, robot_ns, looks: AtomicU64::new(0), has_scenes, sent: Vec::new() }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_way_back_names_its_view_and_sends_it_where_motion_does_not_have_it() {
        let scene = SceneBuilder::table().scene();
        let view = (scene.id(), scene);
        for (has_scenes, sent) in [(true, vec![false]), (false, vec![false, true])] {
            let mut site = elsewhere(0, has_scenes).await;
            let refused = site.bring_back(RecoveryMove::Home, Some(&view)).await.expect_err("nothing moves");
            assert!(refused.message.contains("nothing moves here"), "{refused}");
            assert_eq!(site.sent, sent);
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_fresh_view_is_one_from_after_now_by_the_cells_clock_whatever_this_hosts_says() {
        for ahead_s in [-3600_i64, -2, 0, 2, 3600] {
            let robot_ns = now_ns().saturating_add_signed(ahead_s * 1_000_000_000);
            let site = elsewhere(robot_ns, true).await;
            let (_, scene) = site.fresh_view().await.expect("a view");
            assert_eq!(scene.stamp_ns, robot_ns + 50_000_000, "{ahead_s} s");
        }
    }
}
