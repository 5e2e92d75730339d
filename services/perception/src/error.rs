//! Why a frame gives no scene.

use repose_geometry::transform::NotRigid;
use repose_proto::limits::MAX_COORDINATE_M;
use repose_proto::{CallError, ErrorCode};

/// Why a frame gave no scene.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SegmentError {
    /// The frame contradicts itself.
    #[error(transparent)]
    Frame(CallError),
    /// The camera's pose is not a rigid transform.
    #[error("world_from_camera: {0}")]
    Pose(#[from] NotRigid),
    /// What the frame shows may lie farther from the world's origin than a scene's points may.
    #[error(
        "what it shows may lie {reach_m:.0} m from the world's origin, and a scene reaches {} m: is the camera's place in millimetres?",
        MAX_COORDINATE_M
    )]
    TooFar {
        /// How far from the origin it may lie, along one of the axes, metres.
        reach_m: f64,
    },
    /// No pixel has a depth within range.
    #[error("none of {pixels} pixels has a reading between 0 and {max_depth_m} m{}", nearest_in_words(*nearest_m))]
    NoReadings {
        /// Pixels of the frame.
        pixels: usize,
        /// The range that was allowed, metres.
        max_depth_m: f32,
        /// The nearest reading beyond it, metres.
        nearest_m: Option<f64>,
    },
    /// Every reading is of a robot, or of what it holds.
    #[error("all {readings} readings are of robots or of what they hold")]
    RobotsOnly {
        /// Readings before the robots were taken out.
        readings: usize,
    },
    /// Every reading lies in the band around some mask, or belongs to an object too small to be one.
    #[error("none of {readings} readings is left after cleaning {border_px} pixels around the borders of the labels")]
    NothingLeft {
        /// Readings before cleaning, those of robots not among them.
        readings: usize,
        /// Radius that was cleaned, pixels.
        border_px: usize,
    },
    /// The frame has no camera pose, and no plane could stand in for it.
    #[error(
        "the frame has no world_from_camera, and none of its planes can be the support (an upright camera above at least {share:.0} % of the readings)"
    )]
    NoSupport {
        /// Share of the readings that a support must hold, percent.
        share: f64,
    },
}

fn nearest_in_words(nearest_m: Option<f64>) -> String {
    nearest_m.map_or(String::new(), |m| format!("; the nearest is at {m:.1} m: is the camera's depth_unit_m metres per count?"))
}

impl From<SegmentError> for CallError {
    fn from(error: SegmentError) -> Self {
        let message = error.to_string();
        match error {
            SegmentError::Frame(error) => error,
            SegmentError::Pose(_) | SegmentError::TooFar { .. } => Self::invalid("world_from_camera", message),
            SegmentError::NoReadings { .. } => Self::invalid("depth", message),
            SegmentError::RobotsOnly { .. } => Self::invalid("robots", message),
            SegmentError::NothingLeft { .. } => Self::invalid("labels", message),
            SegmentError::NoSupport { .. } => Self::new(ErrorCode::FailedPrecondition, message).at("world_from_camera"),
        }
    }
}
