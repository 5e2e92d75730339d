"""Processes of Repose beside a ROS 2 system: two routers, the services, the bridge."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys

from system import DOMAIN, until

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "common"))
from robot_command import robot_command  # noqa: E402

REPOSE = os.environ["REPOSE"]


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


class Programs:
    """Processes of Repose, with their logs."""

    def __init__(self, folder):
        self.folder, self.running = folder, {}
        self.cell, self.ros = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
        self.config = os.path.join(folder, "repose.toml")
        with open(self.config, "w", encoding="utf-8") as out:
            out.write(CONFIG.format(domain=DOMAIN, ros=self.ros))

    def start_all(self, services):
        self.router("cell-router", self.cell)
        self.router("ros-router", self.ros)
        for name in services:
            self.service(name)

    def start(self, name, *arguments):
        with open(self.log_path(name), "ab") as log:
            self.running[name] = subprocess.Popen([REPOSE, *arguments], stdout=log, stderr=log)

    def router(self, name, endpoint):
        self.start(name, "serve", "router", "--connect", endpoint)
        host, port = endpoint.removeprefix("tcp/").split(":")

        def listens():
            with socket.socket() as trial:
                return trial.connect_ex((host, int(port))) == 0

        until(f"{name} listens", listens)

    def service(self, name):
        self.start(name, "serve", name, "--connect", self.cell, "--config", self.config)

    def end(self, name, how=signal.SIGTERM):
        process = self.running.pop(name)
        process.send_signal(how)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            # It is in no list any more: nobody else would end it.
            process.kill()
            process.wait()
            raise

    def robot(self, action):
        robot_command(REPOSE, self.cell, action)

    def robot_state(self):
        """The robot's state, if it shows one."""
        command = [REPOSE, "--json", "robot", "state", "--connect", self.cell]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        return json.loads(done.stdout) if done.returncode == 0 else None

    def log_path(self, name):
        return os.path.join(self.folder, f"{name}.log")

    def log(self, name):
        with open(self.log_path(name), encoding="utf-8") as log:
            return log.read()

    def close(self):
        for name in reversed(list(self.running)):
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.end(name)


CONFIG = """
[session]
mode = "client"
# Geometry alone, so that the figures are those of the bridge and not of a network for masks on a shared machine.
[perception.segmentation.learned]
enabled = false
# The tests end a way home midway, and may have to wait for a core before they get to it.
[motion]
recovery_scale = 0.1
[ros2]
domain = {domain}
allow_execute = true
[ros2.session]
mode = "client"
# As scripts/testing.sh has it for the cell's own: a bridge that waits some seconds for a core keeps its link.
lease_ms = 10000
connect = ["{ros}"]
[[ros2.cameras]]
name = "front"
depth = "/cam/depth/image_rect"
color = "/cam/color/image_rect"
info = "/cam/depth/camera_info"
[[ros2.cameras]]
name = "packed"
depth = "/cam/depth/image_rect/compressedDepth"
color = "/cam/color/image_rect/compressed"
info = "/cam/depth/camera_info"
[[ros2.cameras]]
name = "floats"
depth = "/floats/depth/image_rect/compressedDepth"
color = "/floats/color/image_rect/compressed"
info = "/cam/depth/camera_info"
[[ros2.cameras]]
name = "cloud"
cloud = "/cam/points"
[[ros2.robots]]
name = "panda"
trajectory_action = "/arm/follow_joint_trajectory"
gripper_action = "/hand/gripper_cmd"
world_from_base = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
"""
