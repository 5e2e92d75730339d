//! The gripper that grasps are measured with.

use repose_panda::FINGER_OPENING_MAX_M;

/// The gripper's sizes and margins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GripperSettings {
    /// Half the width of a finger across (along x), metres. Default 0.0105.
    pub finger_half_width_m: f64,
    /// How thick a finger is along the closing direction, metres. Default 0.022.
    pub finger_thickness_m: f64,
    /// Room between the object as it is believed to be and each open finger, metres. Default 0.011.
    pub clearance_m: f64,
    /// The same where something stands beside the object, metres. Default 0.005.
    pub clearance_beside_m: f64,
    /// The least room where the opening allows no more, metres. Default 0.003.
    pub clearance_min_m: f64,
    /// How much of the object is missing at a border of what was seen of it, as borders are cleaned away, pixels of the camera's picture. Default 2.5,
    /// as for what is believed of a scene: 5 mm at 1.2 m from a camera with a focal length of 600 pixels.
    pub border_px: f32,
    /// Points between the pads that make a grasp. Default 6.
    pub points_min: usize,
    /// Room for the finger that was seen to have some, where the other has not, metres. Default 0.006.
    pub clearance_seen_m: f64,
    /// Share of a finger that must be seen to be in free space to count as seen. Default 0.6.
    pub seen_min: f64,
    /// How deep points may be inside the palm, metres: the sensor's noise. Default 0.004.
    pub palm_slack_m: f64,
    /// Stray points that are tolerated inside a finger or the palm. Default 2.
    pub strays: usize,
}

impl Default for GripperSettings {
    fn default() -> Self {
        Self {
            finger_half_width_m: 0.0105,
            finger_thickness_m: 0.022,
            clearance_m: 0.011,
            clearance_beside_m: 0.005,
            clearance_min_m: 0.003,
            border_px: 2.5,
            points_min: 6,
            clearance_seen_m: 0.006,
            seen_min: 0.6,
            palm_slack_m: 0.004,
            strays: 2,
        }
    }
}

impl GripperSettings {
    /// The widest thing that the fingers close on, metres: it leaves the least room on both sides of the wholly open hand.
    pub fn widest_m(&self) -> f64 {
        FINGER_OPENING_MAX_M - 2.0 * self.clearance_min_m
    }
}
