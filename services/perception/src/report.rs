//! What a scene's owner should know, in the log.

use repose_proto::SceneSummary;

/// Logs a scene's warnings and the labels of its frame that are no objects; only what is new since `last`, the same camera's scene before.
pub fn report(scene: &SceneSummary, last: Option<&SceneSummary>) {
    let (camera, scene_id) = (&scene.camera, &scene.scene_id);
    for warning in &scene.warnings {
        if !last.is_some_and(|last| last.warnings.iter().any(|before| before.field == warning.field)) {
            tracing::warn!(camera, scene_id, field = warning.field, "{}", warning.message);
        }
    }
    for left_out in &scene.left_out {
        let is_known = last.is_some_and(|last| last.left_out.iter().any(|before| before.label == left_out.label));
        if let Some(label) = left_out.label.filter(|_| !is_known) {
            tracing::warn!(camera, scene_id, label, "{}: its readings stay in the scene, as an obstacle", left_out.reason.in_words());
        }
    }
}
