"""What the live tests share: the processes, a ROS 2 system of their own, a camera and an arm in it."""

import os
import subprocess

import pytest
from definitions import store
from mocks import Arm, Camera, Scene
from programs import REPOSE, Programs
from system import Seen, System, until


@pytest.fixture(scope="session")
def types():
    return store()


@pytest.fixture(scope="session")
def scene():
    return Scene()


@pytest.fixture(scope="session")
def programs(tmp_path_factory):
    folder = os.environ.get("ROS2_LOGS") or str(tmp_path_factory.mktemp("logs"))
    os.makedirs(folder, exist_ok=True)
    made = Programs(folder)
    try:
        made.start_all(("perception", "inference", "planner", "motion", "ros2"))
        yield made
    finally:
        made.close()


@pytest.fixture(scope="session")
def system(types, programs):
    made = System(types, programs.ros)
    yield made
    made.close()


@pytest.fixture(scope="session")
def arm(system, programs):
    made = Arm(system, held_m=0.015)
    # A bridge starts stopped, and shows no state before it has heard of the joints.
    reset = [REPOSE, "robot", "reset", "--connect", programs.cell]
    until("a reset", lambda: subprocess.run(reset, capture_output=True, timeout=30).returncode == 0)
    yield made
    made.close()


@pytest.fixture
def camera(system, scene):
    """Five pictures a second; where it stands was told when the first camera came."""
    made = Camera(system, scene, rate=5, static=False)
    yield made
    made.close()


@pytest.fixture(scope="session")
def diagnostics(system):
    return Seen(system, "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
