//! The service's configuration, section `[perception]`.

use std::time::Duration;

use repose_proto::CallError;
use repose_proto::keys::validate_chunk;
use serde::Deserialize;

use crate::cameras::pace::{PAUSE, PaceSettings};
use crate::newest_scenes::NewestLimits;
use crate::settings::Settings;

/// Configuration of a perception worker. Unknown fields are refused.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PerceptionConfig {
    /// The cameras whose frames this worker turns into scenes; empty means every camera of the cell. Where several perception workers
    /// share a cell, each must name its own, or every scene is published more than once.
    #[serde(deserialize_with = "repose_runtime::list_or_commas")]
    pub cameras: Vec<String>,
    /// Most cameras with a frame waiting; frames of further ones are dropped and counted. Also most whose newest scene is known (the
    /// longest silent one goes) and that the metrics name. Raising it costs one frame of memory each.
    pub max_cameras: usize,
    /// Threads that segment. Raising it helps several cameras or callers, not a single one.
    pub threads: usize,
    /// Frames of callers that may wait for a thread; the next is refused at once. Raising it lets callers wait longer instead.
    pub queue_capacity: usize,
    /// How long a camera's frame may take from its arrival to its scene, milliseconds; an older one is dropped and counted.
    pub frame_timeout_ms: u64,
    /// A frame stamped this much before its camera's newest one was overtaken on its way, and is dropped and counted, milliseconds; one
    /// stamped earlier still is taken, with a warning: the camera's clock was set back, or had been ahead. Raising it bears more disorder,
    /// and lets a wrong clock silence a camera for longer.
    pub late_within_ms: u64,
    /// Most scenes that can be asked for by id. Raising it keeps older scenes plannable, at about 4 MB each.
    pub scenes_kept: usize,
    /// Most bytes of those scenes. The older go first.
    pub scenes_kept_bytes: usize,
    /// How long a camera's scene that nobody asked for is kept once there is a newer one, milliseconds; the newest is kept however old it is. Where there
    /// is no room a scene goes sooner. Raising it gives whoever has read an id more time, at about 5 MB for every scene of that time.
    pub unasked_kept_ms: u64,
    /// How often a frame of a stream becomes a scene while nobody asks for its camera's scenes, milliseconds; 0 makes one of every frame. A frame after
    /// a second's pause, and the last of a stream, become one whoever asks, and who asks after a pause gets that of the newest frame. Raising it saves
    /// an idle cell processor time and memory, and shows those who read summaries only, and never ask, fewer of them.
    pub idle_period_ms: u64,
    /// How long a camera's scenes count as asked for after a call of `latest` or `scene`, milliseconds.
    pub asked_for_ms: u64,
    /// How long the cell's first frame, and the first that is asked for after a pause, waits for a word of the robots, milliseconds: until then an arm in
    /// the picture is taken for objects, or for where it stood last. Raising it helps where robots are slow to connect, and keeps a cell without robots
    /// waiting once. No frame waits for longer than half of `frame_timeout_ms`.
    pub robots_wait_ms: u64,
    /// How frames become scenes.
    pub segmentation: Settings,
}

impl Default for PerceptionConfig {
    fn default() -> Self {
        Self {
            cameras: Vec::new(),
            max_cameras: 16,
            threads: 1,
            queue_capacity: 8,
            frame_timeout_ms: 1000,
            late_within_ms: 1000,
            scenes_kept: 32,
            scenes_kept_bytes: 256 << 20,
            unasked_kept_ms: 3000,
            idle_period_ms: 10_000,
            asked_for_ms: 10_000,
            robots_wait_ms: 300,
            segmentation: Settings::default(),
        }
    }
}

impl PerceptionConfig {
    /// Checks what the types cannot.
    ///
    /// # Errors
    /// `invalid_argument` that names the field.
    pub fn validate(&self) -> Result<(), CallError> {
        for (field, count) in [("max_cameras", self.max_cameras), ("threads", self.threads), ("queue_capacity", self.queue_capacity)] {
            if count == 0 {
                return Err(CallError::invalid(format!("perception.{field}"), "expected at least 1, got 0"));
            }
        }
        self.cameras.iter().try_for_each(|camera| validate_chunk("perception.cameras", camera))?;
        self.segmentation.validate("perception.segmentation")
    }

    /// The limits of which scene is each camera's newest.
    pub fn newest_limits(&self) -> NewestLimits {
        NewestLimits { cameras: self.max_cameras, late_ns: self.late_within_ms.saturating_mul(1_000_000) }
    }

    /// How long a camera's frame may wait until it is made a scene, and the robots' states of its time are needed: a newer one replaces it, or it is the
    /// last before a pause.
    pub fn frame_may_wait(&self) -> Duration {
        PAUSE + Duration::from_millis(self.frame_timeout_ms)
    }

    /// How often frames become scenes.
    pub fn pace(&self) -> PaceSettings {
        PaceSettings {
            idle_period: Duration::from_millis(self.idle_period_ms),
            asked_for: Duration::from_millis(self.asked_for_ms),
            cameras: self.max_cameras,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_left_out_have_their_defaults_and_unknown_ones_are_refused() {
        let config: PerceptionConfig = serde_json::from_str(r#"{"threads": 2, "segmentation": {"borders": {"radius_px": 3}}}"#).unwrap();
        assert_eq!((config.threads, config.queue_capacity, config.segmentation.borders.radius_px), (2, 8, 3));
        assert_eq!(config.segmentation.gravity, Settings::default().gravity);
        for wrong in [r#"{"thread": 2}"#, r#"{"segmentation": {"border": {}}}"#] {
            assert!(serde_json::from_str::<PerceptionConfig>(wrong).unwrap_err().to_string().contains("unknown field"));
        }
    }

    #[test]
    fn a_setting_out_of_its_range_is_named() {
        let config: PerceptionConfig =
            serde_json::from_str(r#"{"segmentation": {"surfaces": {"bin_m": 0.01, "tolerance_m": 0.002}}}"#).unwrap();
        let named = config.validate().unwrap_err().field;
        assert_eq!(named.as_deref(), Some("perception.segmentation.surfaces.tolerance_m"));
        assert!(PerceptionConfig::default().validate().is_ok());
    }

    #[test]
    fn a_count_of_none_and_a_camera_that_cannot_be_are_named() {
        let named = |text: &str| serde_json::from_str::<PerceptionConfig>(text).unwrap().validate().unwrap_err().field.unwrap();
        for field in ["max_cameras", "threads", "queue_capacity"] {
            assert_eq!(named(&format!(r#"{{"{field}": 0}}"#)), format!("perception.{field}"));
        }
        assert_eq!(named(r#"{"cameras": ["front", "Front Camera"]}"#), "perception.cameras");
    }

    #[test]
    fn cameras_are_a_list_or_a_text_with_commas() {
        for text in [r#"{"cameras": ["front", "wrist"]}"#, r#"{"cameras": "front, wrist"}"#] {
            assert_eq!(serde_json::from_str::<PerceptionConfig>(text).unwrap().cameras, ["front", "wrist"]);
        }
    }
}
