//! Coming to rest on the way: what is left of a stretch, slowed down on the same path until the arm stands.
//!
//! Path time runs slower and slower (its rate falls from 1 to 0 along a quintic), so the arm leaves the checked path by nothing and its own
//! accelerations only shrink; what slowing adds is kept to a share of the limits by taking the time it needs.

use repose_panda::{JOINT_COUNT, JointLimits, hermite, smooth_step};
use repose_proto::robot::SetPoint;

/// Share of the acceleration limits that slowing down may add.
const BRAKING_SHARE: f64 = 0.35;
/// Shortest time that slowing down takes, milliseconds.
const SHORTEST_MS: f64 = 200.0;
/// Time between its set-points, milliseconds.
const PERIOD_MS: f64 = 10.0;
/// Steepest fall of the quintic over its unit interval.
const STEEPEST: f64 = 1.875;

/// The set-points from `from_ms` of a stretch on that bring it to rest; the stretch itself where that ends sooner. Empty without set-points.
pub fn halted(stretch: &[SetPoint], from_ms: f64, limits: &JointLimits) -> Vec<SetPoint> {
    let Some(end) = stretch.last() else { return Vec::new() };
    let rest = &stretch[stretch.partition_point(|p| p.t_ms < from_ms)..];
    let start = at(stretch, from_ms.min(end.t_ms));
    let needed_ms = |p: &SetPoint| {
        let slowest = |i: usize| 1e3 * STEEPEST * p.dq_rad_s[i].abs() / (BRAKING_SHARE * limits.acceleration_rad_s2[i]);
        (0..JOINT_COUNT).map(slowest).fold(SHORTEST_MS, f64::max)
    };
    let span_ms = rest.iter().chain([&start]).map(needed_ms).fold(SHORTEST_MS, f64::max);
    if start.t_ms + 0.5 * span_ms >= end.t_ms {
        return std::iter::once(start).chain(rest.iter().filter(|p| p.t_ms > start.t_ms).copied()).collect();
    }
    let steps = (span_ms / PERIOD_MS).ceil();
    let point = |k: usize| {
        let s = k as f64 / steps;
        let rate = 1.0 - smooth_step(s);
        let path_ms = start.t_ms + span_ms * (s - s.powi(4) * (2.5 - 3.0 * s + s * s));
        let on_path = at(stretch, path_ms);
        SetPoint { t_ms: start.t_ms + span_ms * s, q_rad: on_path.q_rad, dq_rad_s: on_path.dq_rad_s.map(|v| v * rate) }
    };
    (0..=steps as usize).map(point).collect()
}

/// Where a stretch is at a time within it: cubic Hermite interpolation, as the robot's side does it.
fn at(stretch: &[SetPoint], t_ms: f64) -> SetPoint {
    let next = stretch.partition_point(|p| p.t_ms <= t_ms).clamp(1, stretch.len().max(2) - 1);
    let (Some(a), Some(b)) = (stretch.get(next - 1), stretch.get(next)) else { return stretch[0] };
    let span_s = (b.t_ms - a.t_ms) * 1e-3;
    let s = ((t_ms - a.t_ms) / (b.t_ms - a.t_ms)).clamp(0.0, 1.0);
    let (q_rad, dq_rad_s) = hermite((&a.q_rad, &a.dq_rad_s), (&b.q_rad, &b.dq_rad_s), span_s, s);
    SetPoint { t_ms, q_rad, dq_rad_s }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use repose_panda::{CommandRuleSettings, CommandRules, FR3_LIMITS, LIMITS, READY};

    use super::*;

    /// Joint 0 from rest over 1.2 rad and back to rest in 2 s.
    fn stretch() -> Vec<SetPoint> {
        let point = |k: usize| {
            let s = k as f64 / 100.0;
            let mut point = SetPoint { t_ms: 20.0 * k as f64, q_rad: READY, dq_rad_s: [0.0; 7] };
            point.q_rad[0] += 1.2 * s * s * s * (10.0 - 15.0 * s + 6.0 * s * s);
            point.dq_rad_s[0] = 0.6 * 30.0 * s * s * (1.0 - s) * (1.0 - s);
            point
        };
        (0..=100).map(point).collect()
    }

    proptest! {
        #[test]
        fn wherever_it_is_cut_off_it_comes_to_rest_on_its_path_within_the_limits(
            from_ms in 0.0..2200.0f64, limits in prop_oneof![Just(LIMITS), Just(FR3_LIMITS)],
        ) {
            let whole = stretch();
            let halt = halted(&whole, from_ms, &limits);
            let mut followed: Vec<SetPoint> = whole.iter().filter(|p| p.t_ms < halt[0].t_ms).copied().collect();
            followed.extend(&halt);
            let end = followed[followed.len() - 1];
            prop_assert!(end.dq_rad_s.iter().all(|v| v.abs() < 1e-9) && end.t_ms <= 3200.0);
            prop_assert!(end.q_rad[0] <= READY[0] + 1.2 + 1e-9);
            let sampled: Vec<_> = (0..=end.t_ms.ceil() as usize).map(|t| at(&followed, t as f64).q_rad).collect();
            prop_assert_eq!(CommandRules::check(&READY, &sampled, CommandRuleSettings { limits, ..CommandRuleSettings::default() }), Ok(()));
            // Interpolation between set-points of a path that comes to rest may overshoot by a hair.
            prop_assert!(sampled.windows(2).all(|w| w[1][0] >= w[0][0] - 1e-6), "never back");
        }
    }
}
