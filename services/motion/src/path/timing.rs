//! When the arm is where on its path: a fast timing that provably keeps the velocity, acceleration and jerk limits.
//!
//! The rounded path is cut into short intervals. On each the squared path speed is linear in the path parameter (constant path acceleration),
//! bounded by what the joints allow there: `|q'|·ṡ ≤ v`, and `|q''|·ṡ² + |q'|·|s̈| ≤ a`; an FR3's `v` falls towards its position limits. A pass forwards and one backwards make the speeds
//! reachable from rest to rest. That motion is then averaged over a short time `T` that ends now. An average exceeds no velocity and no
//! acceleration that it is made of (nor a `v` that falls, for it falls concavely: its average is less than what it is at the average place), and its jerk is `(a(t) − a(t−T)) / T`, at most `2a / T`: so `T = 2a / j` keeps the jerk limit. The average
//! leaves the path by at most `a·T²/24`, far less than a thousandth of a radian. All bounds hold at every instant, not only where it is sampled.

use repose_panda::{JOINT_COUNT, JointLimits, Joints, LIMITS};

use crate::path::blend::{Piece, blended};

/// How fast the arm may go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimingSettings {
    /// The robot's limits.
    pub limits: JointLimits,
    /// Share of the velocity limits that is used, above 0 to 1. Default 0.5.
    pub velocity_scale: f64,
    /// Share of the acceleration limits that is used, above 0 to 1. Default 0.25.
    pub acceleration_scale: f64,
    /// Share of the jerk limits that is used, above 0 to 1. Less is smoother; the motion takes longer by the time of averaging. Default 0.1.
    pub jerk_scale: f64,
    /// How far the path may leave its corners when it rounds them, radians. Larger is faster; the caller checks the rounded path.
    /// Default 0.03.
    pub deviation_rad: f64,
}

impl Default for TimingSettings {
    fn default() -> Self {
        Self { limits: LIMITS, velocity_scale: 0.5, acceleration_scale: 0.25, jerk_scale: 0.1, deviation_rad: 0.03 }
    }
}

impl TimingSettings {
    /// The same with a share of the speed, the acceleration and the jerk.
    #[must_use]
    pub fn slowed(&self, share: f64) -> Self {
        Self {
            velocity_scale: self.velocity_scale * share,
            acceleration_scale: self.acceleration_scale * share,
            jerk_scale: self.jerk_scale * share,
            ..*self
        }
    }

    /// The shortest time of averaging that keeps every joint's jerk limit, seconds.
    fn averaging_s(&self) -> f64 {
        let joint =
            |i: usize| 2.0 * self.limits.acceleration_rad_s2[i] * self.acceleration_scale / (self.limits.jerk_rad_s3[i] * self.jerk_scale);
        (0..JOINT_COUNT).map(joint).fold(0.0, f64::max)
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
    start: Joints,
    end: Joints,
    /// The box around the corners, lowest and highest angles, radians: the path does not leave it, and rounding must not either.
    bounds: [Joints; 2],
    /// How long the motion takes before it is averaged.
    moving_s: f64,
    averaging_s: f64,
}

/// A stretch of constant path acceleration.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Interval {
    piece: Piece,
    /// Where on the piece the interval begins.
    offset: f64,
    start_s: f64,
    speed: f64,
    acceleration: f64,
    /// The integral of the joint angles over time up to its beginning.
    integral: Joints,
}

impl Interval {
    /// Where on the piece the motion is, and how fast, `t` after the interval's beginning.
    fn place(&self, t: f64) -> (f64, f64) {
        (self.offset + t * (self.speed + 0.5 * t * self.acceleration), self.speed + t * self.acceleration)
    }

    /// The integral of the joint angles up to `t` after the interval's beginning: they are of degree four in time, three nodes are exact.
    fn integral(&self, t: f64) -> Joints {
        let mut integral = self.integral;
        for (node, weight) in [(0.112_701_665_379_258_3, 5.0 / 18.0), (0.5, 8.0 / 18.0), (0.887_298_334_620_741_7, 5.0 / 18.0)] {
            let at = self.piece.at(self.place(node * t).0);
            (0..JOINT_COUNT).for_each(|i| integral[i] += weight * t * at[i]);
        }
        integral
    }
}

impl Trajectory {
    /// The timed path through `corners` (at least one).
    pub fn new(corners: &[Joints], settings: &TimingSettings) -> Option<Self> {
        let (start, end) = (*corners.first()?, *corners.last()?);
        let pieces = blended(corners, settings.deviation_rad);
        let cuts = cut(&pieces, settings);
        let squares = reachable_squares(&cuts);
        let (mut start_s, mut integral) = (0.0, [0.0; JOINT_COUNT]);
        let mut intervals = Vec::with_capacity(cuts.len());
        for (cut, w) in cuts.iter().zip(squares.windows(2)) {
            let (speed, next) = (w[0].sqrt(), w[1].sqrt());
            let acceleration = (w[1] - w[0]) / (2.0 * cut.length);
            let interval = Interval { piece: cut.piece, offset: cut.offset, start_s, speed, acceleration, integral };
            let took_s = 2.0 * cut.length / (speed + next);
            integral = interval.integral(took_s);
            intervals.push(interval);
            start_s += took_s;
        }
        let extreme = |of: fn(f64, f64) -> f64| std::array::from_fn(|i| corners.iter().map(|q| q[i]).fold(start[i], of));
        let bounds = [extreme(f64::min), extreme(f64::max)];
        Some(Self { intervals, start, end, bounds, moving_s: start_s, averaging_s: settings.averaging_s() })
    }

    /// How long it takes, seconds.
    pub fn duration_s(&self) -> f64 {
        if self.moving_s > 0.0 { self.moving_s + self.averaging_s } else { 0.0 }
    }

    /// The last configuration.
    pub fn end(&self) -> &Joints {
        &self.end
    }

    /// The state at `time_s`; at rest at the end from [`Self::duration_s`] on.
    pub fn at(&self, time_s: f64) -> TrajectoryPoint {
        let still = [0.0; JOINT_COUNT];
        let rest = |position_rad| TrajectoryPoint { position_rad, velocity_rad_s: still, acceleration_rad_s2: still };
        if time_s >= self.duration_s() {
            return rest(self.end);
        }
        if time_s <= 0.0 {
            return rest(self.start);
        }
        let (now, before) = (self.raw(time_s), self.raw(time_s - self.averaging_s));
        let mean = |a: &Joints, b: &Joints| std::array::from_fn(|i| (a[i] - b[i]) / self.averaging_s);
        let [low, high] = &self.bounds;
        let position_rad: Joints = mean(&now.integral, &before.integral);
        TrajectoryPoint {
            position_rad: std::array::from_fn(|i| position_rad[i].clamp(low[i], high[i])),
            velocity_rad_s: mean(&now.position_rad, &before.position_rad),
            acceleration_rad_s2: mean(&now.velocity_rad_s, &before.velocity_rad_s),
        }
    }

    /// The motion before it is averaged; at rest before its beginning and after its end.
    fn raw(&self, time_s: f64) -> RawPoint {
        let rest = |position_rad: Joints, integral| RawPoint { integral, position_rad, velocity_rad_s: [0.0; JOINT_COUNT] };
        let after = self.intervals.partition_point(|i| i.start_s <= time_s);
        let Some(interval) = after.checked_sub(1).map(|k| &self.intervals[k]) else {
            return rest(self.start, self.start.map(|q| q * time_s));
        };
        let t = time_s.min(self.moving_s) - interval.start_s;
        let mut integral = interval.integral(t);
        if time_s >= self.moving_s {
            (0..JOINT_COUNT).for_each(|i| integral[i] += self.end[i] * (time_s - self.moving_s));
            return rest(self.end, integral);
        }
        let (s, rate) = interval.place(t);
        RawPoint { integral, position_rad: interval.piece.at(s), velocity_rad_s: interval.piece.derivative(s).map(|d| d * rate) }
    }

    /// The states at equal steps of at most `period_s`, from 0 to the end, both included.
    pub fn sampled(&self, period_s: f64) -> impl Iterator<Item = (f64, TrajectoryPoint)> + '_ {
        let duration_s = self.duration_s();
        let steps = (duration_s / period_s).ceil().max(1.0) as usize;
        let last = if duration_s > 0.0 { steps } else { 0 };
        (0..=last).map(move |k| duration_s * k as f64 / steps as f64).map(|t| (t, self.at(t)))
    }
}

/// The motion before it is averaged, at an instant.
struct RawPoint {
    /// The integral of the joint angles over time.
    integral: Joints,
    position_rad: Joints,
    velocity_rad_s: Joints,
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
                let velocity = highest_speed(&settings.limits, piece, i, [offset, offset + length]) * settings.velocity_scale;
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

/// The highest speed of a joint on a stretch of a piece: where it falls towards a position limit, what it is at the place nearest to that.
fn highest_speed(limits: &JointLimits, piece: &Piece, joint: usize, ends: [f64; 2]) -> f64 {
    let highest = limits.velocity_rad_s[joint];
    if limits.approach.is_none() {
        return highest;
    }
    // So far the joint may be beyond both ends in between.
    let bulge = piece.curvature[joint].abs() * (ends[1] - ends[0]).powi(2) / 8.0;
    let (places, rates) = (ends.map(|s| piece.at(s)[joint]), ends.map(|s| piece.derivative(s)[joint]));
    let upwards = limits.position_upper_rad[joint] - places[0].max(places[1]) - bulge;
    let downwards = places[0].min(places[1]) - bulge - limits.position_lower_rad[joint];
    [(upwards, 1.0), (downwards, -1.0)]
        .into_iter()
        .filter(|(_, sign)| rates.iter().any(|rate| rate * sign > 0.0))
        .map(|(way, _)| limits.speed_before(joint, way))
        .fold(highest, f64::min)
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
    use repose_panda::{CommandRuleSettings, CommandRules, FR3_LIMITS, READY};

    /// Anywhere within the limits, and often at one or so near it that a full brake just ends there.
    fn corners() -> impl Strategy<Value = Vec<Joints>> {
        let share = prop_oneof![4 => 0.0..1.0f64, 1 => Just(0.0), 1 => Just(1.0), 1 => 0.9998..1.0f64, 1 => 0.0..2e-4f64];
        prop::collection::vec(prop::array::uniform7(share).prop_map(|u| LIMITS.between(&u)), 1..6)
    }

    fn settings() -> impl Strategy<Value = TimingSettings> {
        (prop::array::uniform3(0.05..1.0f64), 1e-4..0.2f64).prop_map(|([velocity_scale, acceleration_scale, jerk_scale], deviation_rad)| {
            TimingSettings { velocity_scale, acceleration_scale, jerk_scale, deviation_rad, ..TimingSettings::default() }
        })
    }

    /// More than rounding moves a quotient of differences of angles over a time as short as the averaging.
    const ROUNDING: f64 = 1e-6;

    proptest! {
        #[test]
        fn no_limit_is_exceeded_at_any_instant(corners in corners(), settings in settings(), phase in 0.0..1.0f64) {
            let trajectory = Trajectory::new(&corners, &settings).unwrap();
            let limits = &settings.limits;
            // Unequal steps, down to far below the robot's millisecond: between two of them the acceleration has no time to exceed the limit.
            let mut last: Option<(f64, TrajectoryPoint)> = None;
            let mut time_s = -1e-3 * phase;
            let mut step = 0;
            while time_s < trajectory.duration_s() + 2e-3 {
                let point = trajectory.at(time_s);
                for i in 0..JOINT_COUNT {
                    prop_assert!(point.velocity_rad_s[i].abs() <= limits.velocity_rad_s[i] * settings.velocity_scale + ROUNDING);
                    prop_assert!(point.acceleration_rad_s2[i].abs() <= limits.acceleration_rad_s2[i] * settings.acceleration_scale + ROUNDING);
                    if let Some((before_s, before)) = &last {
                        let dt = time_s - before_s;
                        let jerk = (point.acceleration_rad_s2[i] - before.acceleration_rad_s2[i]) / dt;
                        prop_assert!(jerk.abs() <= limits.jerk_rad_s3[i] * settings.jerk_scale * (1.0 + 1e-6) + ROUNDING / dt, "joint {i}: {jerk} at {time_s}");
                        let moved = point.position_rad[i] - before.position_rad[i] - 0.5 * dt * (point.velocity_rad_s[i] + before.velocity_rad_s[i]);
                        prop_assert!(moved.abs() <= limits.jerk_rad_s3[i] * dt.powi(3) + 1e-9, "velocity and position belong together");
                    }
                }
                last = Some((time_s, point));
                step += 1;
                time_s += if step % 7 == 0 { 1.3e-4 } else { 9e-4 };
            }
        }

        #[test]
        fn frankas_rules_accept_every_millisecond(corners in corners(), phase in 0.0..1.0f64) {
            let full = TimingSettings { velocity_scale: 1.0, acceleration_scale: 1.0, jerk_scale: 1.0, ..TimingSettings::default() };
            let trajectory = Trajectory::new(&corners, &full).unwrap();
            let count = (trajectory.duration_s() / 1e-3) as usize + 3;
            let points: Vec<Joints> = (0..count).map(|k| trajectory.at((k as f64 + phase - 1.0) * 1e-3).position_rad).collect();
            prop_assert_eq!(CommandRules::check(&corners[0], &points, CommandRuleSettings::default()), Ok(()));
        }

        #[test]
        fn frankas_rules_accept_every_millisecond_of_an_fr3(
            ways in prop::collection::vec(prop::array::uniform7(0.0..1.0f64), 1..6), phase in 0.0..1.0f64, share in 0.3..0.999f64,
        ) {
            let limits = FR3_LIMITS;
            let corners: Vec<Joints> = ways.iter().map(|way| limits.approachable(0.1).between(way)).collect();
            let timing = TimingSettings { limits, velocity_scale: share, acceleration_scale: share, jerk_scale: share, ..TimingSettings::default() };
            let trajectory = Trajectory::new(&corners, &timing).unwrap();
            let count = (trajectory.duration_s() / 1e-3) as usize + 3;
            let points: Vec<Joints> = (0..count).map(|k| trajectory.at((k as f64 + phase - 1.0) * 1e-3).position_rad).collect();
            let rules = CommandRuleSettings { limits, ..CommandRuleSettings::default() };
            prop_assert_eq!(CommandRules::check(&corners[0], &points, rules), Ok(()));
        }

        #[test]
        fn it_stays_on_the_rounded_path(corners in corners(), settings in settings()) {
            let trajectory = Trajectory::new(&corners, &settings).unwrap();
            let pieces = blended(&corners, settings.deviation_rad);
            let dense: Vec<Joints> = pieces.iter().flat_map(|p| (0..=200).map(|k| p.at(p.length * f64::from(k) / 200.0))).collect();
            // An average leaves the path by a·T²/24 in each joint; the rest is the spacing of the dense points.
            let spacing = pieces.iter().map(|p| p.length / 200.0).fold(0.0, f64::max);
            let square_s = settings.averaging_s().powi(2);
            let off = (0..JOINT_COUNT).map(|i| (settings.limits.acceleration_rad_s2[i] * settings.acceleration_scale * square_s / 24.0).powi(2));
            let allowed = off.sum::<f64>().sqrt() + spacing;
            for (_, point) in trajectory.sampled(0.05).filter(|_| !dense.is_empty()) {
                let nearest = dense.iter().map(|q| crate::path::joint_path::distance(q, &point.position_rad)).fold(f64::INFINITY, f64::min);
                prop_assert!(nearest <= allowed, "{nearest} of {allowed}");
            }
        }

        #[test]
        fn it_goes_from_the_first_corner_to_the_last_at_rest_at_both_ends(corners in corners()) {
            let trajectory = Trajectory::new(&corners, &TimingSettings::default()).unwrap();
            let (start, end) = (trajectory.at(0.0), trajectory.at(trajectory.duration_s() + 1.0));
            prop_assert_eq!(end.position_rad, corners[corners.len() - 1]);
            prop_assert!((0..JOINT_COUNT).all(|i| (start.position_rad[i] - corners[0][i]).abs() < 1e-9 && start.velocity_rad_s[i] == 0.0));
            let nearly = trajectory.at(trajectory.duration_s() - 1e-6);
            prop_assert!((0..JOINT_COUNT).all(|i| (nearly.position_rad[i] - end.position_rad[i]).abs() < 1e-6 && nearly.velocity_rad_s[i].abs() < 1e-4));
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
    fn a_joint_that_stays_at_its_limit_is_not_rounded_beyond_it() {
        let limit = LIMITS.between(&[0.0; JOINT_COUNT]);
        let corners = [LIMITS.between(&[0.0, 0.5, 0.7, 0.0, 0.0, 0.0, 0.5]), limit];
        let trajectory = Trajectory::new(&corners, &TimingSettings::default()).unwrap();
        for k in 0..=(trajectory.duration_s() / 1e-3) as usize {
            let at = trajectory.at(k as f64 * 1e-3).position_rad;
            assert!((0..JOINT_COUNT).all(|i| at[i] >= limit[i]), "{at:?} after {k} ms");
        }
    }

    #[test]
    fn a_single_corner_takes_no_time() {
        let trajectory = Trajectory::new(&[READY], &TimingSettings::default()).unwrap();
        assert_eq!((trajectory.duration_s(), trajectory.at(0.0).position_rad), (0.0, READY));
        assert_eq!(Trajectory::new(&[], &TimingSettings::default()), None);
    }
}
