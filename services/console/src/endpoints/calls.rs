//! Having a motion planned and carried out: what a viewer's request and a step of a sequence have in common.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use repose_executive::{AskedRecovery, IdentifiedScene, SHOWS_WITHIN, newest_after};
use repose_proto::motion::{ExecuteProgress, ExecuteReply, MotionPlan, MotionPlanRequest, RecoverReply, RecoveryMove};
use repose_proto::robot::RobotState;
use repose_proto::scene::WorldFrame;
use repose_proto::{CallError, Message as _, Payload, Scene, Service};
use repose_runtime::{Answer, CallOptions, call_moving, robot_state};
use tokio::sync::mpsc;

use crate::activity::{ExecutionEnded, ExecutionShown};
use crate::arm::{PlanShown, world_from_base};
use crate::cell::WatchedCell;

/// Progress that may wait; what does not fit is dropped.
const PROGRESS: usize = 16;
/// How long an execution may take.
const EXECUTION: Duration = Duration::from_secs(600);

/// Has a motion planned from where the robot stands.
pub async fn plan(
    cell: &WatchedCell,
    request: MotionPlanRequest,
    scene: &Scene,
    options: CallOptions,
) -> Result<(Arc<MotionPlan>, Arc<PlanShown>), CallError> {
    let robot = cell.robot(&request.robot)?;
    let request = MotionPlanRequest { start_joints_rad: robot.q_rad, ..request };
    request.validate()?;
    let plan = cell.caller(Service::Motion).plan_motion(&request, Some(scene), options).await?;
    let shown = shown(&plan, &robot);
    Ok((Arc::new(plan), shown))
}

/// A plan as it is shown, under an id of its own; `robot` says where its base stands.
pub fn shown(plan: &MotionPlan, robot: &RobotState) -> Arc<PlanShown> {
    Arc::new(PlanShown::new(uuid::Uuid::new_v4().to_string(), plan, &world_from_base(robot)))
}

/// Has a plan carried out, and tells the cell's viewers how far it is, under an `id` of its own. Goes on when whoever asked has left: a robot is
/// stopped by its stop.
pub async fn execute(cell: &WatchedCell, id: String, plan: &MotionPlan) -> Result<Answer, CallError> {
    let phases: Vec<String> = plan.phases.iter().map(|p| p.name.to_string()).collect();
    let mut shown = ExecutionShown { id, robot: plan.robot.clone(), query: plan.query, phases, phase: 0, ended: None, said: Vec::new() };
    // It leaves the place that any other motion of its begins at.
    cell.hide_plan(|shown| shown.robot == plan.robot);
    cell.update(|activity| activity.show_execution(&shown, false));
    let (sender, mut progress) = mpsc::channel::<Payload>(PROGRESS);
    let calling = async { moving(cell, "execute", Payload::json(plan)?, Some(sender)).await };
    let telling = async {
        let mut is_taken = false;
        // The sender goes with the call, which ends the race below.
        while let Some(payload) = progress.recv().await {
            let Ok(at) = payload.decode_json::<ExecuteProgress>() else { continue };
            shown.phase = at.done.min(at.of.saturating_sub(1));
            // Motion has taken it: it is under way, whatever else is.
            cell.update(|activity| activity.show_execution(&shown, !is_taken));
            is_taken = true;
        }
        std::future::pending::<Infallible>().await
    };
    let answer = tokio::select! {
        answer = calling => answer,
        never = telling => match never {},
    };
    shown.ended = Some(match answer.as_ref().map_err(Clone::clone).and_then(|answer| answer.payload.decode_json::<ExecuteReply>()) {
        Ok(reply) => ExecutionEnded::Outcome { outcome: reply.outcome, reason: reply.reason },
        Err(error) => ExecutionEnded::Error(error),
    });
    cell.update(|activity| activity.show_execution(&shown, false));
    answer
}

/// Brings an arm back, its way checked against the newest scene of a camera, or, where that is asked for, `unchecked`. Opening the hand moves no arm
/// and is checked against nothing.
///
/// # Errors
/// `failed_precondition` on `unchecked` where there is no scene to check the way against; as motion says.
pub async fn recover(
    cell: &WatchedCell,
    camera: &str,
    robot: &str,
    motion: RecoveryMove,
    unchecked: bool,
) -> Result<RecoverReply, CallError> {
    let scene = match motion {
        RecoveryMove::Open => None,
        RecoveryMove::Retreat | RecoveryMove::Home if unchecked => None,
        RecoveryMove::Retreat | RecoveryMove::Home => {
            // Of a robot that tells nothing motion says so.
            let now_ns = robot_state(cell.session(), robot, SHOWS_WITHIN).await.map_or(0, |state| state.stamp_ns);
            Some(surroundings(cell, camera, now_ns).await.map_err(|why| unseen(camera, &why))?)
        }
    };
    let recovery = AskedRecovery::new(robot, motion, scene.as_ref())?;
    let mut answer = moving(cell, "recover", recovery.by_id()?, None).await;
    if let Some(whole) = recovery.again(&answer) {
        answer = moving(cell, "recover", whole?, None).await;
    }
    answer?.payload.decode_json()
}

/// What an arm's way can be checked against: a scene of a camera that knows where it stands, seen from `now_ns` on, for the arm may have moved a moment ago;
/// of a camera that shows nothing new its newest.
async fn surroundings(cell: &WatchedCell, camera: &str, now_ns: u64) -> Result<IdentifiedScene, CallError> {
    let summary = newest_after(|| cell.newest(camera), now_ns, SHOWS_WITHIN).await?;
    let newest = cell.scene(&summary.scene_id).await?;
    match newest.meta.world_frame {
        WorldFrame::Extrinsics => Ok((summary.scene_id, newest)),
        _ => Err(CallError::precondition("its scenes are of a camera that does not know where it stands")),
    }
}

fn unseen(camera: &str, why: &CallError) -> CallError {
    let message = format!("camera {camera} shows no scene to check the arm's way against: {}; nothing has moved", why.message);
    CallError::precondition(message).at("unchecked")
}

/// Calls something that moves a robot.
pub async fn moving(
    cell: &WatchedCell,
    method: &str,
    payload: Payload,
    progress: Option<mpsc::Sender<Payload>>,
) -> Result<Answer, CallError> {
    let options = CallOptions { progress, ..CallOptions::at_most_once(EXECUTION) };
    call_moving(cell.session(), cell.caller(Service::Motion), method, payload, options).await
}
