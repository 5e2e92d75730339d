//! Coming to rest on the way: what is left of a stretch, slowed down on the same path until the arm stands.
//!
//! Path time runs slower and slower (its rate falls from 1 to 0 along a quintic), so the arm leaves the checked path by nothing and its own
//! accelerations only shrink; what slowing adds is kept to a share of the limits by taking the time it needs.

use repose_panda::{JOINT_COUNT, JointLimits, hermite, smooth_step};
use repose_proto::robot::{RobotCommand, SetPoint};

use super::{Execution, ExecutionAction, Taken};

/// Share of the acceleration limits that slowing down may add.
const BRAKING_SHARE: f64 = 0.35;
/// Shortest time that slowing down takes, milliseconds.
const SHORTEST_MS: f64 = 200.0;
/// Time between its set-points, milliseconds.
const PERIOD_MS: f64 = 10.0;
/// Steepest fall of the quintic over its unit interval.
const STEEPEST: f64 = 1.875;

/// A cancelled stream on its way to rest.
#[derive(Debug, Clone)]
pub(super) struct Halt {
    reason: String,
    set_points: Vec<SetPoint>,
    first_seq: u64,
    since_ms: u64,
}

impl Halt {
    /// The first command that says how it comes to rest.
    pub(super) fn first_seq(&self) -> u64 {
        self.first_seq
    }
}

impl Execution {
    /// Slows the current stream down until the arm stands.
    pub(super) fn begin_halt(&mut self, reason: &str, taken: Taken, now_ms: u64) -> Vec<ExecutionAction> {
        let set_points = self.way_to_rest(taken, now_ms);
        self.halt = Some(Halt { reason: reason.to_owned(), set_points, first_seq: self.seq + 1, since_ms: now_ms });
        self.go_on_halting(now_ms)
    }

    /// The current stream from where the robot was last seen on it, slowed down from ahead of where it may be by now: it went on while its states
    /// were late or lost. What lies between goes along, for not all of it may have come.
    fn way_to_rest(&self, taken: Taken, now_ms: u64) -> Vec<SetPoint> {
        let (shown_ms, since_ms) = match self.is_taken(taken.first_seq) {
            true => (self.last_state.stream_ms.unwrap_or(0.0), self.last_state_ms),
            false => (0.0, taken.sent_at_ms),
        };
        // Further than the horizon it has nothing to follow.
        let gone_on_ms = (now_ms.saturating_sub(since_ms) as f64).min(self.settings.horizon_ms);
        let stream = &self.current().set_points;
        let halt = halted(stream, shown_ms + gone_on_ms + self.halt_lead_ms(), &self.settings.model.driven_limits());
        let first = stream.partition_point(|p| p.t_ms <= shown_ms).saturating_sub(1);
        let before = stream[first..].iter().take_while(|p| halt.first().is_some_and(|slows| p.t_ms < slows.t_ms));
        before.copied().chain(halt.iter().copied()).collect()
    }

    /// Sends the way to rest again while it may have been lost and can still be followed; gives up when the robot should long stand.
    pub(super) fn go_on_halting(&mut self, now_ms: u64) -> Vec<ExecutionAction> {
        let Some(halt) = &self.halt else { return Vec::new() };
        let waited_ms = now_ms.saturating_sub(halt.since_ms) as f64;
        let longest_ms = halt.set_points.last().map_or(0.0, |p| p.t_ms) + self.settings.lag_ms;
        if waited_ms > longest_ms {
            return self.end_halt(now_ms);
        }
        if self.is_taken(halt.first_seq) || waited_ms >= self.halt_lead_ms() {
            return self.kept_alive();
        }
        let set_points = halt.set_points.clone();
        vec![ExecutionAction::Send(RobotCommand { set_points, ends_stream: true, ..self.command() })]
    }

    /// How far ahead of the robot slowing down begins, milliseconds of robot time.
    fn halt_lead_ms(&self) -> f64 {
        match self.last_state.horizon_ms {
            Some(_) => self.settings.whole_halt_lead_ms,
            None => self.settings.halt_lead_ms,
        }
    }

    pub(super) fn end_halt(&mut self, now_ms: u64) -> Vec<ExecutionAction> {
        let reason = self.halt.as_ref().map(|halt| halt.reason.clone()).unwrap_or_default();
        self.end_on_the_way(reason, now_ms)
    }
}

/// The set-points from `from_ms` of a stretch on that bring it to rest; the stretch itself where that ends sooner. Empty without set-points.
fn halted(stretch: &[SetPoint], from_ms: f64, limits: &JointLimits) -> Vec<SetPoint> {
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
