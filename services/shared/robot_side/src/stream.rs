//! The set-points that the arm follows: a clock over them, cubic Hermite between them.

use repose_panda::{CommandRuleSettings, CommandRules, JOINT_COUNT, Joints, hermite, smooth_step};
use repose_proto::robot::{RobotCommand, SetPoint};

/// Robot time of one control step, seconds.
pub const TICK_S: f64 = 0.001;
/// How long the difference between where the arm stood and where its stream starts takes to fade out, milliseconds.
const FADE_MS: f64 = 200.0;

/// A stream of set-points and how far it has been followed.
#[derive(Debug, Clone)]
pub struct Stream {
    points: Vec<SetPoint>,
    /// Whether it ends with the last set-point here.
    pub ends: bool,
    /// Where on its time the arm is, milliseconds.
    pub clock_ms: f64,
    /// From where the stream starts to where the arm stood, radians; it fades out.
    offset: Joints,
    since_start_ms: f64,
    /// What each place is checked against.
    pub rules: CommandRules,
}

impl Stream {
    /// The stream that a command starts with its first set-point, by an arm that stands at `stands_rad`.
    pub fn new(first: &SetPoint, command: &RobotCommand, stands_rad: &Joints, rules: CommandRuleSettings) -> Self {
        Self {
            points: command.set_points.clone(),
            ends: command.ends_stream,
            clock_ms: first.t_ms,
            offset: std::array::from_fn(|i| stands_rad[i] - first.q_rad[i]),
            since_start_ms: 0.0,
            rules: CommandRules::continued(stands_rad, rules),
        }
    }

    /// Set-points from the first new time on are replaced; those behind the clock are dropped.
    pub fn extend(&mut self, set_points: &[SetPoint]) {
        let Some(first) = set_points.first() else { return };
        self.points.truncate(self.before(first));
        self.points.extend_from_slice(set_points);
        self.points.drain(..self.passed());
    }

    /// How many set-points stay beside new ones that begin with `first`.
    pub fn kept(&self, first: &SetPoint) -> usize {
        self.before(first).saturating_sub(self.passed())
    }

    fn before(&self, first: &SetPoint) -> usize {
        self.points.partition_point(|p| p.t_ms < first.t_ms)
    }

    /// How many set-points are of no use any more: the last one behind the clock still is.
    fn passed(&self) -> usize {
        self.points.partition_point(|p| p.t_ms <= self.clock_ms).saturating_sub(1)
    }

    /// One millisecond of robot time.
    pub fn advance(&mut self) {
        self.clock_ms += TICK_S * 1e3;
        self.since_start_ms += TICK_S * 1e3;
    }

    /// The time of the last set-point.
    pub fn end_ms(&self) -> Option<f64> {
        self.points.last().map(|p| p.t_ms)
    }

    /// Joint positions at a time between the first and the last set-point.
    pub fn at(&self, t_ms: f64) -> Joints {
        let fading = 1.0 - smooth_step(self.since_start_ms / FADE_MS);
        let on_stream = self.interpolated(t_ms);
        std::array::from_fn(|i| on_stream[i] + fading * self.offset[i])
    }

    fn interpolated(&self, t_ms: f64) -> Joints {
        let next = self.points.partition_point(|p| p.t_ms <= t_ms);
        // A time before the first set-point can only be asked for when a command has moved that into the future: the rules decide.
        let Some(b) = self.points.get(next) else { return self.points.last().map_or([f64::NAN; JOINT_COUNT], |p| p.q_rad) };
        let Some(a) = next.checked_sub(1).and_then(|before| self.points.get(before)) else { return b.q_rad };
        let s = (t_ms - a.t_ms) / (b.t_ms - a.t_ms);
        hermite((&a.q_rad, &a.dq_rad_s), (&b.q_rad, &b.dq_rad_s), (b.t_ms - a.t_ms) * 1e-3, s).0
    }
}
