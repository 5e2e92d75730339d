//! Motion's configuration: every field with its unit, its default, and what raising it does. Unknown fields are refused.

use nalgebra::{Isometry3, Vector3};
use repose_geometry::transform::{from_row_major, to_row_major};
use repose_panda::interpolation::{ACCELERATION_EXCESS, ACCELERATION_JUMP, VELOCITY_EXCESS};
use repose_panda::{JOINT_COUNT, JointLimits, Model, START_TOLERANCE_RAD};
use repose_proto::CallError;
use repose_proto::limits::MAX_KEEP_OUT_ZONES;
use repose_proto::motion::KeepOutZone;
use repose_runtime::RuntimeError;
use serde::{Deserialize, Serialize};

use crate::execution::ExecutionSettings;
use crate::obstacles::ObstacleShape;
use crate::path::timing::TimingSettings;
use crate::pick_place::PickPlaceSettings;
use crate::recovery::RecoverySettings;
use crate::wire::PlanTerms;

/// Nothing is planned to where the robot would allow less than this, radians per second: an FR3's speeds fall to 0 before its position limits.
const SLOWEST_RAD_S: f64 = 0.1;

/// The least share of the limits that is used: less is no motion any more.
const LEAST_SHARE: f64 = 0.01;

/// Configuration of a motion process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MotionConfig {
    /// Where the robot's base stands in the world: 16 numbers, row-major. Default: the base is the world.
    pub world_from_base: [f64; 16],
    /// The robot's model, `panda` or `fr3`: under whose limits motions are planned, less what its drivers keep off them (5 mrad of each end of a
    /// joint's range; up to 3 % of the speed). Default `panda`. A robot that says another model of itself is not moved.
    pub robot_model: String,
    /// Share of the joints' velocity limits used in free space, 0.01 to a little below 1: the robot's cubics exceed it by a hair. Default 0.5;
    /// higher is faster.
    pub velocity_scale: f64,
    /// Share of the joints' acceleration limits used in free space, 0.01 to what the robot's cubics leave of 1, 0.92 with the other defaults.
    /// Default 0.25; higher is faster and shakes more.
    pub acceleration_scale: f64,
    /// Share of the joints' jerk limits used in free space, 0.01 to 1. Default 0.1; higher is a little faster and less smooth.
    pub jerk_scale: f64,
    /// Share of all three near things (approach, lift, lower, retreat), 0.01 to 1. Default 0.5.
    pub contact_scale: f64,
    /// Share of all three while the object is carried, 0.01 to 1. Default 0.5; higher is faster and loses more objects.
    pub holding_scale: f64,
    /// Boxes in the world that no part of the arm, nor what it holds, may enter: where people reach in, cables, a wall behind the camera.
    /// Default: none. Plans go around them, an arm is brought back around them, and a plan from elsewhere that enters one is not executed.
    pub keep_out: Vec<KeepOutZone>,
    /// What is added to the robot's spheres against the scene, metres. Default 0.005; more keeps further off and finds fewer ways.
    pub padding_m: f64,
    /// Grip force on what is held about its middle, newtons. Default 30.
    pub grip_force_n: f64,
    /// The most grip force, newtons; no less than `grip_force_n`. Default 60. What is held beside its middle, as a bowl at its rim, would turn between
    /// the fingers by its weight: the force on it grows with its lever up to this, at 5 cm.
    pub grip_force_max_n: f64,
    /// Height above the placement at which the object is released, metres. Default 0.02 (paper, section 3). What falls further may topple;
    /// what is lowered further may be pressed onto its support, whose height is known to a few millimetres.
    pub release_m: f64,
    /// Grasps tried per object, the best ones. Default 32; more finds rarer grasps and takes longer where none serves.
    pub grasps: usize,
    /// Random places drawn by one path search before it gives up. Default 1500.
    pub rrt_iterations: usize,
    /// Longest time between set-points of a plan, milliseconds. Default 10; less follows the timing more closely and makes plans larger. The
    /// robot interpolates between them with cubics, whose acceleration jumps at each: the more, the longer this and the larger `jerk_scale`.
    pub set_point_period_ms: f64,
    /// How far from a plan's start the arm may be when it is executed, radians per joint. Default 0.001, and no more: the robot takes no first
    /// set-point further from where it stands.
    pub start_tolerance_rad: f64,
    /// How old a plan's scene may be when it is executed, milliseconds. Default 120,000.
    pub max_scene_age_ms: u64,
    /// How far ahead of the robot set-points are sent, milliseconds of robot time, at least 200 and twice `command_period_ms`. Default 1000.
    pub command_horizon_ms: f64,
    /// How often they are sent, milliseconds. Default 50.
    pub command_period_ms: u64,
    /// How long a command may be acted on after receipt, milliseconds. Default 500.
    pub command_ttl_ms: u64,
    /// How long the robot's state may be silent in an execution, milliseconds, 500 to 10,000. Default 1500; higher bears slower links and machines,
    /// and lost robots are noticed later. A robot may take as long to take a command, and 2 s at least.
    pub robot_silence_ms: u64,
    /// How long fingers may take to settle, milliseconds of robot time, 500 to 60,000. Default 3000; slow fingers need longer. Fingers that still move then
    /// stop the execution.
    pub gripper_timeout_ms: f64,
    /// Share of the speed and acceleration of free space at which an arm is brought back after a stop, 0.01 to 1. Default 0.2.
    pub recovery_scale: f64,
    /// What happens to an execution whose client is gone: `stop` (it comes to rest on its path) or `finish`. Default `stop`.
    pub on_client_loss: OnClientLoss,
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

/// Keep-out zones as the solids that they are to a moving arm.
fn keep_out(zones: &[KeepOutZone]) -> Result<Vec<ObstacleShape>, ConfigError> {
    within("keep_out", zones.len() as f64, 0.0, MAX_KEEP_OUT_ZONES as f64)?;
    let solid = |(i, zone): (usize, &KeepOutZone)| {
        let refused = |e: CallError| ConfigError { field: "keep_out", message: format!("{}: {}", e.field.unwrap_or_default(), e.message) };
        zone.validate(&format!("keep_out[{i}]")).map_err(refused)?;
        let (min, max) = (Vector3::from(zone.min_m), Vector3::from(zone.max_m));
        Ok(ObstacleShape::cuboid(Isometry3::from((min + max) / 2.0), max - min))
    };
    zones.iter().enumerate().map(solid).collect()
}

/// What happens to an execution whose client is gone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OnClientLoss {
    /// It goes on to its end.
    Finish,
    /// It comes to rest on its path, as if it were cancelled; one that has not begun does not begin.
    Stop,
}

impl Default for MotionConfig {
    fn default() -> Self {
        let planning = PickPlaceSettings::default();
        let execution = ExecutionSettings::default();
        Self {
            world_from_base: to_row_major(&planning.world_from_base),
            robot_model: Model::Panda.name().to_owned(),
            velocity_scale: planning.timing.velocity_scale,
            acceleration_scale: planning.timing.acceleration_scale,
            jerk_scale: planning.timing.jerk_scale,
            contact_scale: planning.contact_scale,
            holding_scale: planning.holding_scale,
            keep_out: Vec::new(),
            padding_m: planning.padding_m,
            grip_force_n: planning.grip_force_n,
            grip_force_max_n: planning.grip_force_max_n,
            release_m: planning.reach.release_m,
            grasps: planning.grasp.count,
            rrt_iterations: planning.rrt.iterations,
            set_point_period_ms: 10.0,
            start_tolerance_rad: START_TOLERANCE_RAD,
            max_scene_age_ms: 120_000,
            command_horizon_ms: execution.horizon_ms,
            recovery_scale: 0.2,
            on_client_loss: OnClientLoss::Stop,
            command_period_ms: 50,
            command_ttl_ms: execution.ttl_ms,
            robot_silence_ms: execution.state_timeout_ms,
            gripper_timeout_ms: execution.gripper_timeout_ms,
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
    /// Checks all ranges.
    ///
    /// # Errors
    /// [`ConfigError`] that names the field.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.planning()?;
        self.terms()?;
        self.execution()?;
        self.recovery().map(drop)
    }

    /// Checks ranges; the planner's settings.
    ///
    /// # Errors
    /// [`ConfigError`] that names the field.
    pub fn planning(&self) -> Result<PickPlaceSettings, ConfigError> {
        let share = |field, value: f64| within(field, value, LEAST_SHARE, 1.0);
        share("velocity_scale", self.velocity_scale)?;
        share("acceleration_scale", self.acceleration_scale)?;
        share("jerk_scale", self.jerk_scale)?;
        share("contact_scale", self.contact_scale)?;
        share("holding_scale", self.holding_scale)?;
        within("padding_m", self.padding_m, 0.0, 0.05)?;
        within("grip_force_n", self.grip_force_n, 1.0, 70.0)?;
        within("grip_force_max_n", self.grip_force_max_n, self.grip_force_n, 70.0)?;
        within("release_m", self.release_m, 0.0, 0.05)?;
        within("threads", self.threads as f64, 1.0, 1024.0)?;
        within("queue", self.queue as f64, 1.0, 1e6)?;
        within("grasps", self.grasps as f64, 1.0, 10_000.0)?;
        within("rrt_iterations", self.rrt_iterations as f64, 1.0, 1e6)?;
        let mut settings = PickPlaceSettings {
            world_from_base: self.base()?,
            keep_out: keep_out(&self.keep_out)?,
            contact_scale: self.contact_scale,
            holding_scale: self.holding_scale,
            padding_m: self.padding_m,
            grip_force_n: self.grip_force_n,
            grip_force_max_n: self.grip_force_max_n,
            ..PickPlaceSettings::default()
        };
        let limits = self.model()?.driven_limits();
        settings.reach.inverse.limits = limits.approachable(SLOWEST_RAD_S);
        settings.timing = TimingSettings {
            limits,
            velocity_scale: self.velocity_scale,
            acceleration_scale: self.acceleration_scale,
            jerk_scale: self.jerk_scale,
            ..settings.timing
        };
        settings.reach.release_m = self.release_m;
        settings.grasp.count = self.grasps;
        // Each with the hand turned by half a turn, too.
        settings.grasps_per_placement = 2 * self.grasps;
        settings.rrt.iterations = self.rrt_iterations;
        Ok(settings)
    }

    /// Where the robot's base stands.
    ///
    /// # Errors
    /// [`ConfigError`] on `world_from_base`.
    pub fn base(&self) -> Result<Isometry3<f64>, ConfigError> {
        from_row_major(&self.world_from_base).map_err(|e| ConfigError { field: "world_from_base", message: e.to_string() })
    }

    /// The robot's model.
    ///
    /// # Errors
    /// [`ConfigError`] when there is none of that name.
    pub fn model(&self) -> Result<Model, ConfigError> {
        let unknown = || ConfigError { field: "robot_model", message: format!("expected panda or fr3, got {:?}", self.robot_model) };
        Model::parse(&self.robot_model).ok_or_else(unknown)
    }

    /// Checks ranges; how an arm is brought back.
    ///
    /// # Errors
    /// [`ConfigError`] that names the field.
    pub fn recovery(&self) -> Result<RecoverySettings, ConfigError> {
        within("recovery_scale", self.recovery_scale, LEAST_SHARE, 1.0)?;
        Ok(RecoverySettings::of(&self.planning()?, self.recovery_scale))
    }

    /// Checks ranges; what a plan says beside the motion.
    ///
    /// # Errors
    /// [`ConfigError`] that names the field.
    pub fn terms(&self) -> Result<PlanTerms, ConfigError> {
        within("set_point_period_ms", self.set_point_period_ms, 1.0, 100.0)?;
        let TimingSettings { limits, .. } = self.planning()?.timing;
        for (field, limit, share) in [
            ("set_point_period_ms", "jerk", self.jerk_seen()),
            ("acceleration_scale", "acceleration", self.acceleration_seen(&limits)),
            ("velocity_scale", "velocity", self.velocity_seen(&limits)),
        ] {
            if share > 1.0 {
                let (jerk_scale, period_ms) = (self.jerk_scale, self.set_point_period_ms);
                let message = format!(
                    "with a jerk_scale of {jerk_scale} and set-points every {period_ms} ms the robot could see {share:.3} times its {limit} limit"
                );
                return Err(ConfigError { field, message });
            }
        }
        within("start_tolerance_rad", self.start_tolerance_rad, 0.0, START_TOLERANCE_RAD)?;
        Ok(PlanTerms {
            set_point_period_ms: self.set_point_period_ms,
            start_tolerance_rad: self.start_tolerance_rad,
            max_scene_age_ms: self.max_scene_age_ms,
        })
    }

    /// Largest share of its jerk limits that the robot sees: one millisecond sees the jump at a set-point and the jerk between two of them.
    fn jerk_seen(&self) -> f64 {
        self.jerk_scale * (1.0 + ACCELERATION_JUMP * self.set_point_period_ms)
    }

    /// Largest share of its acceleration limits that the robot sees.
    fn acceleration_seen(&self, limits: &JointLimits) -> f64 {
        let jerk_per_s = (0..JOINT_COUNT).map(|i| limits.jerk_rad_s3[i] / limits.acceleration_rad_s2[i]).fold(0.0, f64::max);
        self.acceleration_scale + ACCELERATION_EXCESS * self.jerk_scale * jerk_per_s * self.set_point_period_ms * 1e-3
    }

    /// Largest share of its velocity limits that the robot sees, or would see before the acceleration is taken back with all that the limits
    /// allow. That takes the motion itself no further, for its jerk is lower; but the cubics' acceleration is off by half a jump, which is at most
    /// half of what the jerk's limit leaves in a millisecond, and acceleration changes a whole millisecond at a time: an eighth of the jerk's
    /// limit times the square of a millisecond each.
    fn velocity_seen(&self, limits: &JointLimits) -> f64 {
        let jerk_per_s2 = (0..JOINT_COUNT).map(|i| limits.jerk_rad_s3[i] / limits.velocity_rad_s[i]).fold(0.0, f64::max);
        let period_s = self.set_point_period_ms * 1e-3;
        self.velocity_scale + (VELOCITY_EXCESS * self.jerk_scale * period_s * period_s + 0.25e-6) * jerk_per_s2
    }

    /// Checks ranges; how an execution talks to the robot.
    ///
    /// # Errors
    /// [`ConfigError`] that names the field.
    pub fn execution(&self) -> Result<ExecutionSettings, ConfigError> {
        within("command_period_ms", self.command_period_ms as f64, 5.0, 200.0)?;
        // One that is lost or late is not missed: the next one comes before the robot is through with the last.
        let two_periods_ms = 2.0 * self.command_period_ms as f64;
        within("command_horizon_ms", self.command_horizon_ms, two_periods_ms.max(200.0), 10_000.0)?;
        within("command_ttl_ms", self.command_ttl_ms as f64, two_periods_ms, 10_000.0)?;
        within("robot_silence_ms", self.robot_silence_ms as f64, 500.0, 10_000.0)?;
        within("gripper_timeout_ms", self.gripper_timeout_ms, 500.0, 60_000.0)?;
        let defaults = ExecutionSettings::default();
        Ok(ExecutionSettings {
            model: self.model()?,
            world_from_base: self.base()?,
            horizon_ms: self.command_horizon_ms,
            ttl_ms: self.command_ttl_ms,
            // What a robot has taken only its states show.
            take_timeout_ms: defaults.take_timeout_ms.max(self.robot_silence_ms),
            state_timeout_ms: self.robot_silence_ms,
            gripper_timeout_ms: self.gripper_timeout_ms,
            ..defaults
        })
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
    use proptest::prelude::*;
    use repose_panda::{CommandRuleSettings, CommandRules, Joints, hermite};

    use super::*;
    use crate::path::timing::Trajectory;

    #[test]
    fn the_defaults_are_in_range_and_a_bad_value_is_named() {
        let config = MotionConfig::default();
        assert_eq!(config.planning().unwrap(), PickPlaceSettings::default());
        assert!(config.terms().is_ok() && config.execution().is_ok());
        let bad = MotionConfig { velocity_scale: 1.5, ..config };
        assert_eq!(bad.planning().unwrap_err().field, "velocity_scale");
        let hardly = MotionConfig { holding_scale: 1e-9, ..MotionConfig::default() };
        assert_eq!(hardly.planning().unwrap_err().field, "holding_scale");
        let unknown = MotionConfig { robot_model: "ur5".to_owned(), ..MotionConfig::default() };
        assert_eq!(unknown.planning().unwrap_err().field, "robot_model");
        let coarse = MotionConfig { set_point_period_ms: 50.0, ..MotionConfig::default() };
        assert_eq!(coarse.terms().unwrap_err().field, "set_point_period_ms");
        for (field, config) in [
            ("velocity_scale", MotionConfig { velocity_scale: 1.0, ..MotionConfig::default() }),
            ("acceleration_scale", MotionConfig { acceleration_scale: 1.0, ..MotionConfig::default() }),
            ("start_tolerance_rad", MotionConfig { start_tolerance_rad: 0.02, ..MotionConfig::default() }),
        ] {
            assert_eq!(config.terms().unwrap_err().field, field);
        }
    }

    /// The fastest that is accepted with set-points so far apart and a share of the jerk that may then be used.
    fn fastest(model: Model, set_point_period_ms: f64, jerk_share: f64) -> MotionConfig {
        let (robot_model, limits) = (model.name().to_owned(), model.driven_limits());
        let whole = MotionConfig { robot_model, set_point_period_ms, jerk_scale: 1.0, ..MotionConfig::default() };
        let jerky = MotionConfig { jerk_scale: jerk_share / whole.jerk_seen(), velocity_scale: 0.0, acceleration_scale: 0.0, ..whole };
        let (velocity_scale, acceleration_scale) = (1.0 - jerky.velocity_seen(&limits), 1.0 - jerky.acceleration_seen(&limits));
        MotionConfig { velocity_scale: velocity_scale - 1e-12, acceleration_scale: acceleration_scale - 1e-12, ..jerky }
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

        #[test]
        fn what_a_driver_makes_of_the_fastest_set_points_keeps_its_rules(
            ways in prop::collection::vec(prop::array::uniform7(0.02..0.98f64), 2..4),
            period_ms in 1.0..30.0f64,
            jerk_share in 0.2..0.999_999f64,
            model in prop_oneof![Just(Model::Panda), Just(Model::Fr3)],
        ) {
            let (config, limits) = (fastest(model, period_ms, jerk_share), model.driven_limits());
            prop_assert!(config.terms().is_ok());
            let corners: Vec<Joints> = ways.iter().map(|way| limits.approachable(SLOWEST_RAD_S).between(way)).collect();
            let trajectory = Trajectory::new(&corners, &config.planning().unwrap().timing).unwrap();
            let points: Vec<_> = trajectory.sampled(period_ms * 1e-3).collect();
            let end_s = points[points.len() - 1].0;
            let at = |ms: usize| {
                let t_s = (ms as f64 * 1e-3).min(end_s);
                let next = points.partition_point(|p| p.0 <= t_s).clamp(1, points.len() - 1);
                let ((from_s, a), (to_s, b)) = (&points[next - 1], &points[next]);
                let share = (t_s - from_s) / (to_s - from_s);
                hermite((&a.position_rad, &a.velocity_rad_s), (&b.position_rad, &b.velocity_rad_s), to_s - from_s, share).0
            };
            let followed: Vec<Joints> = (0..(end_s * 1e3) as usize + 5).map(at).collect();
            prop_assert_eq!(CommandRules::check(&followed[0], &followed, CommandRuleSettings { limits, ..CommandRuleSettings::default() }), Ok(()));
        }
    }

    #[test]
    fn a_queue_without_places_and_a_crew_of_nobody_are_refused_by_name() {
        let refused = |config: MotionConfig| config.validate().unwrap_err().field;
        assert_eq!(refused(MotionConfig { queue: 0, ..MotionConfig::default() }), "queue");
        assert_eq!(refused(MotionConfig { threads: 0, ..MotionConfig::default() }), "threads");
    }

    #[test]
    fn nothing_is_planned_to_where_a_driver_of_the_arm_does_not_go_or_faster_than_it_goes() {
        for model in Model::ALL {
            let config = MotionConfig { robot_model: model.name().to_owned(), ..MotionConfig::default() };
            let (planning, driven) = (config.planning().unwrap(), model.driven_limits());
            assert_eq!(planning.timing.limits, driven);
            let drawn_from = planning.reach.inverse.limits;
            for corner in [drawn_from.between(&[0.0; JOINT_COUNT]), drawn_from.between(&[1.0; JOINT_COUNT])] {
                assert!(driven.contains(&corner, 0.0), "{corner:?}");
                assert!((0..JOINT_COUNT).all(|i| [1.0, -1.0].iter().all(|way| driven.speed_at(i, corner[i], *way) > 0.0)));
            }
        }
    }

    #[test]
    fn as_many_grasps_are_tried_as_are_asked_for_in_both_turns_of_the_hand() {
        for grasps in [1, 32, 100] {
            let planning = MotionConfig { grasps, ..MotionConfig::default() }.planning().unwrap();
            assert_eq!((planning.grasp.count, planning.grasps_per_placement), (grasps, 2 * grasps));
        }
    }

    #[test]
    fn set_points_that_end_before_the_next_are_sent_are_refused() {
        let sent = |command_horizon_ms, command_period_ms| {
            MotionConfig { command_horizon_ms, command_period_ms, ..MotionConfig::default() }.execution().map(|s| s.horizon_ms)
        };
        assert_eq!(sent(200.0, 200).unwrap_err().field, "command_horizon_ms", "the robot would run out of them and stop");
        assert_eq!((sent(400.0, 200), sent(200.0, 100)), (Ok(400.0), Ok(200.0)));
        assert_eq!(sent(199.0, 5).unwrap_err().field, "command_horizon_ms");
        assert_eq!(sent(1000.0, 201).unwrap_err().field, "command_period_ms");
    }

    #[test]
    fn a_robot_may_be_silent_for_as_long_as_is_set_and_takes_commands_as_late() {
        let borne = |robot_silence_ms| {
            let config = MotionConfig { robot_silence_ms, ..MotionConfig::default() };
            config.execution().map(|s| (s.state_timeout_ms, s.take_timeout_ms)).map_err(|e| e.field)
        };
        assert_eq!((borne(500), borne(1500), borne(10_000)), (Ok((500, 2000)), Ok((1500, 2000)), Ok((10_000, 10_000))));
        assert_eq!((borne(499), borne(10_001)), (Err("robot_silence_ms"), Err("robot_silence_ms")));
    }

    #[test]
    fn keep_out_zones_are_checked_field_by_field() {
        let zone = |min_m, max_m| KeepOutZone { name: "operator".to_owned(), min_m, max_m };
        let with = |zones: &[KeepOutZone]| MotionConfig { keep_out: zones.to_vec(), ..MotionConfig::default() }.planning();
        let good = zone([0.0, 0.3, 0.0], [1.0, 1.0, 2.0]);
        assert_eq!(with(std::slice::from_ref(&good)).unwrap().keep_out.len(), 1);
        let flat = with(&[good.clone(), zone([0.0, 0.3, 0.0], [1.0, 0.3, 2.0])]).unwrap_err();
        assert!(flat.field == "keep_out" && flat.message.contains("keep_out[1].max_m[1]"), "{flat}");
        let nan = with(&[zone([f64::NAN, 0.0, 0.0], [1.0, 1.0, 1.0])]).unwrap_err();
        assert!(nan.message.contains("keep_out[0].min_m"), "{nan}");
        let nameless = with(&[KeepOutZone { name: String::new(), ..good.clone() }]).unwrap_err();
        assert!(nameless.message.contains("keep_out[0].name"), "{nameless}");
        assert!(with(&vec![good; 65]).is_err());
    }

    #[test]
    fn an_unknown_field_is_refused() {
        assert!(serde_json::from_str::<MotionConfig>(r#"{"velocity": 1}"#).is_err());
    }
}
