//! The driver's configuration, section `[franka]`: every field with its unit, its default, and what raising it does. Unknown fields are refused,
//! and what protects people has no default.

use std::time::Duration;

use franka::RealtimeConfig;
use repose_panda::{CommandRuleSettings, Model};
use repose_proto::{RigidTransform, keys};
use repose_robot_side::ArmSettings;
use serde::Deserialize;

use crate::error::DriverError;
use crate::robot::connection::{CollisionThresholds, ConnectSettings};
use crate::robot::gripper::HandSettings;
use crate::robot::side::SideSettings;

/// Configuration of a driver process.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrankaConfig {
    /// The robot's address on its network, `HOST` or `HOST:PORT`; port 1337 without one. No default.
    pub address: String,
    /// The robot's model, `panda` (FCI 5) or `fr3` (FCI 10); a robot that is another one is not driven. No default.
    pub model: String,
    /// From which torque at a joint on the robot takes a touch for a collision and stops, newton metres, joint 1 first. Raising it lets the arm
    /// push harder before it stops. No default.
    pub collision_torque_nm: [f64; 7],
    /// The same at the hand: forces along x, y, z (newtons) and torques about them (newton metres). No default.
    pub collision_force_n: [f64; 6],
    /// The most that the hand presses with, whatever is commanded, newtons, up to 70. Raising it lets it hold heavier things and pinch harder.
    /// No default.
    pub max_grip_force_n: f64,
    /// How far a measured joint may be from its set-point before the arm counts as not following, and stops, radians. Raising it lets the arm
    /// be pushed further off its way. No default.
    pub following_tolerance_rad: f64,
    /// The robot's name in the cell, a chunk of a key. Default `panda`: the name that commands assume.
    #[serde(default = "name")]
    pub name: String,
    /// Where the robot's base stands in the world: 16 numbers, row-major. Default: not said; others then use what they are configured to.
    #[serde(default)]
    pub world_from_base: Option<RigidTransform>,
    /// Whether there is a Franka Hand. Default true.
    #[serde(default = "yes")]
    pub hand: bool,
    /// The hand's address, `HOST` or `HOST:PORT`; port 1338 without one. Default: the robot's host.
    #[serde(default)]
    pub hand_address: Option<String>,
    /// How fast the fingers move, m/s, up to 0.1. Default 0.05; faster grasps strike harder.
    #[serde(default = "hand_speed_m_s")]
    pub hand_speed_m_s: f64,
    /// Whether the hand finds its widest opening at the start, as it has to once after it was switched on: the fingers close and open, and
    /// whatever they hold falls. Default false.
    #[serde(default)]
    pub hand_homes: bool,
    /// `prefer`: where there is no kernel or no priority for real time, the driver says so and goes on, and the robot may stop with
    /// `communication_constraints_violation`. `require`: it ends then; what a robot that works should have. Default `prefer`.
    #[serde(default)]
    pub realtime: Realtime,
    /// The processor core that the control loop keeps to. Default: any.
    #[serde(default)]
    pub cpu: Option<usize>,
    /// Between two states, milliseconds, 5 to 100. Default 20; longer spares the network, and whoever plans sees the arm later.
    #[serde(default = "state_period_ms")]
    pub state_period_ms: u64,
}

/// What is demanded of the machine.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Realtime {
    /// A kernel and a priority for real time.
    Require,
    /// The same where they are to be had.
    #[default]
    Prefer,
}

fn name() -> String {
    "panda".to_owned()
}

fn yes() -> bool {
    true
}

fn hand_speed_m_s() -> f64 {
    0.05
}

fn state_period_ms() -> u64 {
    20
}

impl FrankaConfig {
    /// Checks names and ranges.
    ///
    /// # Errors
    /// [`DriverError::Config`] that names the field.
    pub fn validate(&self) -> Result<(), DriverError> {
        keys::validate_chunk("name", &self.name).map_err(|e| refused("name", e.message))?;
        check_address("address", &self.address)?;
        self.hand_address.as_ref().map_or(Ok(()), |address| check_address("hand_address", address))?;
        self.model()?;
        if let Some(pose) = &self.world_from_base {
            pose.validate("world_from_base").map_err(|e| refused("world_from_base", e.message))?;
        }
        self.collision_torque_nm.iter().try_for_each(|torque_nm| within("collision_torque_nm", *torque_nm, 1.0, 100.0))?;
        self.collision_force_n.iter().try_for_each(|force_n| within("collision_force_n", *force_n, 1.0, 150.0))?;
        within("max_grip_force_n", self.max_grip_force_n, 1.0, 70.0)?;
        within("following_tolerance_rad", self.following_tolerance_rad, 0.001, 0.5)?;
        within("hand_speed_m_s", self.hand_speed_m_s, 0.001, 0.1)?;
        within("state_period_ms", self.state_period_ms as f64, 5.0, 100.0)
    }

    /// The robot's model.
    ///
    /// # Errors
    /// [`DriverError::Config`] when there is none of that name.
    pub fn model(&self) -> Result<Model, DriverError> {
        Model::parse(&self.model).ok_or_else(|| refused("model", format!("expected panda or fr3, got {:?}", self.model)))
    }

    /// How to reach the robot.
    ///
    /// # Errors
    /// As [`Self::model`].
    pub fn connect(&self) -> Result<ConnectSettings, DriverError> {
        let realtime = match self.realtime {
            Realtime::Require => RealtimeConfig::Enforce,
            Realtime::Prefer => RealtimeConfig::Ignore,
        };
        let collision = CollisionThresholds { torque_nm: self.collision_torque_nm, force_n: self.collision_force_n };
        Ok(ConnectSettings { address: self.address.clone(), model: self.model()?, realtime, collision })
    }

    /// The arm's rules.
    ///
    /// # Errors
    /// As [`Self::model`].
    pub fn side(&self) -> Result<SideSettings, DriverError> {
        let model = self.model()?;
        let rules = CommandRuleSettings { limits: model.commanded_limits(), ..CommandRuleSettings::default() };
        let arm = ArmSettings { model, rules, following_tolerance_rad: self.following_tolerance_rad, ..ArmSettings::default() };
        Ok(SideSettings { arm, max_grip_force_n: self.max_grip_force_n, has_hand: self.hand, world_from_base: self.world_from_base })
    }

    /// How to reach the hand, where there is one.
    pub fn hand(&self) -> Option<HandSettings> {
        let host = || self.address.split(':').next().unwrap_or_default().to_owned();
        let address = self.hand_address.clone().unwrap_or_else(host);
        self.hand.then_some(HandSettings { address, speed_m_s: self.hand_speed_m_s, homes: self.hand_homes })
    }

    /// Between two states.
    pub fn state_period(&self) -> Duration {
        Duration::from_millis(self.state_period_ms)
    }
}

fn refused(field: &'static str, message: String) -> DriverError {
    DriverError::Config { field, message }
}

fn check_address(field: &'static str, address: &str) -> Result<(), DriverError> {
    let (host, port) = address.split_once(':').map_or((address, None), |(host, port)| (host, Some(port)));
    let is_host = !host.is_empty() && host.chars().all(|c| c.is_ascii_alphanumeric() || ['.', '-'].contains(&c));
    if is_host && port.is_none_or(|port| port.parse::<u16>().is_ok_and(|port| port > 0)) {
        return Ok(());
    }
    Err(refused(field, format!("expected HOST or HOST:PORT, got {address:?}")))
}

fn within(field: &'static str, value: f64, low: f64, high: f64) -> Result<(), DriverError> {
    if (low..=high).contains(&value) { Ok(()) } else { Err(refused(field, format!("expected {low} to {high}, got {value}"))) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEAST: &str = "address = \"172.16.0.2\"\nmodel = \"fr3\"\ncollision_torque_nm = [20, 20, 18, 18, 16, 14, 12]\n\
        collision_force_n = [20, 20, 20, 25, 25, 25]\nmax_grip_force_n = 40\nfollowing_tolerance_rad = 0.1\n";

    fn config(toml: &str) -> Result<FrankaConfig, String> {
        let config: FrankaConfig = toml::from_str(toml).map_err(|e| e.to_string())?;
        config.validate().map(|()| config).map_err(|e| e.to_string())
    }

    #[test]
    fn the_example_is_a_configuration_and_says_every_field() {
        let text = include_str!("../../../deploy/franka.toml");
        // Fields without a value of their own stand there commented out.
        let lines = text.lines().map(|line| {
            line.strip_prefix("# ")
                .filter(|rest| rest.starts_with(|c: char| c.is_ascii_lowercase()) && rest.contains(" = "))
                .unwrap_or(line)
        });
        for (text, whole) in [(text.to_owned(), false), (lines.collect::<Vec<_>>().join("\n"), true)] {
            let example: toml::Table = text.parse().expect("TOML");
            let section = example["franka"].as_table().expect("a section").clone();
            let config: FrankaConfig = section.clone().try_into().expect("a configuration");
            config.validate().expect("good values");
            let unknown = toml::from_str::<FrankaConfig>("no_such_field = 0").expect_err("a refusal").to_string();
            let fields = unknown.split('`').skip(1).step_by(2).filter(|name| *name != "no_such_field");
            assert!(!whole || fields.clone().count() > 10 && fields.clone().all(|field| section.contains_key(field)), "{unknown}");
        }
    }

    #[test]
    fn little_needs_to_be_said_and_what_protects_people_does() {
        let good = config(LEAST).expect("a configuration");
        assert_eq!(
            (good.name.as_str(), good.realtime, good.hand().expect("a hand").address.as_str()),
            ("panda", Realtime::Prefer, "172.16.0.2")
        );
        assert_eq!(good.side().expect("a model").arm.rules.limits, Model::Fr3.commanded_limits());
        for line in LEAST.lines() {
            let field = line.split(' ').next().expect("a field");
            let without: Vec<&str> = LEAST.lines().filter(|other| *other != line).collect();
            let error = config(&without.join("\n")).expect_err("a refusal");
            assert!(error.contains("missing field") && error.contains(field), "{error}");
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (from, to, field) in [
            ("fr3", "fr4", "model"),
            ("172.16.0.2", "172.16.0.2:0", "address"),
            ("172.16.0.2", "tcp/172.16.0.2", "address"),
            ("40", "200", "max_grip_force_n"),
            ("0.1", "3.0", "following_tolerance_rad"),
            ("[20, 20, 20,", "[0, 20, 20,", "collision_force_n"),
        ] {
            let error = config(&LEAST.replacen(from, to, 1)).expect_err("a refusal");
            assert!(error.contains(field), "{error}");
        }
        assert!(config(&format!("{LEAST}grip = 3\n")).expect_err("a refusal").contains("grip"));
    }
}
