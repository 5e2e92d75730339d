//! How an arm is driven.

use repose_panda::{CommandRuleSettings, Model, StopSettings};

/// How the arm is driven.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmSettings {
    /// What its state says that it is. Default: the Panda.
    pub model: Model,
    /// What set-points are checked against.
    pub rules: CommandRuleSettings,
    /// The share of the acceleration and jerk limits that a stop uses where there is room for it.
    pub gentle_share: f64,
    /// Set-points that are kept at most; a command that brings more, with those still to follow, is refused.
    pub max_set_points: usize,
    /// How far a measured joint may be from its set-point, radians. Default 0.1: set-points of a few radians a second and a servo that is some
    /// hundredths of a second behind.
    pub following_tolerance_rad: f64,
}

impl ArmSettings {
    /// Those of an arm of that model, under its official limits; none where there is no model of that name.
    pub fn of_model(name: &str) -> Option<Self> {
        let model = Model::parse(name)?;
        let rules = CommandRuleSettings { limits: model.limits(), ..CommandRuleSettings::default() };
        Some(Self { model, rules, ..Self::default() })
    }
}

impl Default for ArmSettings {
    fn default() -> Self {
        Self {
            model: Model::Panda,
            rules: CommandRuleSettings::default(),
            gentle_share: StopSettings::default().gentle_share,
            max_set_points: 100_000,
            following_tolerance_rad: 0.1,
        }
    }
}
