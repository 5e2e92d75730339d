//! Motion's configuration: every field with its unit, its default, and what raising it does. Unknown fields are refused.

use nalgebra::Isometry3;
use repose_geometry::transform::{from_row_major, to_row_major};
use repose_panda::interpolation::ACCELERATION_JUMP;
use repose_runtime::RuntimeError;
use serde::{Deserialize, Serialize};

use crate::execution::ExecutionSettings;
use crate::pick_place::PickPlaceSettings;
use crate::timing::TimingSettings;
use crate::wire::PlanTerms;

/// Configuration of a motion process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MotionConfig {
    /// Where the robot's base stands in the world: 16 numbers, row-major. Default: the base is the world.
    pub world_from_base: [f64; 16],
    /// Share of the joints' velocity limits used in free space, above 0 to 1. Default 0.5; higher is faster.
    pub velocity_scale: f64,
    /// Share of the joints' acceleration limits used in free space, above 0 to 1. Default 0.25; higher is faster and shakes more.
    pub acceleration_scale: f64,
    /// Share of the joints' jerk limits used in free space, above 0 to 1. Default 0.1; higher is a little faster and less smooth.
    pub jerk_scale: f64,
    /// Share of all three near things (approach, lift, lower, retreat), above 0 to 1. Default 0.5.
    pub contact_scale: f64,
    /// Share of all three while the object is carried, above 0 to 1. Default 0.5; higher is faster and loses more objects.
    pub holding_scale: f64,
    /// What is added to the robot's spheres against the scene, metres. Default 0.005; more keeps further off and finds fewer ways.
    pub padding_m: f64,
    /// Grip force, newtons. Default 30.
    pub grip_force_n: f64,
    /// Height above the placement at which the object is released, metres. Default 0.02 (paper, section 3). What falls further may topple;
    /// what is lowered further may be pressed onto its support, whose height is known to a few millimetres.
    pub release_m: f64,
    /// Grasps looked at per object. Default 48; more finds rarer grasps and takes longer where none serves.
    pub grasps: usize,
    /// Random places drawn by one path search before it gives up. Default 1500.
    pub rrt_iterations: usize,
    /// Longest time between set-points of a plan, milliseconds. Default 10; less follows the timing more closely and makes plans larger. The
    /// robot interpolates between them with cubics, whose acceleration jumps at each: the more, the longer this and the larger `jerk_scale`.
    pub set_point_period_ms: f64,
    /// How far from a plan's start the arm may be when it is executed, radians per joint. Default 0.02.
    pub start_tolerance_rad: f64,
    /// How old a plan's scene may be when it is executed, milliseconds. Default 120,000.
    pub max_scene_age_ms: u64,
    /// How far ahead of the robot set-points are sent, milliseconds of robot time, at least 200. Default 1000.
    pub command_horizon_ms: f64,
    /// How often they are sent, milliseconds. Default 50.
    pub command_period_ms: u64,
    /// How long a command may be acted on after receipt, milliseconds. Default 500.
    pub command_ttl_ms: u64,
    /// How long to wait for a robot's first state, and for a stop to clear, milliseconds. Default 3000.
    pub robot_timeout_ms: u64,
    /// Threads that plan. Default 1.
    pub threads: usize,
    /// Planning requests that wait; more are refused at once. Default 16.
    pub queue: usize,
    /// Scenes kept. Default 16.
    pub scenes: usize,
    /// The name under which this process commands robots; a chunk of a key. Default: one made up from the process and the time.
    pub commander: Option<String>,
}

impl Default for MotionConfig {
    fn default() -> Self {
        let planning = PickPlaceSettings::default();
        let execution = ExecutionSettings::default();
        Self {
            world_from_base: to_row_major(&planning.world_from_base),
            velocity_scale: planning.timing.velocity_scale,
            acceleration_scale: planning.timing.acceleration_scale,
            jerk_scale: planning.timing.jerk_scale,
            contact_scale: planning.contact_scale,
            holding_scale: planning.holding_scale,
            padding_m: planning.padding_m,
            grip_force_n: planning.grip_force_n,
            release_m: planning.reach.release_m,
            grasps: planning.grasp.count,
            rrt_iterations: planning.rrt.iterations,
            set_point_period_ms: 10.0,
            start_tolerance_rad: 0.02,
            max_scene_age_ms: 120_000,
            command_horizon_ms: execution.horizon_ms,
            command_period_ms: 50,
            command_ttl_ms: execution.ttl_ms,
            robot_timeout_ms: 3000,
            threads: 1,
            queue: 16,
            scenes: 16,
            commander: None,
        }
    }
}

impl From<ConfigError> for RuntimeError {
    fn from(error: ConfigError) -> Self {
        Self::Config { section: "motion".to_owned(), file: None, message: error.to_string() }
    }
}

/// A value that cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{field}: {message}")]
pub struct ConfigError {
    /// The field.
    pub field: &'static str,
    /// What was expected and what came.
    pub message: String,
}

impl MotionConfig {
    /// Checks ranges; the planner's settings.
    ///
    /// # Errors
    /// [`ConfigError`] that names the field.
    pub fn planning(&self) -> Result<PickPlaceSettings, ConfigError> {
        let share = |field, value: f64| within(field, value, f64::MIN_POSITIVE, 1.0);
        share("velocity_scale", self.velocity_scale)?;
        share("acceleration_scale", self.acceleration_scale)?;
        share("jerk_scale", self.jerk_scale)?;
        share("contact_scale", self.contact_scale)?;
        share("holding_scale", self.holding_scale)?;
        within("padding_m", self.padding_m, 0.0, 0.05)?;
        within("grip_force_n", self.grip_force_n, 1.0, 70.0)?;
        within("release_m", self.release_m, 0.0, 0.05)?;
        within("grasps", self.grasps as f64, 1.0, 10_000.0)?;
        within("rrt_iterations", self.rrt_iterations as f64, 1.0, 1e6)?;
        let world_from_base: Isometry3<f64> =
            from_row_major(&self.world_from_base).map_err(|e| ConfigError { field: "world_from_base", message: e.to_string() })?;
        let mut settings = PickPlaceSettings {
            world_from_base,
            contact_scale: self.contact_scale,
            holding_scale: self.holding_scale,
            padding_m: self.padding_m,
            grip_force_n: self.grip_force_n,
            ..PickPlaceSettings::default()
        };
        settings.timing = TimingSettings {
            velocity_scale: self.velocity_scale,
            acceleration_scale: self.acceleration_scale,
            jerk_scale: self.jerk_scale,
            ..settings.timing
        };
        settings.reach.release_m = self.release_m;
        settings.grasp.count = self.grasps;
        settings.rrt.iterations = self.rrt_iterations;
        Ok(settings)
    }

    /// Checks ranges; what a plan says beside the motion.
    ///
    /// # Errors
    /// [`ConfigError`] that names the field.
    pub fn terms(&self) -> Result<PlanTerms, ConfigError> {
        within("set_point_period_ms", self.set_point_period_ms, 1.0, 100.0)?;
        // One millisecond sees the jump at a set-point and the jerk between two of them: together no more than the limit.
        let jerk_share = self.jerk_scale * (1.0 + ACCELERATION_JUMP * self.set_point_period_ms);
        if jerk_share > 1.0 {
            let message = format!("with a jerk_scale of {} the robot would see {jerk_share:.2} times its jerk limit", self.jerk_scale);
            return Err(ConfigError { field: "set_point_period_ms", message });
        }
        within("start_tolerance_rad", self.start_tolerance_rad, 0.0, 0.2)?;
        Ok(PlanTerms {
            set_point_period_ms: self.set_point_period_ms,
            start_tolerance_rad: self.start_tolerance_rad,
            max_scene_age_ms: self.max_scene_age_ms,
        })
    }

    /// Checks ranges; how an execution talks to the robot.
    ///
    /// # Errors
    /// [`ConfigError`] that names the field.
    pub fn execution(&self) -> Result<ExecutionSettings, ConfigError> {
        within("command_horizon_ms", self.command_horizon_ms, 200.0, 10_000.0)?;
        within("command_period_ms", self.command_period_ms as f64, 5.0, 200.0)?;
        within("command_ttl_ms", self.command_ttl_ms as f64, 2.0 * self.command_period_ms as f64, 10_000.0)?;
        Ok(ExecutionSettings { horizon_ms: self.command_horizon_ms, ttl_ms: self.command_ttl_ms, ..ExecutionSettings::default() })
    }
}

fn within(field: &'static str, value: f64, low: f64, high: f64) -> Result<(), ConfigError> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(ConfigError { field, message: format!("expected {low} to {high}, got {value}") })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_in_range_and_a_bad_value_is_named() {
        let config = MotionConfig::default();
        assert_eq!(config.planning().unwrap(), PickPlaceSettings::default());
        assert!(config.terms().is_ok() && config.execution().is_ok());
        let bad = MotionConfig { velocity_scale: 1.5, ..config };
        assert_eq!(bad.planning().unwrap_err().field, "velocity_scale");
        let coarse = MotionConfig { set_point_period_ms: 50.0, ..MotionConfig::default() };
        assert_eq!(coarse.terms().unwrap_err().field, "set_point_period_ms");
    }

    #[test]
    fn an_unknown_field_is_refused() {
        assert!(serde_json::from_str::<MotionConfig>(r#"{"velocity": 1}"#).is_err());
    }
}
