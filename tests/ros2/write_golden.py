"""Writes messages as `rosbags` serializes them, for `services/shared/ros_messages/tests/golden.rs`: every number and word another."""

import itertools
from pathlib import Path

import numpy as np
from definitions import store

FOLDER = Path(__file__).resolve().parents[2] / "services/shared/ros_messages/tests/golden"
TYPES = [
    "action_msgs/msg/GoalStatusArray",
    "action_msgs/srv/CancelGoal_Request",
    "action_msgs/srv/CancelGoal_Response",
    "control_msgs/action/FollowJointTrajectory_GetResult_Response",
    "control_msgs/action/FollowJointTrajectory_SendGoal_Request",
    "control_msgs/action/FollowJointTrajectory_SendGoal_Response",
    "control_msgs/action/GripperCommand_FeedbackMessage",
    "control_msgs/action/GripperCommand_SendGoal_Request",
    "diagnostic_msgs/msg/DiagnosticArray",
    "geometry_msgs/msg/PoseArray",
    "repose_msgs/srv/Place_Request",
    "repose_msgs/srv/Place_Response",
    "repose_msgs/srv/Plan_Request",
    "repose_msgs/srv/Plan_Response",
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/PointCloud2",
    "std_srvs/srv/Trigger_Request",
    "std_srvs/srv/Trigger_Response",
    "tf2_msgs/msg/TFMessage",
    "vision_msgs/msg/Detection3DArray",
    "visualization_msgs/msg/MarkerArray",
]


def filled(types, name, numbers):
    """A message of a type with another value in every place, sequences of two."""
    _, fields = types.fielddefs[name]
    return types.types[name](**{field: value(types, of, numbers) for field, of in fields})


def value(types, field, numbers):
    kind, of = int(field[0]), field[1]
    if kind == 2:
        return filled(types, of, numbers)
    if kind == 1:
        n = next(numbers)
        return f"word {n}" if of[0] == "string" else bool(n % 2) if of[0] == "bool" else n + 0.5 if of[0].startswith("float") else n % 100
    inner, size = of
    count = size if kind == 3 else 2
    if int(inner[0]) == 1 and inner[1][0] != "string":
        dtype = {"byte": "uint8", "char": "uint8"}.get(inner[1][0], inner[1][0])
        return np.array([next(numbers) % 100 for _ in range(count)], dtype)
    return [value(types, inner, numbers) for _ in range(count)]


if __name__ == "__main__":
    made = store()
    for name in TYPES:
        message = filled(made, name, itertools.count(1))
        (FOLDER / f"{name.split('/')[-1]}.cdr").write_bytes(bytes(made.serialize_cdr(message, name)))
