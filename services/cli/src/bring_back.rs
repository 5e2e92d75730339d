//! One recovery move of an arm: fingers open, hand backed off, arm in its ready pose.

use repose_proto::enclosed::enclose;
use repose_proto::motion::{RecoverReply, RecoverRequest, RecoveryMove};
use repose_proto::{Message, Payload, Scene, SceneRef};
use repose_runtime::{Caller, Session};

use crate::failure::Failure;
use crate::moving::{self, Interrupts};

/// Has the motion service bring an arm back, its way checked against a scene (with its id) where there is one.
///
/// # Errors
/// Those of the call; `failed_precondition` where the arm cannot be brought back so.
pub async fn bring_back(
    session: &Session,
    motion: &Caller,
    (robot, wanted): (&str, RecoveryMove),
    scene: Option<&(String, Scene)>,
    interrupts: &mut Interrupts,
) -> Result<RecoverReply, Failure> {
    let named = scene.map(|(scene_id, _)| SceneRef { scene_id: scene_id.clone() });
    let request = RecoverRequest { robot: robot.to_owned(), motion: wanted, scene: named };
    let payload = match scene {
        Some((_, scene)) => Payload::bulk(RecoverRequest::SCHEMA, &enclose(&request, Some(scene)))?,
        None => Payload::json(&request)?,
    };
    let answer = moving::call(session, motion, (robot, "recover"), payload, interrupts, None).await?;
    Ok(answer.payload.decode_json()?)
}
