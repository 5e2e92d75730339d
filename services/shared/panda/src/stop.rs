//! Coming to rest as fast as the limits allow, or more gently where there is room: one set-point each period.
//!
//! Worked out in the robot's own terms, where velocity, acceleration and jerk are backward differences of set-points a period `T` apart. A
//! joint at velocity `v` and acceleration `a` stands after `n` periods when its accelerations `a₁ … aₙ` end in 0 and sum to `−v/T`. They are
//! `aₖ = clamp(c, max(a − δk, −δ(n−k)), min(a + δk, δ(n−k)))` with `δ = j·T`: as near to one level `c` as the jerk `j` lets them come from `a`
//! and get back to 0. A clamp between sequences of slope at most `δ` has that slope itself, so the jerk limit holds exactly, and so does the
//! acceleration limit where `|c|` keeps it. The sum grows with `c`, which gives `c` for each `n`, and its range grows with `n`.
//!
//! That spreads the braking over whole periods. The stop that goes the least way brakes with all that it may and is done earlier, within a
//! period: `n` is then a real number, `c` the limit, and the sum gives `n`. It is the one that says whether there is room to stop at all.

use crate::{JOINT_COUNT, JointLimits, Joints, LIMITS};

/// Where and how the arm moves at a set-point; the derivatives are backward differences.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionState {
    /// Joint angles, radians.
    pub position_rad: Joints,
    /// Joint velocities, radians per second.
    pub velocity_rad_s: Joints,
    /// Joint accelerations, radians per second squared.
    pub acceleration_rad_s2: Joints,
}

impl MotionState {
    /// At rest.
    pub fn at_rest(position_rad: Joints) -> Self {
        Self { position_rad, velocity_rad_s: [0.0; JOINT_COUNT], acceleration_rad_s2: [0.0; JOINT_COUNT] }
    }

    /// Whether nothing moves and nothing is about to.
    pub fn is_at_rest(&self) -> bool {
        self.velocity_rad_s == [0.0; JOINT_COUNT] && self.acceleration_rad_s2 == [0.0; JOINT_COUNT]
    }

    /// The state at the next set-point, `period_s` later.
    #[must_use]
    pub fn followed_by(&self, set_point: &Joints, period_s: f64) -> Self {
        let velocity_rad_s: Joints = std::array::from_fn(|i| (set_point[i] - self.position_rad[i]) / period_s);
        let acceleration_rad_s2 = std::array::from_fn(|i| (velocity_rad_s[i] - self.velocity_rad_s[i]) / period_s);
        Self { position_rad: *set_point, velocity_rad_s, acceleration_rad_s2 }
    }

    fn joint(&self, i: usize) -> JointState {
        JointState { position: self.position_rad[i], velocity: self.velocity_rad_s[i], acceleration: self.acceleration_rad_s2[i] }
    }
}

/// How stops are made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StopSettings {
    /// The limits.
    pub limits: JointLimits,
    /// Time between set-points, seconds. Default 0.001.
    pub period_s: f64,
    /// The share of the acceleration and jerk limits that a stop uses where there is room for it, above 0 to 1. Default 0.6: what is held by
    /// friction stays in the hand.
    pub gentle_share: f64,
}

impl Default for StopSettings {
    fn default() -> Self {
        Self { limits: LIMITS, period_s: 0.001, gentle_share: 0.6 }
    }
}

/// A limit that a stop would exceed, whatever it does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OverrunLimit {
    /// A position limit.
    Position,
    /// A velocity limit.
    Velocity,
}

/// A stop on its way.
#[derive(Debug, Clone, PartialEq)]
pub struct Stop {
    state: MotionState,
    joints: [JointStop; JOINT_COUNT],
    period_s: f64,
}

impl Stop {
    /// The stop from a state. All joints stand at the same instant, which keeps the arm near its path, and with a share of the acceleration;
    /// a joint whose limits leave no room for that stops as hard as it can.
    pub fn new(state: &MotionState, settings: &StopSettings) -> Self {
        let gentle = |i: usize| JointLimit::of(&settings.limits, i).shared(settings.gentle_share);
        let shortest = |i: usize| gentle(i).shortest(&state.joint(i), settings.period_s);
        let together = (0..JOINT_COUNT).map(|i| shortest(i).periods).max().unwrap_or(0);
        let joints = std::array::from_fn(|i| {
            let joint = state.joint(i);
            let gentle = gentle(i).stop_in(together, &joint, settings.period_s);
            let limit = JointLimit::of(&settings.limits, i);
            gentle
                .filter(|stop| stop.overrun(joint, &limit, settings.period_s).is_none())
                .unwrap_or_else(|| limit.hardest(&joint, settings.period_s))
        });
        Self { state: *state, joints, period_s: settings.period_s }
    }

    /// The next set-point's state; at rest, exactly, from the last on.
    pub fn step(&mut self) -> MotionState {
        let mut next = self.state;
        for (i, stop) in self.joints.iter_mut().enumerate() {
            let joint = stop.step(self.state.joint(i), self.period_s);
            (next.position_rad[i], next.velocity_rad_s[i], next.acceleration_rad_s2[i]) =
                (joint.position, joint.velocity, joint.acceleration);
        }
        self.state = next;
        next
    }
}

/// The joint and the limit that even the hardest stop from a state would exceed; none if the arm can come to rest within all limits.
pub fn overrun(state: &MotionState, limits: &JointLimits, period_s: f64) -> Option<(usize, OverrunLimit)> {
    (0..JOINT_COUNT).find_map(|i| {
        let (joint, limit) = (state.joint(i), JointLimit::of(limits, i));
        if limit.has_room(&joint, period_s) {
            return None;
        }
        limit.hardest(&joint, period_s).overrun(joint, &limit, period_s).map(|overrun| (i, overrun))
    })
}

/// One joint's state.
#[derive(Debug, Clone, Copy, PartialEq)]
struct JointState {
    position: f64,
    velocity: f64,
    acceleration: f64,
}

/// One joint's limits.
#[derive(Debug, Clone, Copy, PartialEq)]
struct JointLimit {
    positions: [f64; 2],
    velocity: f64,
    /// How the highest speed falls towards the positions: a deceleration, and what is taken off the speed.
    approach: Option<[f64; 2]>,
    acceleration: f64,
    jerk: f64,
}

/// Rounding that a comparison with a velocity limit forgives, relative, and one with a position limit, radians.
const ROUNDING: f64 = 1e-6;
const POSITION_ROUNDING_RAD: f64 = 1e-9;

impl JointLimit {
    fn of(limits: &JointLimits, i: usize) -> Self {
        Self {
            positions: [limits.position_lower_rad[i], limits.position_upper_rad[i]],
            velocity: limits.velocity_rad_s[i],
            approach: limits.approach.map(|approach| [approach.deceleration_rad_s2[i], approach.offset_rad_s[i]]),
            acceleration: limits.acceleration_rad_s2[i],
            jerk: limits.jerk_rad_s3[i],
        }
    }

    /// The same with a share of acceleration and jerk.
    fn shared(self, share: f64) -> Self {
        Self { acceleration: self.acceleration * share, jerk: self.jerk * share, ..self }
    }

    /// Whether a stop is far from position and velocity limits, by bounds that are quickly had: speed grows by `a²/2j` while the acceleration
    /// is taken back, and stopping from it takes no longer than `a/j + v/a_max + a_max/j` and a few periods.
    fn has_room(&self, joint: &JointState, period_s: f64) -> bool {
        let acceleration = joint.acceleration.abs();
        let fastest = joint.velocity.abs() + acceleration * (0.5 * acceleration / self.jerk + 2.0 * period_s);
        let longest_s = (acceleration + self.acceleration) / self.jerk + fastest / self.acceleration + 6.0 * period_s;
        let reach = fastest * longest_s;
        let way = (joint.position - self.positions[0]).min(self.positions[1] - joint.position) - reach;
        way >= 0.0 && fastest <= self.speed_before(way)
    }

    /// The highest speed towards a position limit so far off.
    fn speed_before(&self, way: f64) -> f64 {
        let Some([deceleration, offset]) = self.approach else { return self.velocity };
        ((2.0 * deceleration * way.max(0.0)).sqrt() - offset).clamp(0.0, self.velocity)
    }

    /// The highest speed at an angle in the direction of a velocity.
    fn speed_at(&self, joint: &JointState) -> f64 {
        self.speed_before(if joint.velocity < 0.0 { joint.position - self.positions[0] } else { self.positions[1] - joint.position })
    }

    /// The stop in the fewest periods.
    fn shortest(&self, joint: &JointState, period_s: f64) -> JointStop {
        // Fewer cannot take the speed away or bring the acceleration back.
        let for_speed = joint.velocity.abs() / (self.acceleration * period_s);
        let for_acceleration = joint.acceleration.abs() / (self.jerk * period_s);
        let mut periods = (for_speed.max(for_acceleration) * (1.0 - ROUNDING)).ceil() as usize;
        loop {
            if let Some(stop) = self.stop_in(periods, joint, period_s) {
                return stop;
            }
            periods += 1;
        }
    }

    /// The stop that goes the least way before it turns the joint around: the limit's acceleration for as long as it is needed.
    fn hardest(&self, joint: &JointState, period_s: f64) -> JointStop {
        let mut stop = self.shortest(joint, period_s);
        let wanted = -joint.velocity / period_s;
        let latest = stop.end;
        // A period earlier is too early, or earlier than the acceleration can be back at 0.
        let earliest = (latest - 1.0).max(joint.acceleration.abs() / stop.slope).min(latest);
        stop.end = earliest;
        stop.level = -self.acceleration;
        if wanted > stop.sum().total {
            stop.level = self.acceleration;
        }
        let range = if stop.level < 0.0 { [latest, earliest] } else { [earliest, latest] };
        stop.solve(wanted, range, |stop| &mut stop.end, |sum| sum.per_end);
        stop
    }

    /// The stop in `periods`, if that is enough time.
    fn stop_in(&self, periods: usize, joint: &JointState, period_s: f64) -> Option<JointStop> {
        let slope = self.jerk * period_s;
        let mut stop = JointStop { start: joint.acceleration, level: 0.0, slope, end: periods as f64, periods, taken: 0 };
        if joint.acceleration.abs() > slope * stop.end * (1.0 + ROUNDING) {
            return None;
        }
        let wanted = -joint.velocity / period_s;
        let range = [-self.acceleration, self.acceleration];
        let tolerance = ROUNDING * self.acceleration;
        let [least, most] = range.map(|level| JointStop { level, ..stop }.sum().total);
        if wanted < least - tolerance || wanted > most + tolerance {
            return None;
        }
        stop.solve(wanted, range, |stop| &mut stop.level, |sum| sum.per_level);
        Some(stop)
    }
}

/// One joint's stop.
#[derive(Debug, Clone, Copy, PartialEq)]
struct JointStop {
    /// The acceleration from which it starts.
    start: f64,
    /// The acceleration that it keeps as far as it can.
    level: f64,
    /// Largest change of the acceleration over a period.
    slope: f64,
    /// When the acceleration is back at 0, in periods: within the last.
    end: f64,
    periods: usize,
    taken: usize,
}

/// The sum of a stop's accelerations.
struct Sum {
    total: f64,
    /// By how much it grows with the level, and with the end.
    per_level: f64,
    per_end: f64,
}

impl JointStop {
    /// The acceleration `k` periods after the start, and what it grows by with the level and with the end.
    fn acceleration(&self, k: usize) -> (f64, f64, f64) {
        let (up, back) = (self.slope * k as f64, self.slope * (self.end - k as f64).max(0.0));
        let (low, high) = ((self.start - up).max(-back), (self.start + up).min(back));
        // Not `clamp`: rounding may leave the bounds a hair the wrong way around.
        let acceleration = self.level.min(high).max(low);
        let per_end = if back > 0.0 && acceleration.abs() == back { self.slope.copysign(acceleration) } else { 0.0 };
        (acceleration, f64::from(u8::from(low < self.level && self.level < high)), per_end)
    }

    fn sum(&self) -> Sum {
        (1..=self.periods).map(|k| self.acceleration(k)).fold(Sum { total: 0.0, per_level: 0.0, per_end: 0.0 }, |sum, a| Sum {
            total: sum.total + a.0,
            per_level: sum.per_level + a.1,
            per_end: sum.per_end + a.2,
        })
    }

    /// Gives `part` the value between `below`, where the sum is at most `wanted`, and `above`, where it is at least that, that makes it so.
    /// Newton's method within a shrinking bracket: the sum is piecewise linear in each part. What remains is a speed of 1e-11 rad/s.
    fn solve(&mut self, wanted: f64, [mut below, mut above]: [f64; 2], part: fn(&mut Self) -> &mut f64, growth: fn(&Sum) -> f64) {
        for _ in 0..60 {
            let sum = self.sum();
            let missing = wanted - sum.total;
            if missing.abs() <= 1e-11 * wanted.abs().max(1.0) {
                break;
            }
            let at = *part(self);
            if missing > 0.0 {
                below = at;
            } else {
                above = at;
            }
            let newton = at + missing / growth(&sum);
            *part(self) = if below.min(above) < newton && newton < below.max(above) { newton } else { 0.5 * (below + above) };
        }
    }

    fn step(&mut self, from: JointState, period_s: f64) -> JointState {
        self.taken += 1;
        if self.taken >= self.periods {
            // What rounding has left of the speed is far below what any limit could tell.
            return JointState { position: from.position, velocity: 0.0, acceleration: 0.0 };
        }
        let (acceleration, ..) = self.acceleration(self.taken);
        let velocity = from.velocity + acceleration * period_s;
        JointState { position: from.position + velocity * period_s, velocity, acceleration }
    }

    /// The limit that the stop exceeds on its way.
    fn overrun(mut self, from: JointState, limit: &JointLimit, period_s: f64) -> Option<OverrunLimit> {
        let mut joint = from;
        for _ in 0..self.periods {
            joint = self.step(joint, period_s);
            if joint.velocity.abs() > limit.speed_at(&joint) * (1.0 + ROUNDING) {
                return Some(OverrunLimit::Velocity);
            }
            if joint.position < limit.positions[0] - POSITION_ROUNDING_RAD || joint.position > limit.positions[1] + POSITION_ROUNDING_RAD {
                return Some(OverrunLimit::Position);
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const PERIOD_S: f64 = 0.001;

    /// States within the limits of position, velocity and acceleration, many of them near one.
    fn states() -> impl Strategy<Value = MotionState> {
        let share = || prop::array::uniform7(prop_oneof![4 => -1.0..1.0f64, 1 => Just(0.0), 1 => Just(1.0), 1 => Just(-1.0)]);
        (prop::array::uniform7(0.0..1.0f64), share(), share()).prop_map(|(place, speed, push)| MotionState {
            position_rad: LIMITS.between(&place),
            velocity_rad_s: std::array::from_fn(|i| speed[i] * LIMITS.velocity_rad_s[i]),
            acceleration_rad_s2: std::array::from_fn(|i| push[i] * LIMITS.acceleration_rad_s2[i]),
        })
    }

    /// The largest shares of the velocity, acceleration and jerk limits, and how far beyond the position limits, until the stop stands.
    fn excesses(start: &MotionState, settings: &StopSettings) -> ([f64; 3], f64, usize) {
        let mut stop = Stop::new(start, settings);
        let (mut state, mut most, mut beyond) = (*start, [0.0f64; 3], 0.0f64);
        for taken in 1..=10_000 {
            // Not what the stop says of itself: what follows from its positions.
            let next = state.followed_by(&stop.step().position_rad, PERIOD_S);
            for i in 0..JOINT_COUNT {
                let jerk = (next.acceleration_rad_s2[i] - state.acceleration_rad_s2[i]) / PERIOD_S;
                most[0] = most[0].max(next.velocity_rad_s[i].abs() / LIMITS.velocity_rad_s[i]);
                most[1] = most[1].max(next.acceleration_rad_s2[i].abs() / LIMITS.acceleration_rad_s2[i]);
                most[2] = most[2].max(jerk.abs() / LIMITS.jerk_rad_s3[i]);
                beyond = beyond
                    .max(LIMITS.position_lower_rad[i] - next.position_rad[i])
                    .max(next.position_rad[i] - LIMITS.position_upper_rad[i]);
            }
            let stands = next.position_rad == state.position_rad && state.velocity_rad_s == [0.0; JOINT_COUNT];
            state = next;
            if stands {
                return (most, beyond, taken);
            }
        }
        panic!("it never stands: {state:?}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(400))]

        #[test]
        fn a_stop_keeps_acceleration_and_jerk_from_any_state_and_all_limits_where_it_says_so(
            state in states(), gentle_share in 0.1..1.0f64,
        ) {
            let settings = StopSettings { gentle_share, ..StopSettings::default() };
            let ([velocity, acceleration, jerk], beyond, _) = excesses(&state, &settings);
            prop_assert!(acceleration <= 1.0 + 1e-6 && jerk <= 1.0 + 1e-6, "{acceleration} {jerk}");
            match overrun(&state, &LIMITS, PERIOD_S) {
                None => prop_assert!(velocity <= 1.0 + 1e-6 && beyond <= 1e-8, "{velocity} {beyond}"),
                Some((_, OverrunLimit::Velocity)) => prop_assert!(velocity > 1.0 || beyond > 0.0),
                Some((_, OverrunLimit::Position)) => prop_assert!(beyond > 0.0),
            }
        }

        #[test]
        fn no_stop_goes_less_far_than_the_hardest(state in states(), longer in 0usize..4) {
            for i in 0..JOINT_COUNT {
                let (joint, limit) = (state.joint(i), JointLimit::of(&LIMITS, i));
                let farthest = |mut stop: JointStop| {
                    let mut at = joint;
                    (0..stop.periods).map(|_| { at = stop.step(at, PERIOD_S); at.position * joint.velocity.signum() }).fold(f64::NEG_INFINITY, f64::max)
                };
                let hardest = limit.hardest(&joint, PERIOD_S);
                let other = limit.stop_in(limit.shortest(&joint, PERIOD_S).periods + longer, &joint, PERIOD_S);
                prop_assert!(other.is_none_or(|other| farthest(hardest) <= farthest(other) + 1e-9), "joint {i} by {longer} periods more");
            }
        }

        #[test]
        fn whoever_can_come_to_rest_still_can_after_each_step_of_the_stop(state in states()) {
            prop_assume!(overrun(&state, &LIMITS, PERIOD_S).is_none());
            let mut stop = Stop::new(&state, &StopSettings { gentle_share: 1.0, ..StopSettings::default() });
            for _ in 0..50 {
                prop_assert_eq!(overrun(&stop.step(), &LIMITS, PERIOD_S), None);
            }
        }
    }

    #[test]
    fn full_speed_is_taken_away_in_little_more_than_the_limits_ask() {
        let mut state = MotionState::at_rest(crate::READY);
        state.velocity_rad_s[1] = 2.0;
        let (most, _, taken) = excesses(&state, &StopSettings { gentle_share: 1.0, ..StopSettings::default() });
        // 2.0 / 7.5 s and the time to build the acceleration up and take it back.
        assert!((267..=275).contains(&taken), "{taken}");
        assert!(most[1] > 0.98);
        let (gentle, _, longer) = excesses(&state, &StopSettings { gentle_share: 0.5, ..StopSettings::default() });
        assert!(gentle[1] <= 0.5 + 1e-6 && longer > taken, "{gentle:?} {longer}");
    }

    #[test]
    fn all_joints_stand_together_where_there_is_room() {
        let mut state = MotionState::at_rest(crate::READY);
        (state.velocity_rad_s[0], state.velocity_rad_s[6]) = (1.0, 0.1);
        let mut stop = Stop::new(&state, &StopSettings::default());
        let moving: Vec<[bool; 2]> =
            (0..300).map(|_| stop.step()).map(|s| [s.velocity_rad_s[0] != 0.0, s.velocity_rad_s[6] != 0.0]).collect();
        assert!(moving.iter().all(|[a, b]| a == b), "they move and stand at the same instants");
    }

    #[test]
    fn what_stands_stays() {
        let state = MotionState::at_rest(crate::READY);
        assert_eq!(Stop::new(&state, &StopSettings::default()).step(), state);
        assert_eq!(overrun(&state, &LIMITS, PERIOD_S), None);
    }

    #[test]
    fn racing_towards_a_limit_is_an_overrun_and_away_from_it_is_none() {
        let mut state = MotionState::at_rest(crate::READY);
        state.position_rad[0] = LIMITS.position_upper_rad[0] - 0.01;
        state.velocity_rad_s[0] = 1.0;
        assert_eq!(overrun(&state, &LIMITS, PERIOD_S), Some((0, OverrunLimit::Position)));
        state.velocity_rad_s[0] = -1.0;
        assert_eq!(overrun(&state, &LIMITS, PERIOD_S), None);
        (state.velocity_rad_s[0], state.acceleration_rad_s2[0]) = (-LIMITS.velocity_rad_s[0], -10.0);
        assert_eq!(overrun(&state, &LIMITS, PERIOD_S), Some((0, OverrunLimit::Velocity)));
    }
}
