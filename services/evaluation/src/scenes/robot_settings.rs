//! How the robot's trials are run.

use repose_motion::{MotionConfig, config::ConfigError};
use repose_proto::CallError;
use repose_proto::place::{RegionBox, Variant};
use repose_sensor::SensorModel;
use repose_simulator::cell::CellSettings;
use repose_simulator::robot::{ArmSettings, HandSettings};

/// Attempts that `place --execute` makes unless it is told.
pub const DEFAULT_ATTEMPTS: usize = 3;

/// How a trial is run.
#[derive(Debug, Clone)]
pub struct RobotTrialSettings {
    /// The cell.
    pub cell: CellSettings,
    /// The depth sensor of the views between attempts.
    pub sensor: SensorModel,
    /// Attempts at most.
    pub attempts: usize,
    /// The arm's controller.
    pub arm: ArmSettings,
    /// The hand.
    pub hand: HandSettings,
    /// How motions are planned and what a plan says of them.
    pub motion: MotionConfig,
    /// Which method plans the placement.
    pub variant: Variant,
    /// Placements asked of the planner, for motion to choose from.
    pub count: u32,
    /// Where placements may be: what the arm reaches from above, world frame.
    pub region: RegionBox,
    /// How long an execution may take, seconds of robot time.
    pub longest_s: f64,
    /// How long the world may take to come to rest afterwards, seconds.
    pub rest_s: f64,
}

impl Default for RobotTrialSettings {
    fn default() -> Self {
        Self {
            cell: CellSettings::default(),
            sensor: SensorModel::default(),
            attempts: DEFAULT_ATTEMPTS,
            arm: ArmSettings::default(),
            hand: HandSettings::default(),
            motion: MotionConfig::default(),
            variant: Variant::default(),
            count: 5,
            region: RegionBox { min_m: [0.28, -0.42, -0.05], max_m: [0.78, 0.42, 0.7], inside: true },
            longest_s: 180.0,
            rest_s: 4.0,
        }
    }
}

/// A trial that could not be run at all.
#[derive(Debug, thiserror::Error)]
pub enum RobotTrialError {
    /// The planner refused the request.
    #[error(transparent)]
    Call(#[from] CallError),
    /// Motion's settings are out of range.
    #[error(transparent)]
    Config(#[from] ConfigError),
}
