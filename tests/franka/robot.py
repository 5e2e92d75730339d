"""An FR3 of `franka-sim`: another's implementation of the robot's protocol, over MuJoCo, with limits of its own."""

import os
import pathlib
import signal
import socket
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree

import franka_sim
import mujoco


def write_arm(path):
    """The arm for MuJoCo, of the URDF that comes with `franka-sim`; its own model would be downloaded, with meshes that nothing here needs."""
    urdf = pathlib.Path(franka_sim.__file__).parent / "models" / "fr3.urdf"
    root = ElementTree.parse(urdf).getroot()
    for link in root.iter("link"):
        for part in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(part)
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", fusestatic="false")
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
    for joint in spec.joints:
        # As MuJoCo Menagerie has them for this arm.
        joint.armature, joint.damping, joint.frictionloss = 0.195, 0.21, 1.0
    spec.compile()
    path.write_text(spec.to_xml(), encoding="utf-8")


class Robot:
    """The robot's process, at one port."""

    # Between the fingers, metres.
    OBJECT_M = 0.04

    def __init__(self, folder, port, *options):
        self.folder, self.port, self.options, self.process = pathlib.Path(folder), port, options, None
        self.model = self.folder / "fr3.xml"
        if not self.model.exists():
            write_arm(self.model)

    def start(self, *options):
        command = [sys.executable, "-m", "franka_sim.run_server", "--port", str(self.port)]
        command += ["--enforce-motion-limits", "--gripper-object-width", str(self.OBJECT_M), *options]
        with open(self.folder / "robot.log", "ab") as log:
            environment = {**os.environ, "FR3_MJCF": str(self.model)}
            self.process = subprocess.Popen(command, stdout=log, stderr=log, env=environment, start_new_session=True)
        end = time.monotonic() + 60
        while time.monotonic() < end:
            assert self.process.poll() is None, self.log()
            with socket.socket() as trial:
                if trial.connect_ex(("127.0.0.1", self.port)) == 0:
                    return
            time.sleep(0.1)
        raise AssertionError(f"the robot does not listen: {self.log()}")

    def kill(self, how=signal.SIGKILL):
        if self.process is not None:
            self.process.send_signal(how)
            try:
                self.process.wait(20)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
            self.process = None

    def log(self):
        return (self.folder / "robot.log").read_text(encoding="utf-8", errors="replace")[-4000:]
