//! What an agent is let near, and for how long its questions may take.

use std::time::Duration;

use repose_proto::{CallError, keys, limits};

/// Settings of the tools: the camera, the robot, and their limits.
#[derive(Debug, Clone, PartialEq)]
pub struct McpSettings {
    /// The camera that looks.
    pub camera: String,
    /// The robot that is stopped, asked for its state, and carries plans out.
    pub robot: String,
    /// Whether plans may be carried out.
    pub allow_execute: bool,
    /// How long an agent's request may take. Of an execution it bounds the preparation, and the look afterwards; the arm takes its own time.
    pub deadline: Duration,
    /// How far the centroid of an object may be from where it was planned with, metres, for the scene to be the same.
    pub still_m: f64,
}

impl Default for McpSettings {
    fn default() -> Self {
        Self {
            camera: "front".to_owned(),
            robot: "panda".to_owned(),
            allow_execute: false,
            deadline: Duration::from_secs(60),
            still_m: 0.01,
        }
    }
}

impl McpSettings {
    /// Checks what the types cannot.
    ///
    /// # Errors
    /// `invalid_argument` that names the field.
    pub fn validate(&self) -> Result<(), CallError> {
        keys::validate_chunk("camera", &self.camera)?;
        keys::validate_chunk("robot", &self.robot)?;
        let most = Duration::from_millis(limits::MAX_REMAINING_MS);
        if self.deadline.is_zero() || self.deadline > most {
            let message = format!("expected 1 to {} ms, got {}", limits::MAX_REMAINING_MS, self.deadline.as_millis());
            return Err(CallError::invalid("deadline_ms", message));
        }
        Ok(())
    }
}
