//! The simulator's configuration: every field with its unit, its default, and what raising it does. Unknown fields are refused.

use std::ops::RangeInclusive;

use repose_proto::keys::validate_chunk;
use repose_sensor::SensorModel;
use serde::{Deserialize, Serialize};

use crate::SimulatorError;

/// What may be asked of the world's clock. A step of a much slower one takes longer than the machine's clock can count, and the world's thread
/// would end with it.
const TIME_SCALES: RangeInclusive<f64> = 1e-6..=100.0;

/// Configuration of a simulator process, section `[simulator]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimulatorConfig {
    /// The seed of the first scene. Default 0.
    pub seed: u64,
    /// The camera's name in the key space. Default `front`.
    pub camera: String,
    /// The robot's name in the key space. Default `panda`.
    pub robot: String,
    /// How often a frame is put, milliseconds, at least 10. Default 200; lower makes fresher scenes and more traffic (2 MB a frame).
    pub frame_period_ms: u64,
    /// How often the robot's state is put, milliseconds, at least 1. Default 10; higher makes commanders react later.
    pub state_period_ms: u64,
    /// Simulated seconds per real second, a millionth to 100. Default 1; higher runs faster than a real robot, as far as the machine keeps up.
    pub time_scale: f64,
    /// Whether frames carry the true instance labels. Default true; without them perception segments by itself.
    pub labels: bool,
    /// Whether the robot is in the picture, as real cameras have it. Default true; without it frames are as after a driver's self filter.
    pub show_robot: bool,
    /// What kind of depth camera it is: `structured_light` (a Kinect), `active_stereo` (a RealSense D415) or `ideal` (no faults). Default
    /// `structured_light`.
    pub sensor: String,
    /// Commands and requests that wait; more are refused. Default 64.
    pub queue: usize,
}

impl Default for SimulatorConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            camera: "front".to_owned(),
            robot: "panda".to_owned(),
            frame_period_ms: 200,
            state_period_ms: 10,
            time_scale: 1.0,
            labels: true,
            show_robot: true,
            sensor: "structured_light".to_owned(),
            queue: 64,
        }
    }
}

impl SimulatorConfig {
    /// Checks what the types cannot.
    ///
    /// # Errors
    /// [`SimulatorError::Config`] that names the field.
    pub fn validate(&self) -> Result<(), SimulatorError> {
        let fail = |field: &'static str, message: String| Err(SimulatorError::Config { field, message });
        for (field, name) in [("camera", &self.camera), ("robot", &self.robot)] {
            if let Err(error) = validate_chunk(field, name) {
                return fail(field, error.message);
            }
        }
        if self.frame_period_ms < 10 {
            return fail("frame_period_ms", format!("expected at least 10, got {}", self.frame_period_ms));
        }
        if self.state_period_ms < 1 {
            return fail("state_period_ms", "expected at least 1, got 0".to_owned());
        }
        if !TIME_SCALES.contains(&self.time_scale) {
            return fail("time_scale", format!("expected {:e} to {}, got {}", TIME_SCALES.start(), TIME_SCALES.end(), self.time_scale));
        }
        if SensorModel::named(&self.sensor).is_none() {
            return fail("sensor", format!("expected one of {}, got {:?}", SensorModel::NAMES.join(", "), self.sensor));
        }
        if self.queue == 0 {
            return fail("queue", "expected at least 1, got 0".to_owned());
        }
        Ok(())
    }

    /// The depth camera.
    pub fn sensor_model(&self) -> SensorModel {
        SensorModel::named(&self.sensor).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_no_step_can_be_counted_by_is_refused() {
        let with = |time_scale: f64| SimulatorConfig { time_scale, ..SimulatorConfig::default() }.validate();
        for time_scale in [1e-6, 1.0, 100.0] {
            assert!(with(time_scale).is_ok(), "{time_scale}");
        }
        for time_scale in [0.0, -1.0, 1e-30, f64::MIN_POSITIVE, 101.0, f64::INFINITY, f64::NAN] {
            let error = with(time_scale).expect_err("out of range").to_string();
            assert!(error.contains("time_scale"), "{error}");
        }
    }
}
