"""Robots and cameras of one's own on a running system that has neither."""

import importlib.util
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from conftest import System

import repose
from repose import driver

READY_RAD = np.array([0.0, -0.785398163, 0.0, -2.35619449, 0.0, 1.570796327, 0.785398163])
EXAMPLES = Path(__file__).parents[1] / "examples"


class Arm(driver.Robot):
    """An arm that is where it was sent a moment ago, with fingers that find something 50 mm wide."""

    THING_M = 0.05

    def __init__(self, name: str, start_rad=READY_RAD, lag: float = 0.5) -> None:
        self.name, self.lag = name, lag
        self.joints_rad = np.array(start_rad, dtype=float)
        self.sent: list[np.ndarray] = []
        self.velocities_rad_s = np.zeros(7)
        self.width_m, self.wanted_m = 0.08, 0.08
        self.stops: list[driver.Stop] = []
        self.held_fast = False

    def read_joints(self):
        return self.joints_rad

    def send_joints(self, joints_rad, velocities_rad_s):
        self.sent.append(joints_rad)
        self.velocities_rad_s = velocities_rad_s
        if not self.held_fast:
            self.joints_rad = self.joints_rad + self.lag * (joints_rad - self.joints_rad)

    def read_gripper(self):
        return driver.Gripper(self.width_m, settled=True, holding=self.wanted_m < self.THING_M == self.width_m)

    def send_gripper(self, width_m, force_n):
        assert force_n > 0
        self.wanted_m = width_m
        self.width_m = max(width_m, self.THING_M)

    def on_stop(self, stop):
        self.stops.append(stop)


@pytest.fixture(scope="module")
def system(repose_program):
    with System(repose_program, "--no-simulator") as system:
        yield system


@pytest.fixture(scope="module")
def client(system):
    with repose.connect(system.endpoint) as client:
        system.wait_for(client, "perception", "planner", "inference", "motion")
        yield client


@pytest.fixture
def running(system):
    """Run devices until the test has ended."""
    ended, threads = threading.Event(), []

    def run(*devices):
        cell = driver.connect(system.endpoint)
        thread = threading.Thread(target=cell.run, args=devices, kwargs={"until": ended})
        threads.append((thread, cell))
        thread.start()

    yield run
    ended.set()
    for thread, cell in threads:
        thread.join()
        cell.close()


def example(name: str):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def limits_kept(sent: list[np.ndarray]) -> bool:
    """No joint faster than the Panda's fastest, whatever the step was: the driver's is 4 ms."""
    steps = np.abs(np.diff(np.array(sent), axis=0))
    return bool((steps <= 2.61 * 0.075).all())


def test_an_arm_of_ones_own_is_brought_home_by_motion(client, running):
    start = READY_RAD + np.array([0.4, 0.1, 0, 0, 0, 0.1, 0])
    arm = Arm("away", start)
    running(arm)
    np.testing.assert_allclose(client.robot_state("away").joints_rad, start)
    ended = client.recover("home", robot="away")
    assert ended.outcome == "done", ended.reason
    np.testing.assert_allclose(arm.joints_rad, READY_RAD, atol=1e-3)
    assert limits_kept(arm.sent)
    assert len(arm.sent) > 50


def test_an_arm_says_which_model_it_is_and_is_not_moved_by_plans_for_another(client, system, running):
    arm = Arm("research")
    arm.model = "fr3"
    running(arm)
    client.robot_state("research")
    with pytest.raises(repose.FailedPrecondition, match="fr3"):
        client.recover("open", robot="research")
    with driver.connect(system.endpoint) as cell:
        arm.model = "ur5"
        with pytest.raises(repose.InvalidArgument) as raised:
            cell.robot(arm)
        assert raised.value.field == "model"


def test_an_arm_that_would_be_sent_wherever_it_sags_is_refused(system):
    arm = Arm("sagging")
    with driver.connect(system.endpoint) as cell:
        for tolerance_rad in (0.0, -0.1, float("nan"), 3.0):
            arm.following_tolerance_rad = tolerance_rad
            with pytest.raises(repose.InvalidArgument) as raised:
                cell.robot(arm)
            assert raised.value.field == "following_tolerance_rad"


def test_a_stop_latches_brakes_and_is_heard_of(client, running):
    arm = Arm("stopped", READY_RAD + np.array([1.2, 0, 0, 0, 0, 0, 0]))
    running(arm)
    client.robot_state("stopped")
    homing = threading.Thread(target=lambda: client.recover("home", robot="stopped"))
    homing.start()
    while client.robot_state("stopped").mode != "moving":
        assert homing.is_alive()
    state = client.stop("stopped", "a test")
    homing.join()
    assert state.stop is not None
    assert state.stop["kind"] == "estop"
    # The stop is told as soon as it latches; the arm's own code hears of it in its next cycle.
    heard_by = time.monotonic() + 5.0
    while not arm.stops and time.monotonic() < heard_by:
        time.sleep(0.01)
    assert [s.kind for s in arm.stops] == ["estop"]
    assert "a test" in arm.stops[0].reason
    assert np.abs(arm.joints_rad - READY_RAD).max() > 0.01
    with pytest.raises(repose.FailedPrecondition):
        client.recover("home", robot="stopped")
    assert client.reset("stopped")
    assert client.recover("home", robot="stopped").outcome == "done"


def test_an_arm_that_starts_stopped_moves_once_somebody_has_reset_it(client, running):
    arm = Arm("found", READY_RAD + np.array([0.3, 0, 0, 0, 0, 0, 0]))
    arm.starts_stopped = True
    running(arm)
    state = client.robot_state("found")
    assert state.stop is not None
    assert state.stop["kind"] == "driver_started"
    with pytest.raises(repose.FailedPrecondition):
        client.recover("home", robot="found")
    assert client.reset("found")
    assert client.recover("home", robot="found").outcome == "done"


def test_an_arm_that_does_not_follow_stops_by_itself(client, running):
    arm = Arm("stuck", READY_RAD + np.array([1.2, 0, 0, 0, 0, 0, 0]))
    arm.held_fast = True
    running(arm)
    client.robot_state("stuck")
    ended = client.recover("home", robot="stuck")
    assert ended.outcome == "stopped"
    assert [s.kind for s in arm.stops] == ["following_error"]


def test_a_second_driver_of_a_robot_is_refused(system, client, running):
    running(Arm("taken"))
    client.robot_state("taken")
    with driver.connect(system.endpoint) as other, pytest.raises(repose.FailedPrecondition) as raised:
        other.robot(Arm("taken"))
    assert raised.value.field == "name"


def test_what_a_robot_cannot_be_is_refused_by_name(system):
    class Wordy(Arm):
        def read_joints(self):
            return ["ready"] * 7

    with driver.connect(system.endpoint) as cell:
        for arm, kind, field in [
            (Arm("No Name"), repose.InvalidArgument, "name"),
            (Arm("short", READY_RAD[:6]), repose.InvalidArgument, "read_joints"),
            (Wordy("wordy"), repose.InvalidArgument, "read_joints"),
            (Arm("outside", READY_RAD + 3), repose.FailedPrecondition, "joints_rad"),
        ]:
            with pytest.raises(kind) as raised:
                cell.robot(arm)
            assert raised.value.field == field
        with pytest.raises(repose.InvalidArgument) as raised:
            cell.robot(Arm("seldom"), state_period_s=0.2)
        assert raised.value.field == "state_period_s"
        joined = cell.robot(Arm("stepper"))
        with pytest.raises(repose.InvalidArgument) as raised:
            joined.step(-0.1)
        assert raised.value.field == "elapsed_s"


def test_robot_time_is_the_simulations_where_it_says_so(system, client):
    with driver.connect(system.endpoint) as cell:
        joined = cell.robot(Arm("simulated"), state_period_s=0.0)

        def robot_ms() -> float:
            """Robot time, told while it stands still."""
            told = threading.Event()

            def tell():
                while not told.is_set():
                    joined.step(0.0)

            telling = threading.Thread(target=tell)
            telling.start()
            try:
                return client.robot_state("simulated").data["robot_ms"]
            finally:
                told.set()
                telling.join()

        before = robot_ms()
        for _ in range(240):
            point = joined.step(1 / 240)
        assert point.mode == "idle"
        assert robot_ms() - before == pytest.approx(1000.0, abs=2)


def test_a_device_that_fails_ends_the_run_with_its_error(system):
    class Broken(Arm):
        def send_joints(self, joints_rad, velocities_rad_s):
            raise OSError("the cable is off")

    with driver.connect(system.endpoint) as cell, pytest.raises(OSError, match="cable"):
        cell.run(Broken("broken"))


def test_an_arm_that_moves_comes_to_rest_when_a_camera_beside_it_ends_the_run(system, client):
    class Unplugged(driver.Camera):
        name, period_s = "unplugged", 0.02
        out = threading.Event()

        def read(self):
            if self.out.is_set():
                raise RuntimeError("the cable is out")

    arm, raised = Arm("beside", READY_RAD + np.array([1.2, 0, 0, 0, 0, 0, 0])), []

    def run():
        with driver.connect(system.endpoint) as cell:
            try:
                cell.run(arm, Unplugged())
            except RuntimeError as error:
                raised.append(error)

    def home():
        with suppress(repose.ReposeError):
            client.recover("home", robot="beside")

    running, homing = threading.Thread(target=run), threading.Thread(target=home)
    running.start()
    start = client.robot_state("beside").joints_rad
    homing.start()
    give_up = time.monotonic() + 30
    while np.abs(arm.joints_rad - start).max() < 0.1:
        assert time.monotonic() < give_up
        time.sleep(0.01)
    Unplugged.out.set()
    running.join()
    homing.join()
    assert str(raised[0]) == "the cable is out"
    assert [s.kind for s in arm.stops] == ["driver_ended"]
    assert not arm.velocities_rad_s.any(), "it stands"
    assert limits_kept(arm.sent)


def test_an_arm_that_moves_comes_to_rest_at_the_end_of_its_block(system, client):
    arm = Arm("block", READY_RAD + np.array([1.2, 0, 0, 0, 0, 0, 0]))

    def home():
        with suppress(repose.ReposeError):
            client.robot_state("block")
            client.recover("home", robot="block")

    def step_until_it_moves():
        with driver.connect(system.endpoint) as cell, cell.robot(arm) as joined:
            homing.start()
            give_up = time.monotonic() + 30
            while not joined.step().velocities_rad_s.any():
                assert time.monotonic() < give_up
                time.sleep(driver.STEP_S)
            raise OSError("the simulation has ended")

    homing = threading.Thread(target=home)
    with pytest.raises(OSError, match="simulation"):
        step_until_it_moves()
    homing.join()
    assert [s.kind for s in arm.stops] == ["driver_ended"]
    assert not arm.velocities_rad_s.any(), "it stands"
    assert limits_kept(arm.sent)


def test_an_arm_that_moves_comes_to_rest_where_its_gripper_fails_once(system, client):
    class Loose(Arm):
        fails = threading.Event()

        def read_gripper(self):
            if self.fails.is_set():
                self.fails.clear()
                raise OSError("the gripper does not answer")
            return super().read_gripper()

    arm, raised = Loose("loose", READY_RAD + np.array([1.2, 0, 0, 0, 0, 0, 0])), []

    def run():
        with driver.connect(system.endpoint) as cell:
            try:
                cell.run(arm)
            except OSError as error:
                raised.append(error)

    def home():
        with suppress(repose.ReposeError):
            client.recover("home", robot="loose")

    running, homing = threading.Thread(target=run), threading.Thread(target=home)
    running.start()
    client.robot_state("loose")
    homing.start()
    give_up = time.monotonic() + 30
    while not arm.velocities_rad_s.any():
        assert time.monotonic() < give_up
        time.sleep(0.01)
    arm.fails.set()
    running.join()
    homing.join()
    assert str(raised[0]) == "the gripper does not answer"
    assert [s.kind for s in arm.stops] == ["driver_ended"]
    assert not arm.velocities_rad_s.any(), "it stands"
    assert limits_kept(arm.sent)


SERVICE = """
import sys
from repose import driver
from test_driver import READY_RAD, Arm

arm = Arm("service", READY_RAD + [1.2, 0, 0, 0, 0, 0, 0])
driver.run(arm, endpoint=sys.argv[1])
print(arm.velocities_rad_s.any(), *[s.kind for s in arm.stops])
"""


def test_an_arm_that_moves_comes_to_rest_when_its_driver_is_ended_as_a_service_is(system, client):
    def home():
        with suppress(repose.ReposeError):
            client.recover("home", robot="service")

    command = [sys.executable, "-c", SERVICE, system.endpoint]
    with subprocess.Popen(command, cwd=Path(__file__).parent, stdout=subprocess.PIPE, text=True) as service:
        start = client.robot_state("service", timeout_s=30).joints_rad
        homing = threading.Thread(target=home)
        homing.start()
        give_up = time.monotonic() + 30
        while np.abs(client.robot_state("service").joints_rad - start).max() < 0.05:
            assert time.monotonic() < give_up
        service.send_signal(signal.SIGTERM)
        said, _ = service.communicate(timeout=30)
        homing.join()
    assert (said.split(), service.returncode) == (["False", "driver_ended"], 0)


def test_pick_and_place_with_a_camera_and_an_arm_of_ones_own(client, running, view, frame_folder, tmp_path):
    shutil.copytree(frame_folder, tmp_path / "frames" / "001")
    camera = example("folder_camera").FolderCamera(tmp_path / "frames", "desk", again=True)
    arm = Arm("panda")
    running(arm, camera)
    scene = client.scene(camera="desk")
    assert [o.id for o in scene.objects] == [1, 2, 3]
    plan = client.place(scene, 1, [("left_of", 2)], count=5, seed=5)
    motion = client.plan_motion(scene, plan)
    phases = []
    call = client.execute_call(motion)
    for step in call.progress():
        phases.append(step["phase"])
    ended = call.result()
    assert ended.outcome == "done", ended.reason
    assert phases[0] == "standoff"
    assert phases[-1] in ("retreat", "home")
    np.testing.assert_allclose(arm.joints_rad, motion.phases[-1].joints_rad[-1], atol=2e-3)
    assert limits_kept(arm.sent)


def test_an_arm_in_a_text_file_is_moved_and_moves_by_hand(client, running, tmp_path):
    file = tmp_path / "joints.txt"
    text_robot = example("text_robot")
    file.write_text(" ".join(str(q) for q in READY_RAD + np.array([0.2, 0, 0, 0, 0, 0, 0])) + "\n")
    running(text_robot.TextRobot(file, "text"))
    assert client.recover("home", robot="text").outcome == "done"
    np.testing.assert_allclose(np.array(file.read_text().split(), dtype=float), READY_RAD, atol=1e-3)
    by_hand = READY_RAD + np.array([0, 0.3, 0, 0, 0, 0, 0])
    new = tmp_path / "by_hand"
    new.write_text(" ".join(str(q) for q in by_hand))
    new.replace(file)
    ends = time.monotonic() + 10
    for state in client.watch_robot("text", timeout_s=5):
        if np.allclose(state.joints_rad, by_hand, atol=1e-3):
            break
        assert time.monotonic() < ends, state.joints_rad
    assert client.recover("home", robot="text").outcome == "done"
