//! The simplest motion that a commander can send.

use repose_panda::{Joints, smooth_step};
use repose_proto::robot::SetPoint;

/// How far apart its set-points are, milliseconds.
const PERIOD_MS: f64 = 10.0;

/// The set-points of a straight way between two configurations (radians), at rest at both ends, in so many milliseconds; the first at 0. It knows
/// no limits: whoever sends it chooses the time.
pub fn straight_way(from: &Joints, to: &Joints, span_ms: f64) -> Vec<SetPoint> {
    let steps = (span_ms / PERIOD_MS).ceil().max(1.0);
    let point = |k: usize| {
        let s = k as f64 / steps;
        // The derivative of the smooth step.
        let rate_1_s = 30.0 * s * s * (1.0 - s) * (1.0 - s) / (span_ms * 1e-3);
        SetPoint {
            t_ms: s * span_ms,
            q_rad: std::array::from_fn(|i| from[i] + smooth_step(s) * (to[i] - from[i])),
            dq_rad_s: std::array::from_fn(|i| rate_1_s * (to[i] - from[i])),
        }
    };
    (0..=steps as usize).map(point).collect()
}
