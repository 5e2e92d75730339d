"""A camera and an arm with a hand as a ROS 2 driver shows them: pictures of a still scene, controllers that follow what they are given."""

import bisect
import itertools
import os
import sys
import tempfile
import threading
import time

import numpy as np

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))

READY_RAD = [0.0, -0.785398163397, 0.0, -2.356194490192, 0.0, 1.570796326795, 0.785398163397]
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


class Scene:
    """What a depth camera sees of a table with objects, by PyBullet; the arm is out of the picture."""

    def __init__(self, seed=3):
        from foreign_world import objects, scenes
        from foreign_world.camera import DEPTH_UNIT_M, sensed
        from foreign_world.world import STEP_S, World

        with tempfile.TemporaryDirectory() as folder:
            world = World(objects.Meshes(folder))
            drawn = np.random.default_rng(7)
            shapes = []
            world.clear()
            while len(shapes) < 12:
                shape = objects.generated(drawn)
                if scenes.stands_after_a_drop(world.client, world.meshes, shape, STEP_S):
                    shapes.append(shape)
            while not world.furnish("table", shapes, np.random.default_rng(seed)):
                seed += 1000
            world.client.resetBasePositionAndOrientation(world.robot.body, [0, 0, -50], [0, 0, 0, 1])
            self.color, depth_m, self.labels = world.picture()
            self.depth = sensed(depth_m, np.random.default_rng(seed))
            assert DEPTH_UNIT_M == 0.001
            self.model = world.furniture.camera.model()
            self.world_from_camera = np.reshape(self.model["world_from_camera"], (4, 4))
            self.centroids_m = [world.pose(k)[:3, 3] for k in range(len(world.objects))]


def quaternion(rotation):
    """x, y, z, w of a rotation matrix."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotation).as_quat()


class Camera:
    """Publishes depth, color, intrinsics and where it stands, at a rate, until it is stopped."""

    def __init__(self, system, scene, rate=15.0, depth_type="sensor_msgs/msg/Image", static=True):
        self.system, self.scene, self.period = system, scene, 1.0 / rate
        self.sent, self.over = 0, threading.Event()
        self.depth = system.publisher("/cam/depth/image_rect", depth_type)
        self.color = system.publisher("/cam/color/image_rect", "sensor_msgs/msg/Image")
        self.info = system.publisher("/cam/depth/camera_info", "sensor_msgs/msg/CameraInfo")
        if static:
            self.place(system)
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def place(self, system):
        """Tells once where the camera stands, for whoever comes late too."""
        make, pose = system.make, self.scene.world_from_camera
        translation = make("geometry_msgs/msg/Vector3", **dict(zip("xyz", map(float, pose[:3, 3]))))
        rotation = make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", map(float, quaternion(pose[:3, :3])))))
        transform = make("geometry_msgs/msg/Transform", translation=translation, rotation=rotation)
        told = make(
            "geometry_msgs/msg/TransformStamped", header=system.header("world"), child_frame_id="cam_optical", transform=transform
        )
        system.publisher("/tf_static", "tf2_msgs/msg/TFMessage", kept=True)(make("tf2_msgs/msg/TFMessage", transforms=[told]))

    def image(self, pixels, encoding, ns):
        height, width = pixels.shape[:2]
        data = np.frombuffer(np.ascontiguousarray(pixels).tobytes(), np.uint8)
        step = len(data) // height
        header = self.system.header("cam_optical", ns)
        return self.system.make("sensor_msgs/msg/Image", header=header, height=height, width=width, encoding=encoding, step=step, data=data)

    def _run(self):
        model, due = self.scene.model, time.monotonic()
        k = np.array([model["fx"], 0, model["cx"], 0, model["fy"], model["cy"], 0, 0, 1.0])
        while not self.over.is_set():
            ns = time.time_ns()
            header = self.system.header("cam_optical", ns)
            size = {"height": model["height"], "width": model["width"]}
            self.info(self.system.make("sensor_msgs/msg/CameraInfo", header=header, distortion_model="plumb_bob", d=np.zeros(5), k=k, **size))
            self.depth(self.image(self.scene.depth.astype("<u2"), "16UC1", ns))
            # Color is taken a few milliseconds later.
            self.color(self.image(self.scene.color[..., ::-1], "bgr8", ns + 3_000_000))
            self.sent += 1
            due = max(due + self.period, time.monotonic())
            self.over.wait(max(due - time.monotonic(), 0))

    def close(self):
        self.over.set()
        self.thread.join()


class Arm:
    """Seven joints that follow trajectories exactly, and fingers that something may hold apart."""

    def __init__(self, system, held_m=None):
        from system import ActionServer

        self.system, self.q_rad, self.finger_m, self.held_m = system, list(READY_RAD), 0.04, held_m
        self.refuse, self.stall = False, False
        self.over = threading.Event()
        self.joints = system.publisher("/joint_states", "sensor_msgs/msg/JointState")
        names = ("/arm/follow_joint_trajectory", "control_msgs/action/FollowJointTrajectory")
        self.arm = ActionServer(system, *names, self.follow, lambda goal: not self.refuse)
        self.hand = ActionServer(system, "/hand/gripper_cmd", "control_msgs/action/GripperCommand", self.grip)
        self.names = [f"panda_joint{i + 1}" for i in range(7)] + ["panda_finger_joint1", "panda_finger_joint2"]
        self.thread = threading.Thread(target=self._tell, daemon=True)
        self.thread.start()

    def _tell(self):
        while not self.over.wait(0.01):
            position = np.array([*self.q_rad, self.finger_m, self.finger_m])
            header = self.system.header("")
            self.joints(self.system.make("sensor_msgs/msg/JointState", header=header, name=self.names, position=position))

    def follow(self, goal, feedback, canceled):
        """Follows a trajectory in real time."""
        make, points = self.system.make, goal.trajectory.points
        times = [0.0] + [p.time_from_start.sec + p.time_from_start.nanosec * 1e-9 for p in points]
        places = [list(self.q_rad)] + [list(p.positions) for p in points]
        result = "control_msgs/action/FollowJointTrajectory_Result"
        if goal.trajectory.joint_names != self.names[:7] or any(b <= a for a, b in itertools.pairwise(times)):
            return ABORTED, make(result, error_code=-1, error_string="no trajectory")
        began = time.monotonic()
        while (t := time.monotonic() - began) < times[-1]:
            if canceled.wait(0.005):
                return CANCELED, make(result, error_string="canceled")
            if self.stall:
                return ABORTED, make(result, error_code=-4, error_string="a path tolerance was violated")
            i = min(bisect.bisect_right(times, t), len(times) - 1)
            share = (t - times[i - 1]) / (times[i] - times[i - 1])
            self.q_rad = [a + (b - a) * share for a, b in zip(places[i - 1], places[i])]
            actual = make("trajectory_msgs/msg/JointTrajectoryPoint", positions=np.array(self.q_rad))
            feedback(joint_names=self.names[:7], actual=actual)
        self.q_rad = places[-1]
        return SUCCEEDED, make(result)

    def grip(self, goal, feedback, canceled):
        """Moves the fingers at once, as far as what is between them lets them."""
        asked = goal.command.position
        held = self.held_m is not None and asked < self.held_m
        time.sleep(0.1)
        self.finger_m = self.held_m if held else asked
        result = "control_msgs/action/GripperCommand_Result"
        return SUCCEEDED, self.system.make(result, position=self.finger_m, stalled=held, reached_goal=not held)

    def close(self):
        self.over.set()
        self.thread.join()
