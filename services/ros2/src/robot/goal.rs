//! Set-points as a trajectory of ROS, and a goal on its way through a controller.

use repose_proto::robot::SetPoint;
use repose_ros_messages::{Duration, FollowJointTrajectoryGoal, JointTrajectory, JointTrajectoryPoint};

/// How far ahead a trajectory that takes the place of another begins, milliseconds. A controller leaves the old one at once, wherever it is on it by
/// then, and goes to the new one's first point on a cubic: what nobody knows of where it is has to fade out in that time. Commanders that bring
/// a stream to rest on its way have it slow down from further ahead than this.
pub const REPLACE_LEAD_MS: f64 = 200.0;

/// How far a controller is with a goal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GoalState {
    /// Sent, and not answered yet.
    Sent,
    /// Accepted.
    Accepted,
}

/// The goal that the arm follows: a trajectory that its controller has, or is to have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Goal {
    /// Its number: later ones take the place of earlier ones.
    pub number: u64,
    /// How far it is.
    pub state: GoalState,
    /// Since when, milliseconds.
    pub since_ms: u64,
    /// How long its trajectory takes, milliseconds.
    pub duration_ms: f64,
}

/// From when on a stream is handed to a controller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Handover {
    /// The stream's time at which the controller is as the trajectory comes to it, milliseconds.
    pub from_ms: f64,
    /// How far ahead of that the trajectory begins, milliseconds.
    pub lead_ms: f64,
}

impl Handover {
    /// The set-points that the controller is told of; at least the last.
    pub fn rest(self, set_points: &[SetPoint]) -> &[SetPoint] {
        let first = set_points.partition_point(|p| p.t_ms <= self.from_ms + self.lead_ms);
        &set_points[first.min(set_points.len().saturating_sub(1))..]
    }

    /// The trajectory through these, with the time that the lead is where the stream ends within it.
    pub fn trajectory(self, joints: &[String; 7], set_points: &[SetPoint]) -> JointTrajectory {
        let rest = self.rest(set_points);
        let from_ms = rest.first().map_or(self.from_ms, |first| self.from_ms.min(first.t_ms - self.lead_ms));
        trajectory(joints, rest, from_ms)
    }
}

/// The trajectory through set-points that begins at `from_ms` of their time.
pub fn trajectory(joints: &[String; 7], set_points: &[SetPoint], from_ms: f64) -> JointTrajectory {
    let point = |p: &SetPoint| JointTrajectoryPoint {
        positions: p.q_rad.into(),
        velocities: p.dq_rad_s.into(),
        time_from_start: Duration::from_ms(p.t_ms - from_ms),
        ..JointTrajectoryPoint::default()
    };
    JointTrajectory { joint_names: joints.to_vec(), points: set_points.iter().map(point).collect(), ..JointTrajectory::default() }
}

/// The goal that a controller is sent: the trajectory, with the controller's own tolerances.
pub fn goal_of(trajectory: JointTrajectory) -> FollowJointTrajectoryGoal {
    FollowJointTrajectoryGoal { trajectory, ..FollowJointTrajectoryGoal::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_controller_is_told_of_what_lies_beyond_the_lead_and_of_the_end_in_any_case() {
        let joints = std::array::from_fn(|i| format!("joint{i}"));
        let points: Vec<SetPoint> = (0..=50).map(|k| SetPoint { t_ms: 10.0 * f64::from(k), q_rad: [0.0; 7], dq_rad_s: [0.0; 7] }).collect();
        for (from_ms, lead_ms, count, first_ms) in
            [(0.0, 0.0, 50, 10.0), (103.0, 200.0, 20, 207.0), (300.0, 200.0, 1, 200.0), (450.0, 200.0, 1, 200.0)]
        {
            let trajectory = Handover { from_ms, lead_ms }.trajectory(&joints, &points);
            let first = trajectory.points[0].time_from_start.as_ms();
            assert_eq!((trajectory.points.len(), first), (count, first_ms), "from {from_ms} ms");
        }
    }
}
