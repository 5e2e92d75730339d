//! Where scenes come from.

use crate::arrange::ArrangeSettings;
use crate::furniture::{KindWeights, Table};
use crate::physics::{PhysicsSettings, RestSettings};

/// Where scenes come from, and what counts as one.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneSettings {
    /// How often each kind of scene is drawn.
    pub kinds: KindWeights,
    /// The table of kinds that stand on one.
    pub table: Table,
    /// What is put where before physics runs; each kind has its way with it.
    pub arrange: ArrangeSettings,
    /// The stepping.
    pub physics: PhysicsSettings,
    /// When the world counts as at rest.
    pub rest: RestSettings,
    /// Steps that rest is then watched for: a second at the usual step.
    pub watch_steps: usize,
    /// How far any point of an object may move while watched, metres.
    pub watch_limit_m: f64,
    /// Deepest overlap that is accepted, metres.
    pub max_penetration_m: f32,
    /// How hard the table is knocked to see what stands by luck only; `None`: not at all.
    pub knock: Option<KnockSettings>,
    /// Draws per seed before it is given up.
    pub max_attempts: u32,
}

/// A knock at the table, and what must survive it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnockSettings {
    /// How far gravity is tilted, towards a random side.
    pub tilt_rad: f32,
    /// For how many steps.
    pub steps: usize,
    /// Steps that are then waited for what topples to topple.
    pub wait_steps: usize,
    /// How far any point of an object may have moved then, metres.
    pub limit_m: f64,
}

impl Default for KnockSettings {
    fn default() -> Self {
        Self { tilt_rad: 0.026, steps: 48, wait_steps: 48, limit_m: 0.02 }
    }
}

impl Default for SceneSettings {
    fn default() -> Self {
        Self {
            kinds: KindWeights::training(),
            table: Table::default(),
            arrange: ArrangeSettings::default(),
            physics: PhysicsSettings::default(),
            rest: RestSettings::default(),
            watch_steps: 240,
            watch_limit_m: 0.001,
            max_penetration_m: 0.002,
            knock: Some(KnockSettings::default()),
            max_attempts: 30,
        }
    }
}

impl SceneSettings {
    /// The usual settings, for one kind only.
    pub fn only(kind: crate::furniture::SceneKind) -> Self {
        Self { kinds: KindWeights::only(kind), ..Self::default() }
    }
}
