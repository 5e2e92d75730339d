//! Room for what a robot is off the arm's way.
//!
//! A robot takes its joints as they are when a motion ends, a few milliradians from where they were sent. The next motion begins there, and the
//! difference fades out beside it; so does what it is off after set-points that it missed. A driver leaves room for that in what it carries out, and
//! who plans for the arm keeps within the rest: set-points that a driver refuses stop the arm on its way.

use crate::limits::{ApproachLimits, JointLimits};

/// How far the robot may hold a joint from where the arm stands until the arm stands there, radians: further, somebody has moved it.
pub const HELD_OFF_RAD: f64 = 0.005;
/// How long that takes to fade out, milliseconds.
pub const FADE_MS: f64 = 500.0;
/// The share of the joints' limits that there is always room for in a fade beside the arm's own motion.
pub const BESIDE_SHARE: f64 = 0.005;

/// The limits less what an offset that fades out adds to set-points: the quintic's steepest places.
#[must_use]
pub fn with_room_to_fade(limits: &JointLimits) -> JointLimits {
    let fade_s = FADE_MS * 1e-3;
    let speed = 1.875 * HELD_OFF_RAD / fade_s;
    JointLimits {
        position_lower_rad: limits.position_lower_rad.map(|q| q + HELD_OFF_RAD),
        position_upper_rad: limits.position_upper_rad.map(|q| q - HELD_OFF_RAD),
        velocity_rad_s: limits.velocity_rad_s.map(|v| v - speed),
        approach: limits
            .approach
            .map(|approach| ApproachLimits { offset_rad_s: approach.offset_rad_s.map(|offset| offset + speed), ..approach }),
        acceleration_rad_s2: limits.acceleration_rad_s2.map(|a| a - 5.774 * HELD_OFF_RAD / fade_s.powi(2)),
        jerk_rad_s3: limits.jerk_rad_s3.map(|j| j - (60.0 * HELD_OFF_RAD / fade_s.powi(3)).max(BESIDE_SHARE * j)),
    }
}
