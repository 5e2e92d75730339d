//! A running system as the commands see it that have a robot carry things out: its views, its planner, its robot, and the robot's way home.

use std::collections::BTreeMap;
use std::time::Duration;

use nalgebra::Isometry3;
use repose_geometry::transform::from_row_major;
use repose_proto::motion::{ExecuteReply, ExecutionOutcome, MotionPlan, MotionPlanRequest, RecoveryMove};
use repose_proto::place::{Placement, ReachingRobot};
use repose_proto::robot::{RobotMode, RobotState};
use repose_proto::{CallError, ErrorCode, Payload, PlaceRequest, PlaceResult, Scene, Service};
use repose_runtime::{CallOptions, Caller, Session, now_ns, reaching_robot};
use repose_tracking::Fate;
use serde::Serialize;

use crate::bring_back::bring_back;
use crate::client::{self, ConnectArgs};
use crate::failure::Failure;
use crate::moving::{self, Interrupts, of_motion};

/// Placements that motion may choose from.
pub const COUNT: u32 = 5;

/// A scene with its id.
pub type View = (String, Scene);

/// How far carrying a placement out came.
#[derive(Debug, Default, Serialize)]
pub struct Tried {
    /// The placement that motion chose, from 0; none where there was none to choose from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub placement: Option<usize>,
    /// How the execution ended; none where nothing was executed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub execution: Option<ExecutionOutcome>,
    /// Why it ended there, or why nothing was executed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Objects that do not stand where they were to be on the views after it, ids of the first view; none where nobody looked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fates: Option<BTreeMap<u16, Fate>>,
}

impl Tried {
    /// A plan that was executed, whatever came of it.
    fn executed(plan: &MotionPlan, reply: ExecuteReply) -> Self {
        Self { placement: Some(plan.placement), execution: Some(reply.outcome), reason: reply.reason, fates: None }
    }

    /// A failure before the end of an execution.
    pub fn failed(failure: &Failure) -> Self {
        Self { reason: failure.error().map(ToString::to_string), ..Self::default() }
    }

    /// What was seen after it of the objects, `carried` among them, for people.
    pub fn disturbances(&self, carried: Option<u16>) -> Vec<String> {
        self.fates.as_ref().map_or_else(Vec::new, |fates| repose_sentences::fate::describe(carried, fates))
    }

    /// Where the executed placement put the object; the identity where nothing was placed.
    pub fn moved(&self, placements: &[Placement]) -> Result<Isometry3<f64>, Failure> {
        match (self.execution, self.placement) {
            (Some(ExecutionOutcome::Done), Some(chosen)) => {
                from_row_major(&placements[chosen].placed_from_observed.0).map_err(Failure::other)
            }
            _ => Ok(Isometry3::identity()),
        }
    }
}

/// The running system.
pub struct System<'a> {
    session: &'a Session,
    /// Any of its planners.
    pub planner: Caller,
    motion: Caller,
    camera: &'a str,
    robot: &'a str,
    /// How long a call may take that does not move the robot.
    pub deadline: Duration,
    interrupts: Interrupts,
}

impl<'a> System<'a> {
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

    /// The robot with the pose of its base, where it tells that and its reach is known.
    pub async fn reaching(&self) -> Option<ReachingRobot> {
        // One that does not answer is named when it is to move.
        let state = self.state().await.ok()?;
        reaching_robot(self.robot, &state)
    }

    /// What the robot says of itself.
    pub async fn state(&self) -> Result<RobotState, Failure> {
        client::robot_state(self.session, self.robot, self.deadline).await
    }

    /// Whether the robot stands there free, without a stop.
    pub async fn is_free(&self) -> bool {
        let is_free = |state: RobotState| state.mode == RobotMode::Idle && state.stop.is_none() && state.open_task().is_none();
        self.state().await.is_ok_and(is_free)
    }

    /// The first scene, with its id, that was seen after an instant.
    pub async fn view_after(&self, instant_ns: u64) -> Result<View, Failure> {
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

    /// The planner's answer on a view.
    pub async fn placed(&self, request: &PlaceRequest, view: &View) -> Result<PlaceResult, Failure> {
        Ok(self.planner.place(request, Some(&view.1), CallOptions::within(self.deadline)).await?.0)
    }

    /// Opens the hand, brings the arm home, and looks.
    pub async fn back_and_looking(&mut self) -> Result<View, Failure> {
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

    /// Has the motion service plan for the placements of a request's query, the best first, and carry the plan out.
    pub async fn carry_out(&mut self, request: &PlaceRequest, placements: &[Placement], view: &View) -> Result<Tried, Failure> {
        let state = self.state().await?;
        let placed = placements.iter().map(|p| p.placed_from_observed).collect();
        let wanted = MotionPlanRequest {
            seed: request.seed,
            ..MotionPlanRequest::new(view.0.clone(), self.robot.to_owned(), request.query, placed, state.q_rad)
        };
        let planned = self.motion.plan_motion(&wanted, Some(&view.1), CallOptions::within(self.deadline)).await;
        let plan = planned.map_err(of_motion)?;
        tracing::info!(query = request.query, placement = plan.placement, seconds = plan.duration_ms / 1e3, "executing");
        let payload = Payload::json(&plan)?;
        let execute = moving::call(self.session, &self.motion, (self.robot, "execute"), payload, &mut self.interrupts, None);
        let answer = execute.await?;
        Ok(Tried::executed(&plan, answer.payload.decode_json()?))
    }
}

/// Whether motion could serve none of the placements: nothing has moved, and others may do.
pub fn is_unserved(failure: &Failure) -> bool {
    let unserved = |error: &CallError| error.code == ErrorCode::FailedPrecondition && error.field.as_deref() == Some("placements");
    failure.error().is_some_and(unserved)
}
