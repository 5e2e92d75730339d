//! What a robot's side shows of itself.

use repose_proto::robot::{RobotState, TaskState};
use repose_proto::{RigidTransform, limits};

use crate::Arm;

/// What is known of the gripper.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GripperState {
    /// Opening, metres.
    pub width_m: f64,
    /// Whether it has reached its commanded width, or stands against something.
    pub settled: bool,
    /// Whether it stands against something before its commanded width.
    pub holding: bool,
}

/// The parts of a robot state that the arm does not know.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StateDetails {
    /// The state's number.
    pub seq: u64,
    /// When it was made, nanoseconds since the Unix epoch.
    pub stamp_ns: u64,
    /// Robot time, milliseconds.
    pub robot_ms: f64,
    /// The gripper.
    pub gripper: GripperState,
    /// Where the robot's base stands in the world, where that is known.
    pub world_from_base: Option<RigidTransform>,
}

/// The state to put. Joint positions are the set-points that the arm is held at: those that the next stream has to start from.
pub fn state_of(arm: &Arm, shown: &StateDetails) -> RobotState {
    RobotState {
        v: limits::VERSION,
        seq: shown.seq,
        stamp_ns: shown.stamp_ns,
        robot_ms: shown.robot_ms,
        q_rad: *arm.q_rad(),
        dq_rad_s: *arm.dq_rad_s(),
        gripper_width_m: shown.gripper.width_m,
        gripper_settled: shown.gripper.settled,
        gripper_holding: shown.gripper.holding,
        mode: arm.mode(),
        stop: arm.stop().cloned(),
        owner: arm.owner().cloned(),
        last_command: arm.last_command(),
        stream_ms: arm.stream_ms(),
        task: Some(TaskState { id: arm.task().map(str::to_owned) }),
        held: arm.held().cloned(),
        since_handling_ms: arm.since_handling_ms(),
        model: Some(arm.model().name().to_owned()),
        world_from_base: shown.world_from_base,
        horizon_ms: None,
    }
}

#[cfg(test)]
mod tests {
    use repose_panda::Model;
    use repose_proto::robot::PANDA_LIKE;

    #[test]
    fn every_model_that_an_arm_may_be_is_known_on_the_wire() {
        assert_eq!(Model::ALL.map(Model::name), PANDA_LIKE);
    }
}
