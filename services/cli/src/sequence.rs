//! `repose place … --then …`: wishes achieved one after another, each planned on a fresh view of what the one before has left.
//!
//! Paper, appendix: mug and bowl to the right of a large box, one after the other, where the second may well end up on the first. Objects
//! are named as in the first view. A camera that finds its objects anew numbers them anew; they are told by where they are: the moved one
//! where it was put, every other where it was.
//!
//! What slips, falls or is not grasped is looked for on a fresh view and tried again, with another draw of grasps and placements, a bounded
//! number of times. After a stop, whoever latched it, and after a cancel nothing is tried again: a person decides.

use std::time::Duration;

use nalgebra::Isometry3;
use repose_geometry::transform::from_row_major;
use repose_proto::motion::{ExecuteReply, ExecutionOutcome, MotionPlan, MotionPlanRequest, RecoveryMove};
use repose_proto::place::ReachingRobot;
use repose_proto::robot::{RobotMode, RobotState};
use repose_proto::{CallError, ErrorCode, GoalTerm, Message, Payload, PlaceRequest, PlaceResult, Scene, SceneRef, Service};
use repose_runtime::{CallOptions, Caller, Session, now_ns, reaching_robot};
use repose_sentences::placement::describe;
use repose_tracking::{Known, holds};
use serde::Serialize;

use crate::bring_back::bring_back;
use crate::client::{self, ConnectArgs};
use crate::failure::{Failure, Outcome};
use crate::moving::{self, Interrupts, of_motion};
use crate::output::Output;
use crate::say::Said;
use crate::wish::{NextWish, WishArgs};

/// Placements that motion may choose from.
const COUNT: u32 = 5;

/// What is to be achieved, and where.
#[derive(Debug, Clone, Copy)]
pub struct Sequence<'a> {
    /// The first wish.
    pub wish: &'a WishArgs,
    /// Those after it.
    pub then: &'a [NextWish],
    /// The running system.
    pub connect: &'a ConnectArgs,
    /// The robot that carries them out.
    pub robot: &'a str,
    /// Attempts at each wish, at least 1.
    pub attempts: u32,
}

/// What came of one wish.
#[derive(Debug, Serialize)]
struct Step {
    query: u16,
    goal: Vec<GoalTerm>,
    /// How words were taken, where it was said in words.
    #[serde(skip_serializing_if = "Option::is_none")]
    said: Option<Said>,
    /// The answer; ids are those of its own view.
    result: PlaceResult,
    /// The placement that motion chose, from 0; none where there was none to choose from.
    #[serde(skip_serializing_if = "Option::is_none")]
    placement: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    execution: Option<ExecutionOutcome>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<String>,
    /// Each term by rule on the view after it.
    holds: Vec<bool>,
    /// What earlier attempts came to; the fields above are those of the last.
    attempts: Vec<Attempt>,
}

/// What an attempt that was followed by another came to.
#[derive(Debug, Serialize)]
struct Attempt {
    #[serde(skip_serializing_if = "Option::is_none")]
    placement: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    execution: Option<ExecutionOutcome>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<String>,
    holds: Vec<bool>,
}

impl Step {
    fn achieved(&self) -> bool {
        self.execution == Some(ExecutionOutcome::Done) && !self.holds.is_empty() && self.holds.iter().all(|holds| *holds)
    }

    /// Makes room for another attempt.
    fn begin_again(&mut self, result: PlaceResult) {
        let (placement, execution, reason) = (self.placement.take(), self.execution.take(), self.reason.take());
        self.attempts.push(Attempt { placement, execution, reason, holds: std::mem::take(&mut self.holds) });
        self.result = result;
    }
}

/// Runs the command: stops at the first wish that is not achieved.
pub async fn run(args: &Sequence<'_>, output: Output) -> Outcome {
    let session = client::connect(&args.connect.system).await?;
    let mut steps = Vec::new();
    let ended = achieve(args, &session, &mut steps).await;
    client::close(session).await;
    let error = match ended {
        // Nothing has moved.
        Err(failure) if steps.is_empty() => return Err(failure),
        ended => ended.err().and_then(|failure| failure.error().cloned()),
    };
    let achieved = steps.iter().take_while(|s| s.achieved()).count();
    let wanted = 1 + args.then.len();
    let mut document = serde_json::json!({"wanted": wanted, "achieved": achieved, "steps": steps});
    if let Some(error) = &error {
        document["error"] = serde_json::json!(error);
    }
    output.print(&document, || {
        let mut lines: Vec<String> = steps.iter().map(line).collect();
        lines.extend(error.as_ref().map(|error| format!("stopped: {error}")));
        lines.push(format!("{achieved} of {wanted} achieved"));
        lines.join("\n")
    })?;
    match steps.last() {
        _ if achieved == wanted => Ok(()),
        Some(last) if error.is_none() && last.result.placements.is_empty() => Err(Failure::NoPlacement),
        Some(_) => Err(Failure::NotAchieved),
        None => Err(Failure::other("nothing was tried")),
    }
}

fn line(step: &Step) -> String {
    let end = match step.execution {
        Some(ExecutionOutcome::Done) => "executed".to_owned(),
        Some(other) => format!("{other:?}"),
        None => "not executed".to_owned(),
    };
    let holds = step.goal.iter().zip(&step.holds).map(|(t, h)| format!("{t} {}", if *h { "holds" } else { "does not hold" }));
    let before = step.attempts.iter().enumerate().map(|(k, a)| {
        let why = a.reason.as_deref().unwrap_or("the goal did not hold afterwards");
        format!("attempt {}: {why}", k + 1)
    });
    let said: Vec<String> = before.chain(std::iter::once(end)).chain(step.reason.clone()).chain(holds).collect();
    let understood = step.said.as_ref().map(|s| format!("{s}\n")).unwrap_or_default();
    format!("{understood}{}\n  {}", describe(&step.result), said.join("; "))
}

/// Adds what came of each wish to `steps`, also of one that an error ended.
async fn achieve(args: &Sequence<'_>, session: &Session, steps: &mut Vec<Step>) -> Outcome {
    let deadline = Duration::from_millis(args.connect.deadline_ms);
    let mut system = System {
        session,
        planner: session.caller(Service::Planner).await?,
        motion: session.caller(Service::Motion).await?,
        camera: &args.connect.camera,
        robot: args.robot,
        deadline,
        attempts: args.attempts as usize,
        interrupts: Interrupts::listen()?,
    };
    let mut view = system.view_after(0).await?;
    let (first, mut said) = args.wish.on(&view.1)?;
    let reaching = system.reaching().await;
    let mut known = Known::of(&view.1.meta.objects);
    let wishes = || std::iter::once(&first).chain(args.then).enumerate();
    let request = |scene_id: &str, (query, goal): (u16, Vec<GoalTerm>)| {
        let asked = args.wish.request(scene_id.to_owned(), &NextWish { query, goal });
        let robot = asked.robot.clone().or_else(|| reaching.clone());
        let request = PlaceRequest { count: args.wish.count.max(COUNT), robot, ..asked };
        request.validate().map(|()| request)
    };
    // A wish that cannot be is refused before anything moves.
    for (k, wish) in wishes() {
        request(&view.0, known.translated(&format!("step[{k}]"), wish.query, &wish.goal)?)?;
    }
    for (k, wish) in wishes() {
        let asked = request(&view.0, known.translated(&format!("step[{k}]"), wish.query, &wish.goal)?)?;
        let (result, _) = system.planner.place(&asked, Some(&view.1), CallOptions::within(deadline)).await?;
        let mut step = Step {
            query: wish.query,
            goal: wish.goal.clone(),
            said: said.take(),
            result,
            placement: None,
            execution: None,
            reason: None,
            holds: Vec::new(),
            attempts: Vec::new(),
        };
        let carried_out = system.carry_out_or_try_again(asked, (k, wish), &mut step, &mut view, &mut known).await;
        let achieved = step.achieved();
        steps.push(step);
        carried_out?;
        if !achieved {
            break;
        }
    }
    Ok(())
}

/// The running system as a sequence sees it.
struct System<'a> {
    session: &'a Session,
    planner: Caller,
    motion: Caller,
    camera: &'a str,
    robot: &'a str,
    deadline: Duration,
    attempts: usize,
    interrupts: Interrupts,
}

impl System<'_> {
    /// The robot with the pose of its base, where it tells that and its reach is known.
    async fn reaching(&self) -> Option<ReachingRobot> {
        // One that does not answer is named when it is to move.
        let state = client::robot_state(self.session, self.robot, self.deadline).await.ok()?;
        reaching_robot(self.robot, &state)
    }

    /// The first scene, with its id, that was seen after an instant.
    async fn view_after(&self, instant_ns: u64) -> Result<(String, Scene), Failure> {
        let give_up = tokio::time::Instant::now() + self.deadline;
        loop {
            let summary = client::newest_scene(self.session, self.camera, self.deadline, client::PATIENCE).await?;
            if summary.stamp_ns > instant_ns {
                let scene = client::whole_scene(self.session, &summary.scene_id, self.deadline).await?;
                return Ok((summary.scene_id, scene));
            }
            if tokio::time::Instant::now() >= give_up {
                let message = format!("camera {} has shown nothing new in {} ms", self.camera, self.deadline.as_millis());
                return Err(Failure::Other(CallError::new(ErrorCode::DeadlineExceeded, message)));
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// Has a placement of `asked` carried out, and tries again while that makes sense; `step` says what the last attempt came to.
    async fn carry_out_or_try_again(
        &mut self,
        mut asked: PlaceRequest,
        (k, wish): (usize, &NextWish),
        step: &mut Step,
        view: &mut (String, Scene),
        known: &mut Known,
    ) -> Outcome {
        loop {
            let carried_out = match step.result.placements.is_empty() {
                true => Ok(()),
                false => self.carry_out(&asked, (k, wish), step, view, known).await,
            };
            if step.attempts.len() + 1 >= self.attempts || !self.may_try_again(step, &carried_out).await {
                return carried_out;
            }
            match self.asked_again(&asked, (k, wish), step, view, known).await {
                Ok((request, result)) => {
                    asked = request;
                    step.begin_again(result);
                }
                // What is in the way of another attempt is said beside what came of this one.
                Err(failure) => {
                    let why = failure.error().map_or_else(String::new, ToString::to_string);
                    let before = step.reason.take().map_or_else(String::new, |reason| format!("{reason}; "));
                    step.reason = Some(format!("{before}not tried again: {why}"));
                    return carried_out;
                }
            }
        }
    }

    /// The same request on a fresh view, with other draws, and its answer. Where the arm has moved it is brought home first.
    async fn asked_again(
        &mut self,
        asked: &PlaceRequest,
        (k, wish): (usize, &NextWish),
        step: &Step,
        view: &mut (String, Scene),
        known: &mut Known,
    ) -> Result<(PlaceRequest, PlaceResult), Failure> {
        if step.execution.is_some() {
            *view = self.back_and_looking().await?;
            known.look_for_lost(wish.query, &view.1.meta.objects);
        }
        let (query, goal) = known.translated(&format!("step[{k}]"), wish.query, &wish.goal)?;
        let scene = SceneRef { scene_id: view.0.clone() };
        let request = PlaceRequest { scene, query, goal, seed: asked.seed.wrapping_add(1), ..asked.clone() };
        let (result, _) = self.planner.place(&request, Some(&view.1), CallOptions::within(self.deadline)).await?;
        Ok((request, result))
    }

    /// Has a placement carried out, and looks at what has become of the wish; `step` says how far it came.
    async fn carry_out(
        &mut self,
        request: &PlaceRequest,
        (k, wish): (usize, &NextWish),
        step: &mut Step,
        view: &mut (String, Scene),
        known: &mut Known,
    ) -> Outcome {
        let (plan, executed) = match self.moved(request, &step.result, view).await {
            Ok(moved) => moved,
            Err(failure) => {
                step.reason = failure.error().map(ToString::to_string);
                return Err(failure);
            }
        };
        (step.placement, step.execution, step.reason) = (Some(plan.placement), Some(executed.outcome), executed.reason);
        // What was not placed is looked for where it was.
        let moved: Isometry3<f64> = match executed.outcome {
            ExecutionOutcome::Done => {
                from_row_major(&step.result.placements[plan.placement].placed_from_observed.0).map_err(Failure::other)?
            }
            ExecutionOutcome::Stopped | ExecutionOutcome::GraspLost => Isometry3::identity(),
        };
        *view = self.view_after(now_ns()).await?;
        known.look_again(Some((wish.query, moved)), &view.1.meta.objects);
        if step.execution == Some(ExecutionOutcome::Done) {
            match known.translated(&format!("step[{k}]"), wish.query, &wish.goal) {
                Ok((query, goal)) => step.holds = holds(&view.1, step.result.view_yaw_rad, query, &goal),
                Err(unseen) => step.reason = Some(format!("whether it holds cannot be seen: {}", unseen.message)),
            }
        }
        Ok(())
    }

    /// Whether another attempt makes sense and is nobody else's decision: nothing could be served and nothing has moved, or the object was not
    /// grasped, was lost, or does not stand where it should, and the robot stands there free, without a stop.
    async fn may_try_again(&self, step: &Step, carried_out: &Outcome) -> bool {
        if let Err(failure) = carried_out {
            let unserved = |error: &CallError| error.code == ErrorCode::FailedPrecondition && error.field.as_deref() == Some("placements");
            return step.execution.is_none() && failure.error().is_some_and(unserved);
        }
        let failed = match step.execution {
            Some(ExecutionOutcome::GraspLost) => true,
            Some(ExecutionOutcome::Done) => !step.achieved(),
            Some(ExecutionOutcome::Stopped) | None => false,
        };
        let is_free = |state: RobotState| state.mode == RobotMode::Idle && state.stop.is_none() && state.open_task().is_none();
        failed && client::robot_state(self.session, self.robot, self.deadline).await.is_ok_and(is_free)
    }

    /// Opens the hand, brings the arm home, and looks.
    async fn back_and_looking(&mut self) -> Result<(String, Scene), Failure> {
        for wanted in [RecoveryMove::Open, RecoveryMove::Retreat, RecoveryMove::Home] {
            let seen = match wanted {
                RecoveryMove::Open => None,
                RecoveryMove::Retreat | RecoveryMove::Home => Some(self.view_after(now_ns()).await?),
            };
            let moved = bring_back(self.session, &self.motion, (self.robot, wanted), seen.as_ref(), &mut self.interrupts).await;
            match moved {
                Ok(reply) if reply.outcome == ExecutionOutcome::Done => {}
                // The way home may be free all the same.
                Err(Failure::Other(error)) if wanted == RecoveryMove::Retreat && error.code == ErrorCode::FailedPrecondition => {}
                Ok(reply) => return Err(Failure::other(reply.reason.unwrap_or_else(|| "the arm was not brought back".to_owned()))),
                Err(failure) => return Err(failure),
            }
        }
        self.view_after(now_ns()).await
    }

    /// Has the motion service plan, and carry the plan out.
    async fn moved(
        &mut self,
        request: &PlaceRequest,
        result: &PlaceResult,
        view: &(String, Scene),
    ) -> Result<(MotionPlan, ExecuteReply), Failure> {
        let plan = self.motion_plan(request, result, view).await?;
        tracing::info!(query = request.query, placement = plan.placement, seconds = plan.duration_ms / 1e3, "executing");
        let payload = Payload::json(&plan)?;
        let execute = moving::call(self.session, &self.motion, (self.robot, "execute"), payload, &mut self.interrupts, None);
        let answer = execute.await?;
        Ok((plan, answer.payload.decode_json()?))
    }

    async fn motion_plan(&self, request: &PlaceRequest, result: &PlaceResult, view: &(String, Scene)) -> Result<MotionPlan, Failure> {
        let state = client::robot_state(self.session, self.robot, self.deadline).await?;
        let placements = result.placements.iter().map(|p| p.placed_from_observed).collect();
        let request = MotionPlanRequest {
            seed: request.seed,
            ..MotionPlanRequest::new(view.0.clone(), self.robot.to_owned(), request.query, placements, state.q_rad)
        };
        self.motion.plan_motion(&request, Some(&view.1), CallOptions::within(self.deadline)).await.map_err(of_motion)
    }
}
