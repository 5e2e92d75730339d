//! When the arm is where on its path: the fastest timing that provably keeps the velocity and acceleration limits.
//!
//! The rounded path is cut into short intervals. On each the squared path speed is linear in the path parameter (constant path acceleration),
//! bounded by what the joints allow there: `|q'|·ṡ ≤ v`, and `|q''|·ṡ² + |q'|·|s̈| ≤ a`. A pass forwards and one backwards make the speeds
//! reachable from rest to rest. All bounds hold over whole intervals, so they hold at every instant and not only where it is sampled.

use repose_panda::{JOINT_COUNT, JointLimits, Joints, LIMITS};

use crate::blend::{Piece, blended};

/// How fast the arm may go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimingSettings {
    /// The robot's limits.
    pub limits: JointLimits,
    /// Share of the velocity limits that is used, above 0 to 1. Default 0.5.
    pub velocity_scale: f64,
    /// Share of the acceleration limits that is used, above 0 to 1. Default 0.25.
    pub acceleration_scale: f64,
    /// How far the path may leave its corners when it rounds them, radians. Larger is faster; the caller checks the rounded path.
    /// Default 0.03.
    pub deviation_rad: f64,
}

impl Default for TimingSettings {
    fn default() -> Self {
        Self { limits: LIMITS, velocity_scale: 0.5, acceleration_scale: 0.25, deviation_rad: 0.03 }
    }
}

impl TimingSettings {
    /// The same with a share of the speed and the acceleration.
    #[must_use]
    pub fn slowed(&self, share: f64) -> Self {
        Self { velocity_scale: self.velocity_scale * share, acceleration_scale: self.acceleration_scale * share, ..*self }
    }
}

/// Intervals are at most this long in path parameter, radians.
const INTERVAL_RAD: f64 = 0.02;
/// Share of the acceleration that a curve may use for turning; the rest is left for braking on it.
const TURNING_SHARE: f64 = 0.7;

/// Where, how fast and with what acceleration the arm goes at an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrajectoryPoint {
    /// Joint angles, radians.
    pub position_rad: Joints,
    /// Joint rates, radians per second.
    pub velocity_rad_s: Joints,
    /// Joint accelerations, radians per second squared.
    pub acceleration_rad_s2: Joints,
}

/// A path with its timing; starts and ends at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    intervals: Vec<Interval>,
    end: Joints,
    duration_s: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Interval {
    piece: Piece,
    /// Where on the piece the interval begins.
    offset: f64,
    start_s: f64,
    speed: f64,
    acceleration: f64,
}

impl Trajectory {
    /// The timed path through `corners` (at least one).
    pub fn new(corners: &[Joints], settings: &TimingSettings) -> Option<Self> {
        let end = *corners.last()?;
        let pieces = blended(corners, settings.deviation_rad);
        let cuts = cut(&pieces, settings);
        let squares = reachable_squares(&cuts);
        let mut start_s = 0.0;
        let mut intervals = Vec::with_capacity(cuts.len());
        for (cut, w) in cuts.iter().zip(squares.windows(2)) {
            let (speed, next) = (w[0].sqrt(), w[1].sqrt());
            let acceleration = (w[1] - w[0]) / (2.0 * cut.length);
            intervals.push(Interval { piece: cut.piece, offset: cut.offset, start_s, speed, acceleration });
            start_s += 2.0 * cut.length / (speed + next);
        }
        Some(Self { intervals, end, duration_s: start_s })
    }

    /// How long it takes, seconds.
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// The last configuration.
    pub fn end(&self) -> &Joints {
        &self.end
    }

    /// The state at `time_s`; at rest at the end from [`Self::duration_s`] on.
    pub fn at(&self, time_s: f64) -> TrajectoryPoint {
        let rest = TrajectoryPoint { position_rad: self.end, velocity_rad_s: [0.0; JOINT_COUNT], acceleration_rad_s2: [0.0; JOINT_COUNT] };
        if time_s >= self.duration_s {
            return rest;
        }
        let after = self.intervals.partition_point(|i| i.start_s <= time_s.max(0.0));
        let Some(interval) = after.checked_sub(1).and_then(|k| self.intervals.get(k)) else { return rest };
        let t = time_s.max(0.0) - interval.start_s;
        let s = interval.offset + t * (interval.speed + 0.5 * t * interval.acceleration);
        let rate = interval.speed + t * interval.acceleration;
        let (tangent, curvature) = (interval.piece.derivative(s), interval.piece.curvature);
        TrajectoryPoint {
            position_rad: interval.piece.at(s),
            velocity_rad_s: tangent.map(|d| d * rate),
            acceleration_rad_s2: std::array::from_fn(|i| curvature[i] * rate * rate + tangent[i] * interval.acceleration),
        }
    }

    /// The states at equal steps of at most `period_s`, from 0 to the end, both included.
    pub fn sampled(&self, period_s: f64) -> impl Iterator<Item = (f64, TrajectoryPoint)> + '_ {
        let steps = (self.duration_s / period_s).ceil().max(1.0) as usize;
        let last = if self.duration_s > 0.0 { steps } else { 0 };
        (0..=last).map(move |k| self.duration_s * k as f64 / steps as f64).map(|t| (t, self.at(t)))
    }
}

/// An interval before its timing is known.
struct Cut {
    piece: Piece,
    offset: f64,
    length: f64,
    /// Highest squared path speed anywhere on it.
    square_max: f64,
    /// Highest path acceleration at any speed up to that.
    acceleration_max: f64,
}

fn cut(pieces: &[Piece], settings: &TimingSettings) -> Vec<Cut> {
    let mut cuts = Vec::new();
    for piece in pieces {
        // Two at least, so that even a single straight piece has a node between its two rests.
        let count = (piece.length / INTERVAL_RAD).ceil().max(2.0) as usize;
        let length = piece.length / count as f64;
        for k in 0..count {
            let offset = k as f64 * length;
            let (first, last) = (piece.derivative(offset), piece.derivative(offset + length));
            let (mut square_max, mut acceleration_max) = (f64::INFINITY, f64::INFINITY);
            // The derivative is linear on a piece: its largest value is at an end.
            let slope: Joints = std::array::from_fn(|i| first[i].abs().max(last[i].abs()).max(1e-12));
            for (i, slope) in slope.iter().enumerate() {
                let velocity = settings.limits.velocity_rad_s[i] * settings.velocity_scale;
                let acceleration = settings.limits.acceleration_rad_s2[i] * settings.acceleration_scale;
                square_max = square_max.min((velocity / slope).powi(2));
                square_max = square_max.min(TURNING_SHARE * acceleration / piece.curvature[i].abs().max(1e-12));
            }
            for (i, slope) in slope.iter().enumerate() {
                let acceleration = settings.limits.acceleration_rad_s2[i] * settings.acceleration_scale;
                acceleration_max = acceleration_max.min((acceleration - piece.curvature[i].abs() * square_max) / slope);
            }
            cuts.push(Cut { piece: *piece, offset, length, square_max, acceleration_max });
        }
    }
    cuts
}

/// Squared path speeds at the nodes between the cuts, from rest to rest.
fn reachable_squares(cuts: &[Cut]) -> Vec<f64> {
    let mut squares = vec![0.0; cuts.len() + 1];
    for k in 1..cuts.len() {
        let allowed = cuts[k - 1].square_max.min(cuts[k].square_max);
        squares[k] = allowed.min(squares[k - 1] + 2.0 * cuts[k - 1].length * cuts[k - 1].acceleration_max);
    }
    for k in (0..cuts.len()).rev() {
        squares[k] = squares[k].min(squares[k + 1] + 2.0 * cuts[k].length * cuts[k].acceleration_max);
    }
    squares
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use repose_panda::{CommandRuleSettings, CommandRules, READY};

    fn corners() -> impl Strategy<Value = Vec<Joints>> {
        prop::collection::vec(prop::array::uniform7(0.0..1.0f64).prop_map(|u| LIMITS.between(&u)), 1..6)
    }

    proptest! {
        #[test]
        fn velocity_and_acceleration_limits_hold_at_every_millisecond(corners in corners(), scale in 0.1..1.0f64, deviation in 0.0..0.2f64) {
            let settings =
                TimingSettings { velocity_scale: scale, acceleration_scale: scale, deviation_rad: deviation.max(1e-4), ..TimingSettings::default() };
            let trajectory = Trajectory::new(&corners, &settings).unwrap();
            for (_, point) in trajectory.sampled(1e-3) {
                for i in 0..JOINT_COUNT {
                    prop_assert!(point.velocity_rad_s[i].abs() <= settings.limits.velocity_rad_s[i] * scale * (1.0 + 1e-9));
                    prop_assert!(point.acceleration_rad_s2[i].abs() <= settings.limits.acceleration_rad_s2[i] * scale * (1.0 + 1e-9));
                }
            }
        }

        #[test]
        fn frankas_rules_accept_the_sampled_trajectory(corners in corners()) {
            let trajectory = Trajectory::new(&corners, &TimingSettings { velocity_scale: 1.0, acceleration_scale: 1.0, ..TimingSettings::default() }).unwrap();
            let count = (trajectory.duration_s() / 1e-3) as usize + 3;
            let points: Vec<Joints> = (0..count).map(|k| trajectory.at(k as f64 * 1e-3).position_rad).collect();
            prop_assert_eq!(CommandRules::check(&corners[0], &points, CommandRuleSettings::default()), Ok(()));
        }

        #[test]
        fn it_goes_from_the_first_corner_to_the_last_at_rest_at_both_ends(corners in corners()) {
            let trajectory = Trajectory::new(&corners, &TimingSettings::default()).unwrap();
            let (start, end) = (trajectory.at(0.0), trajectory.at(trajectory.duration_s() + 1.0));
            prop_assert_eq!(end.position_rad, corners[corners.len() - 1]);
            prop_assert!((0..JOINT_COUNT).all(|i| (start.position_rad[i] - corners[0][i]).abs() < 1e-9 && start.velocity_rad_s[i] == 0.0));
        }
    }

    #[test]
    fn one_joint_over_a_long_way_reaches_its_top_speed() {
        let mut end = READY;
        end[0] += 2.0;
        let trajectory = Trajectory::new(&[READY, end], &TimingSettings::default()).unwrap();
        let (v, a) = (2.175 * 0.5, 15.0 * 0.25);
        let expected = 2.0 / v + v / a;
        assert!((trajectory.duration_s() - expected).abs() < 0.02, "{} against {expected}", trajectory.duration_s());
    }

    #[test]
    fn a_single_corner_takes_no_time() {
        let trajectory = Trajectory::new(&[READY], &TimingSettings::default()).unwrap();
        assert_eq!((trajectory.duration_s(), trajectory.at(0.0).position_rad), (0.0, READY));
        assert_eq!(Trajectory::new(&[], &TimingSettings::default()), None);
    }
}
