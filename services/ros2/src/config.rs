//! The bridge's configuration, section `[ros2]`: which topics are which cameras and robots. Unknown fields are refused.

mod camera;
mod checks;

use repose_proto::RigidTransform;
use repose_robot_side::ArmSettings;
use repose_runtime::{SessionConfig, SessionMode, endpoint_fault};
use serde::Deserialize;

use crate::error::BridgeError;

use checks::{check_chunk, check_name, check_pose, within};

pub use camera::{CameraConfig, DepthSource, is_packed};

/// Configuration of a bridge process.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Ros2Config {
    /// The session with the ROS 2 system, like `[session]`; the cell does not matter. Default: a client of `rmw_zenohd` on this machine,
    /// `tcp/127.0.0.1:7447`.
    pub session: SessionConfig,
    /// The ROS domain, `ROS_DOMAIN_ID`. Default 0.
    pub domain: u32,
    /// The node's namespace. Default `/`.
    pub namespace: String,
    /// The node's name, under which its own topics and services are. Default `repose`.
    pub node: String,
    /// The frame of ROS that is the cell's world. Default `world`.
    pub world_frame: String,
    /// The cameras.
    pub cameras: Vec<CameraConfig>,
    /// The robots.
    pub robots: Vec<RobotConfig>,
    /// Whether scenes are published as detections, poses, markers and a labelled cloud. Default true.
    pub publish_scenes: bool,
    /// Whether `place`, `plan` and `stop` are offered as services. Default true.
    pub offer_services: bool,
    /// Whether a ROS client may have plans carried out: it acts with this process's rights then. Default false.
    pub allow_execute: bool,
    /// The deadline of a placement or a plan that a ROS client asks for, milliseconds. Default 30000.
    pub request_deadline_ms: u64,
}

impl Default for Ros2Config {
    fn default() -> Self {
        Self {
            session: SessionConfig {
                mode: SessionMode::Client,
                connect: vec!["tcp/127.0.0.1:7447".to_owned()],
                ..SessionConfig::default()
            },
            domain: 0,
            namespace: "/".to_owned(),
            node: "repose".to_owned(),
            world_frame: "world".to_owned(),
            cameras: Vec::new(),
            robots: Vec::new(),
            publish_scenes: true,
            offer_services: true,
            allow_execute: false,
            request_deadline_ms: 30_000,
        }
    }
}

/// One robot: its joints, and the controllers that move them.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotConfig {
    /// Its name in the cell, a chunk of a key.
    pub name: String,
    /// Its model, `panda` or `fr3`: under whose limits it is commanded, and what its state says that it is. Default `panda`.
    #[serde(default = "model")]
    pub model: String,
    /// Its joints: `sensor_msgs/msg/JointState`. Default `/joint_states`.
    #[serde(default = "joint_states")]
    pub joint_states: String,
    /// The names of its seven joints, from the base outwards. Default: the Panda's.
    #[serde(default = "joints")]
    pub joints: [String; 7],
    /// The names of its finger joints, whose positions add up to the gripper's opening. Default: the Panda's.
    #[serde(default = "finger_joints")]
    pub finger_joints: Vec<String>,
    /// The action `control_msgs/action/FollowJointTrajectory` of its controller.
    pub trajectory_action: String,
    /// The action `control_msgs/action/GripperCommand` of its hand; without it the hand is never moved.
    #[serde(default)]
    pub gripper_action: Option<String>,
    /// What a controller's gripper position is of the opening. Default 0.5: the position of one of two fingers.
    #[serde(default = "half")]
    pub gripper_position_per_width: f64,
    /// Where the robot's base stands. Default: from the transforms, `world_frame` from `base_frame`; the robot stays stopped until they tell it.
    #[serde(default)]
    pub world_from_base: Option<RigidTransform>,
    /// The frame of the robot's base. Default `panda_link0`.
    #[serde(default = "base_frame")]
    pub base_frame: String,
    /// How far a joint may be from its set-point before the arm counts as not following, radians. Default 0.1.
    #[serde(default = "following_tolerance_rad")]
    pub following_tolerance_rad: f64,
    /// How long a controller may take to answer, and a result may be overdue, milliseconds. Default 2000.
    #[serde(default = "controller_timeout_ms")]
    pub controller_timeout_ms: u64,
}

fn model() -> String {
    "panda".to_owned()
}

fn joint_states() -> String {
    "/joint_states".to_owned()
}

fn joints() -> [String; 7] {
    std::array::from_fn(|i| format!("panda_joint{}", i + 1))
}

fn finger_joints() -> Vec<String> {
    ["panda_finger_joint1", "panda_finger_joint2"].map(str::to_owned).into()
}

fn half() -> f64 {
    0.5
}

fn base_frame() -> String {
    "panda_link0".to_owned()
}

fn following_tolerance_rad() -> f64 {
    0.1
}

fn controller_timeout_ms() -> u64 {
    2000
}

impl Ros2Config {
    /// Checks names and ranges.
    ///
    /// # Errors
    /// [`BridgeError::Config`] that names the field.
    pub fn validate(&self) -> Result<(), BridgeError> {
        if self.namespace != "/" {
            check_name("namespace", &self.namespace)?;
        }
        check_name("node", &format!("/{}", self.node))?;
        if let Some(fault) = self.session.connect.iter().find_map(|endpoint| endpoint_fault(endpoint)) {
            return Err(BridgeError::config("session.connect", fault));
        }
        within("domain", f64::from(self.domain), 0.0, 232.0)?;
        within("request_deadline_ms", self.request_deadline_ms as f64, 1.0, repose_proto::limits::MAX_REMAINING_MS as f64)?;
        for (i, camera) in self.cameras.iter().enumerate() {
            camera.validate(&format!("cameras[{i}]"))?;
        }
        for (i, robot) in self.robots.iter().enumerate() {
            robot.validate(&format!("robots[{i}]"))?;
        }
        let names = self.cameras.iter().map(|c| ("cameras", &c.name)).chain(self.robots.iter().map(|r| ("robots", &r.name)));
        let mut seen = std::collections::BTreeSet::new();
        for (field, name) in names {
            if !seen.insert((field, name)) {
                return Err(BridgeError::config(field, format!("{name:?} is there twice")));
            }
        }
        Ok(())
    }
}

impl RobotConfig {
    /// The arm and its rules; `field` is what an error calls this robot.
    ///
    /// # Errors
    /// [`BridgeError::Config`] when there is no model of that name.
    pub fn arm(&self, field: &str) -> Result<ArmSettings, BridgeError> {
        let unknown = || BridgeError::config(format!("{field}.model"), format!("expected panda or fr3, got {:?}", self.model));
        let settings = ArmSettings::of_model(&self.model).ok_or_else(unknown)?;
        Ok(ArmSettings { following_tolerance_rad: self.following_tolerance_rad, ..settings })
    }

    fn validate(&self, field: &str) -> Result<(), BridgeError> {
        check_chunk(&format!("{field}.name"), &self.name)?;
        self.arm(field)?;
        check_name(&format!("{field}.joint_states"), &self.joint_states)?;
        check_name(&format!("{field}.trajectory_action"), &self.trajectory_action)?;
        self.gripper_action.iter().try_for_each(|action| check_name(&format!("{field}.gripper_action"), action))?;
        check_pose(&format!("{field}.world_from_base"), self.world_from_base.as_ref())?;
        within(&format!("{field}.gripper_position_per_width"), self.gripper_position_per_width, 0.01, 100.0)?;
        within(&format!("{field}.following_tolerance_rad"), self.following_tolerance_rad, 0.001, 1.0)?;
        within(&format!("{field}.controller_timeout_ms"), self.controller_timeout_ms as f64, 50.0, 60_000.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(toml: &str) -> Result<Ros2Config, String> {
        let config: Ros2Config = toml::from_str(toml).map_err(|e| e.to_string())?;
        config.validate().map(|()| config).map_err(|e| e.to_string())
    }

    const CAMERA: &str = "[[cameras]]\nname = \"front\"\ndepth = \"/cam/depth/image_raw\"\ninfo = \"/cam/depth/camera_info\"\n";

    #[test]
    fn the_example_is_a_configuration() {
        let example: toml::Table = include_str!("../../../deploy/ros2.toml").parse().expect("TOML");
        let config: Ros2Config = example["ros2"].clone().try_into().expect("a configuration");
        config.validate().expect("good values");
        assert_eq!((config.cameras.len(), config.robots.len()), (1, 1));
        assert_eq!(config.session, Ros2Config::default().session);
        // Those who follow it say no other cell to the services and commands.
        let cell = repose_runtime::RuntimeConfig::default().session.cell;
        assert_eq!(example["session"]["cell"].as_str(), Some(cell.as_str()));
    }

    #[test]
    fn topics_say_by_their_names_what_is_on_them() {
        let with = |rest: &str| config(&format!("[[cameras]]\nname = \"front\"\n{rest}")).expect("a configuration").cameras[0].clone();
        let cloud = with("cloud = \"/cam/points\"\n");
        assert_eq!((cloud.depth_source(), cloud.is_rectified()), (DepthSource::Cloud("/cam/points"), true));
        for (topic, is_packed) in [("/cam/depth", false), ("/cam/depth/compressedDepth", true), ("/cam/depth/compressed", true)] {
            let camera = with(&format!("depth = \"{topic}\"\ninfo = \"/cam/info\"\n"));
            let expected = if is_packed { DepthSource::Packed(topic) } else { DepthSource::Plain(topic) };
            assert_eq!(camera.depth_source(), expected);
        }
    }

    #[test]
    fn little_needs_to_be_said_and_what_is_wrong_is_named() {
        let robot = "[[robots]]\nname = \"panda\"\ntrajectory_action = \"/arm/follow_joint_trajectory\"\n";
        let good = config(&format!("{CAMERA}{robot}")).expect("a configuration");
        assert_eq!((good.cameras[0].tolerance_ms, good.cameras[0].is_rectified()), (17.0, false));
        assert_eq!((good.robots[0].model.as_str(), good.robots[0].joints[6].as_str()), ("panda", "panda_joint7"));
        for (wrong, field) in [
            (format!("{CAMERA}color = \"cam/color\"\n"), "cameras[0].color"),
            (format!("{CAMERA}{CAMERA}"), "cameras"),
            (format!("{CAMERA}colour = \"/cam/color\"\n"), "colour"),
            (format!("{CAMERA}cloud = \"/cam/points\"\n"), "cameras[0].depth"),
            (format!("{CAMERA}color = \"/cam/color/theora\"\n"), "/theora"),
            (format!("{CAMERA}color = \"/cam/depth/compressedDepth\"\n"), "cameras[0].color"),
            ("[[cameras]]\nname = \"front\"\n".to_owned(), "`cloud`"),
            ("[[cameras]]\nname = \"front\"\ndepth = \"/cam/depth\"\n".to_owned(), "cameras[0].info"),
            (format!("{robot}model = \"ur5\"\n"), "robots[0].model"),
            (format!("{robot}gripper_position_per_width = 0.0\n"), "robots[0].gripper_position_per_width"),
            ("node = \"my node\"\n".to_owned(), "node"),
        ] {
            let error = config(&wrong).expect_err("a refusal");
            assert!(error.contains(field), "{error}");
        }
    }
}
