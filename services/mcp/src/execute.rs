//! `execute`: a plan of this server's, of the same session, on a scene that still looks as it did, carried out once.
//!
//! The placement is the one that the agent was shown. The arm's way is planned anew, from where it stands and on a fresh view: the scene may
//! differ from the plan's by what a camera's noise makes of it ([`crate::McpSettings::still_m`]) and by nothing else. A server that is to end brings
//! what it has begun to its end ([`Moves`](repose_runtime::Moves)).

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use repose_pictures::jpeg_of;
use repose_pictures::scene::with_numbered_outlines;
use repose_proto::motion::{ExecuteReply, ExecutionOutcome, MotionPlan, MotionPlanRequest};
use repose_proto::robot::{RobotMode, RobotState};
use repose_proto::{CallError, ErrorCode, Payload};
use repose_runtime::{CallOptions, CancellationToken};
use repose_sentences::fate;
use repose_tracking::{Fate, Followed, changes, holds};
use schemars::JsonSchema;
use serde::Serialize;
use tokio::time::Instant;

use crate::answer::ToolResult;
use crate::arguments::ExecuteArguments;
use crate::asker::Asker;
use crate::desk::{Desk, computed};
use crate::look::QUALITY;
use crate::plan::moved_by;
use crate::plans::Plan;
use crate::seen::ShownScene;

/// How long an execution may take.
const LONGEST: Duration = Duration::from_secs(600);
/// Fresh views in which the scene may show that it is the same: one in which a small object is not found is no change.
const VIEWS: usize = 3;

/// What `execute` answers beside the picture.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Executed {
    /// The plan.
    pub plan: String,
    /// `done`, `stopped` or `grasp_lost`.
    pub outcome: ExecutionOutcome,
    /// Why, where it is not done.
    pub reason: Option<String>,
    /// What was asked to hold, and whether each holds in the view afterwards; empty where that cannot be seen.
    pub holds: Vec<TermHeld>,
    /// The objects that do not stand where they were to be in the view afterwards, by their numbers in the plan's scene: moved, fallen, gone
    /// or hidden. Empty where everything does.
    pub fates: BTreeMap<u16, Fate>,
    /// The scene afterwards, for `plan`; none where nothing could be seen.
    pub scene: Option<String>,
}

/// A term of the goal, afterwards.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct TermHeld {
    /// In the numbers of the plan's scene: `left_of:2`.
    pub term: String,
    /// Whether it holds by rule on what is seen.
    pub holds: bool,
}

impl Desk {
    /// Carries a plan out.
    ///
    /// # Errors
    /// `failed_precondition` when this server may not, another motion is under way, the robot is stopped, the scene has changed or the arm cannot
    /// serve the place any more; `not_found` on `plan`; `cancelled`; `unavailable` when this server is ending; what the cell says.
    pub async fn execute(&self, asked: &ExecuteArguments, asker: &Asker, cancel: CancellationToken) -> Result<ToolResult, CallError> {
        if !self.settings().allow_execute {
            let message = "this server may not carry plans out: a person starts it with --allow-execute where it may";
            return Err(CallError::precondition(message));
        }
        let plan = self.plans().get(&asked.plan, asker)?;
        let _under_way = self.moves.begin_alone(format!("plan {} of {}", plan.id, asker.client))?;
        // Whoever gives it up before anything moves wants nothing to move: a call that is sent may begin, even where its cancel follows at once.
        let (followed, motion) = tokio::select! {
            biased;
            () = cancel.cancelled() => return Err(CallError::new(ErrorCode::Cancelled, "given up before anything has moved")),
            refusal = self.moves.refused() => return Err(refusal),
            prepared = self.prepared(&plan, self.deadline()) => prepared?,
        };
        // From here on it may have moved something, whatever the answer is.
        self.plans().remove(&plan.id);
        let reply = self.moved(&motion, cancel).await?;
        // It has moved: an agent that was told of an error would think that it has not.
        let seen = tokio::select! {
            seen = self.fresh(&plan.session, self.deadline()) => seen,
            why = self.moves.cut_off() => Err(why),
        };
        match seen {
            Ok(seen) => computed(move || afterwards(&plan, reply, followed, &seen)).await,
            Err(why) => unseen(&plan, reply, &why),
        }
    }

    /// Has a motion carried out, until it is given up or this server can wait no longer: then the arm comes to rest.
    async fn moved(&self, motion: &MotionPlan, cancel: CancellationToken) -> Result<ExecuteReply, CallError> {
        let options = CallOptions { cancel, ..CallOptions::at_most_once(LONGEST) };
        let reply = self.moves.call(&self.session, &self.motion, "execute", Payload::json(motion)?, options).await?;
        reply.payload.decode_json()
    }

    /// A motion that carries a plan out, from where the arm stands and on a fresh view, and which object is which in that view.
    async fn prepared(&self, plan: &Arc<Plan>, deadline: Instant) -> Result<(Followed, MotionPlan), CallError> {
        let state = self.robot_state(deadline).await?;
        check_free(&self.settings().robot, &state)?;
        let (seen, followed) = self.unchanged(plan, deadline).await?;
        let request = self.motion_request(plan, &followed, &seen, &state)?;
        let motion = self.motion.plan_motion(&request, Some(&seen.scene), CallOptions::default().until(deadline)).await?;
        Ok((followed, motion))
    }

    /// A fresh view in which everything is where it was planned with, and which object is which in it.
    async fn unchanged(&self, plan: &Arc<Plan>, deadline: Instant) -> Result<(Arc<ShownScene>, Followed), CallError> {
        let mut differences = Vec::new();
        for _ in 0..VIEWS {
            let seen = self.fresh(&plan.session, deadline).await?;
            differences = changes(&plan.seen.scene.meta.objects, &seen.scene.meta.objects, self.settings().still_m);
            if differences.is_empty() {
                let plan = plan.clone();
                let found_again = move || {
                    let mut followed = Followed::of(&plan.seen.scene);
                    followed.look_again(&seen.scene);
                    Ok((seen, followed))
                };
                return computed(found_again).await;
            }
        }
        let told: Vec<String> = differences.iter().map(ToString::to_string).collect();
        Err(CallError::precondition(format!("the scene has changed since the plan was made: {}; look and plan again", told.join("; ")))
            .at("plan"))
    }

    fn motion_request(
        &self,
        plan: &Plan,
        followed: &Followed,
        seen: &ShownScene,
        state: &RobotState,
    ) -> Result<MotionPlanRequest, CallError> {
        let (query, _) = followed.translated("plan", plan.query, &plan.goal)?;
        let placements = vec![plan.placement.placed_from_observed];
        let robot = self.settings().robot.clone();
        Ok(MotionPlanRequest { seed: plan.seed, ..MotionPlanRequest::new(seen.scene_id.clone(), robot, query, placements, state.q_rad) })
    }
}

/// What came of a plan, where nothing can be seen afterwards.
fn unseen(plan: &Plan, reply: ExecuteReply, why: &CallError) -> Result<ToolResult, CallError> {
    let ExecuteReply { outcome, reason, .. } = reply;
    let executed = Executed { plan: plan.id.clone(), outcome, reason, holds: Vec::new(), fates: BTreeMap::new(), scene: None };
    let said = format!("{}\nwhat it left could not be seen: {why}", sentences(&executed, plan.query));
    ToolResult::new(said, &executed, None)
}

/// What has become of the wish, and of everything else.
fn afterwards(plan: &Plan, reply: ExecuteReply, mut followed: Followed, seen: &ShownScene) -> Result<ToolResult, CallError> {
    let moved = match reply.outcome {
        ExecutionOutcome::Done => Some(moved_by(&plan.placement)?),
        ExecutionOutcome::Stopped | ExecutionOutcome::GraspLost => None,
    };
    followed.look_after_moving(plan.query, moved.as_ref(), &seen.scene);
    let held = match followed.translated("plan", plan.query, &plan.goal) {
        Ok((query, goal)) => holds(&seen.scene, plan.view_yaw_rad, query, &goal),
        Err(_) => Vec::new(),
    };
    let executed = Executed {
        plan: plan.id.clone(),
        outcome: reply.outcome,
        reason: reply.reason,
        holds: plan.goal.iter().zip(&held).map(|(term, holds)| TermHeld { term: term.to_string(), holds: *holds }).collect(),
        fates: followed.disturbed(),
        scene: Some(seen.handle().to_owned()),
    };
    let picture = jpeg_of(&with_numbered_outlines(&seen.scene)?, QUALITY)?;
    ToolResult::new(sentences(&executed, plan.query), &executed, Some(picture))
}

/// Refuses a robot that a person, or somebody else's task, has.
fn check_free(robot: &str, state: &RobotState) -> Result<(), CallError> {
    let refused = |message: String| Err(CallError::precondition(message).at("robot"));
    match (&state.stop, state.mode, state.open_task()) {
        (Some(stop), _, _) => refused(format!("robot {robot} is stopped: {}; a person clears that", stop.reason)),
        (None, RobotMode::Idle, None) => Ok(()),
        (None, _, _) => refused(format!("robot {robot} is doing something else")),
    }
}

fn sentences(executed: &Executed, carried: u16) -> String {
    let mut lines = vec![match (executed.outcome, &executed.reason) {
        (ExecutionOutcome::Done, _) => "done".to_owned(),
        (ExecutionOutcome::Stopped, why) => format!("stopped: {}", why.as_deref().unwrap_or("nobody says why")),
        (ExecutionOutcome::GraspLost, why) => format!("the grasp was lost: {}", why.as_deref().unwrap_or("nobody says why")),
    }];
    match executed.holds[..] {
        [] => lines.push("whether the goal holds cannot be seen".to_owned()),
        _ => {
            lines.extend(executed.holds.iter().map(|term| format!("{} {}", term.term, if term.holds { "holds" } else { "does not hold" })));
        }
    }
    lines.extend(fate::describe(Some(carried), &executed.fates));
    lines.extend(executed.scene.as_ref().map(|scene| format!("the scene afterwards is {scene}; numbers may be others in it")));
    lines.join("\n")
}
