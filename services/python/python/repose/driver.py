"""Robots and cameras of your own on a running system.

Subclass `Robot` (read joints, send joints, move the gripper) or `Camera` (take a picture), and `run` them::

    class MyRobot(repose.driver.Robot):
        def read_joints(self):
            return my_arm.positions()
        def send_joints(self, joints_rad, velocities_rad_s):
            my_arm.servo(joints_rad)

    repose.driver.run(MyRobot(), endpoint="tcp/127.0.0.1:7447")

The rules of the contract are kept here, by the code that the simulated robot runs on: who commands (one owner at a time, by epochs),
commands that come twice, late or in disorder, set-points interpolated at 1 kHz and checked against the arm's limits, stops that latch and
brake within the limits, an execution whose commander falls silent. A driver that has a loop of its own, such as a physics simulation,
calls `RobotDriver.step` from there instead.

The arm is a Franka Panda or Research 3 (FR3), or one with the same links that is driven like it: seven joints under its limits. Its
hand is Franka's: motion reckons with the shape of that, with fingers that open by 80 mm, and with the point between their tips, 103 mm
before the flange.
"""

from __future__ import annotations

import logging
import signal
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._arrays import joint_positions, rigid_transform
from .calls import connection_to
from .errors import InvalidArgument, ReposeError
from .frame import Frame

__all__ = ["Camera", "CameraDriver", "Cell", "Gripper", "Robot", "RobotDriver", "SetPoint", "Stop", "connect", "run"]

_log = logging.getLogger("repose.driver")

#: Between two steps of a robot that is run here, seconds.
STEP_S = 0.004
#: Longest time in which an arm comes to rest, seconds.
REST_S = 3.0
#: How long a camera that has no new picture is left alone, seconds.
LOOK_S = 0.01


@dataclass(frozen=True)
class Gripper:
    """What is known of a gripper.

    Attributes:
        width_m: Opening between the fingers, metres.
        settled: Whether it stands: at its commanded width, or against something.
        holding: Whether it stands against something before its commanded width.

    """

    width_m: float
    settled: bool = True
    holding: bool = False


@dataclass(frozen=True)
class Stop:
    """Why a robot is stopped: `kind` is ``estop`` or the name of the rule, `reason` the same for a person."""

    kind: str
    reason: str


@dataclass(frozen=True, eq=False)
class SetPoint:
    """What a step has sent to the robot.

    Attributes:
        joints_rad: Joint positions, radians, ``[7]``.
        velocities_rad_s: Joint velocities, radians a second, ``[7]``.
        mode: ``idle``, ``moving`` or ``stopped``.
        stop: Why it is stopped; ``None`` where it is not.

    """

    joints_rad: NDArray[np.float64]
    velocities_rad_s: NDArray[np.float64]
    mode: str
    stop: Stop | None


class Robot(ABC):
    """A robot of your own. Methods are called from one thread, one at a time; what they raise ends the driver.

    Attributes:
        name: Its name in the cell, ``[a-z0-9][a-z0-9_-]*``.
        model: ``panda`` or ``fr3``: under whose limits it moves, and what its state says that it is. Motion plans for the one that
            ``[motion] robot_model`` says, and moves no other.
        world_from_base: Where its base stands in the world, ``[4, 4]``; the identity, unless you say otherwise. Motion plans with its own
            setting, ``[motion] world_from_base``, and moves no robot that says another place; perception takes this one to know the
            arm in pictures.
        following_tolerance_rad: How far a joint may be from its set-point, radians, before the arm counts as not following and stops; 0.001
            to 1. At rest it is sent where it was measured then: more than it sags under its weight.
        starts_stopped: Whether a driver of it starts stopped (``driver_started``) until somebody has looked at the arm and resets it. A
            driver keeps nothing when it ends: one that is started again knows of no stop, task or object in the hand of before. Set it for
            an arm that could hurt somebody; a simulation goes without.

    """

    name: str = "panda"
    model: str = "panda"
    world_from_base: Any = np.eye(4)
    following_tolerance_rad: float = 0.1
    starts_stopped: bool = False

    @abstractmethod
    def read_joints(self) -> Any:
        """Return the measured joint positions, base outwards, radians, ``[7]``."""

    @abstractmethod
    def send_joints(self, joints_rad: NDArray[np.float64], velocities_rad_s: NDArray[np.float64]) -> None:
        """Send a set-point: joint positions (radians, ``[7]``) and velocities (radians a second, ``[7]``).

        Called at every step, at rest too; what is sent is within the arm's limits of position, velocity, acceleration and jerk where it
        is called every millisecond, and on the same curve where it is called less often.
        """

    def read_gripper(self) -> Gripper:
        """Return what is known of the gripper. Without one of your own: it stands where it was sent, and holds nothing."""
        return Gripper(getattr(self, "_sent_width_m", 0.08))

    def send_gripper(self, width_m: float, force_n: float) -> None:
        """Move the fingers to an opening (metres), and hold what is in the way with a force (newtons). Must not wait for them."""
        self._sent_width_m = width_m

    def on_stop(self, stop: Stop) -> None:  # noqa: B027
        """Hear of a stop, once, when it latches. The set-points that follow bring the arm to rest by themselves."""


class Camera(ABC):
    """A camera of your own. `read` is called from a thread of the camera's own.

    Attributes:
        name: Its name in the cell, ``[a-z0-9][a-z0-9_-]*``.
        period_s: Between two pictures, seconds.

    """

    name: str = "front"
    period_s: float = 0.2

    @abstractmethod
    def read(self) -> Frame | None:
        """Take a picture; ``None`` where there is no new one. Its name and, where it has none, its time are set by the driver."""


class RobotDriver:
    """A robot on its keys. Call `step` from your loop, or `run`; make one with `Cell.robot`.

    As a context it leaves the keys at the end of the block, after an arm that moves has come to rest::

        with cell.robot(MyRobot()) as robot:
            while not done:
                robot.step()
    """

    def __init__(self, cell: Cell, robot: Robot, *, state_period_s: float = 0.01) -> None:
        """Join a robot to its keys; `Cell.robot` does."""
        self.robot = robot
        pose = rigid_transform(robot.world_from_base, "world_from_base").ravel().tolist()
        self._side = _native.RobotSide(
            cell._connection,
            robot.name,
            self._read(),
            model=robot.model,
            world_from_base=pose,
            state_period_s=state_period_s,
            following_tolerance_rad=robot.following_tolerance_rad,
            starts_stopped=robot.starts_stopped,
        )
        self._stop: Stop | None = None

    def step(self, elapsed_s: float | None = None) -> SetPoint:
        """Read the robot, take the commands that have come, go on in time, and send the next set-point and gripper action.

        Args:
            elapsed_s: By how much robot time goes on, seconds: a simulation's step. Without it, by the time since the last step (at most
                60 ms: an arm whose loop was held up goes on where it was).

        """
        gripper = self.robot.read_gripper()
        state = (float(gripper.width_m), bool(gripper.settled), bool(gripper.holding))
        joints, velocities, mode, action, stop, refused = self._side.step(self._read(), state, elapsed_s)
        for why in refused:
            _log.debug("%s: not taken: %s", self.robot.name, why)
        point = SetPoint(np.array(joints), np.array(velocities), mode, None if stop is None else Stop(*stop))
        if action is not None:
            self.robot.send_gripper(*action)
        self.robot.send_joints(point.joints_rad, point.velocities_rad_s)
        if point.stop != self._stop:
            self._stop = point.stop
            if point.stop is not None:
                _log.warning("%s stopped: %s (%s)", self.robot.name, point.stop.reason, point.stop.kind)
                self.robot.on_stop(point.stop)
        return point

    def run(self, until: threading.Event | None = None, *, period_s: float = STEP_S) -> None:
        """Step in real time until the event is set, or for ever.

        An arm that moves when it ends comes to rest first, and is stopped (``driver_ended``): where its device has failed, as far as that
        still lets it.
        """
        due = time.monotonic()
        try:
            while until is None or not until.is_set():
                self.step()
                # From now where a step took longer than its period: what is lost is lost, and not made up for in a burst.
                due = max(due + period_s, time.monotonic())
                time.sleep(max(due - time.monotonic(), 0.0))
        except BaseException:
            self._end_at_error(period_s)
            raise
        self.end(period_s=period_s)

    def end(self, *, period_s: float = STEP_S) -> None:
        """Bring an arm that moves to rest, within its limits, by steps in real time.

        `run` does this when it ends; a loop of your own does it before `close`.
        """
        self._side.end()
        give_up = time.monotonic() + REST_S
        while time.monotonic() < give_up and self.step().velocities_rad_s.any():
            time.sleep(period_s)

    def close(self) -> None:
        """Leave the keys. The set-points of a robot that moves end with this, at whatever speed it has: `end` comes first."""
        self._side.close()

    def __enter__(self) -> RobotDriver:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            if error is None:
                self.end()
            else:
                self._end_at_error(STEP_S)
        finally:
            self.close()

    def _end_at_error(self, period_s: float) -> None:
        # A device that has failed may fail here again: it is the first error that says why.
        try:
            self.end(period_s=period_s)
        except Exception as at_end:
            _log.warning("%s was not brought to rest: %s", self.robot.name, at_end)

    def _read(self) -> list[float]:
        return joint_positions(self.robot.read_joints(), "read_joints")


class CameraDriver:
    """A camera on its key. Call `publish` from your loop, or `run`; make one with `Cell.camera`."""

    def __init__(self, cell: Cell, camera: Camera | str) -> None:
        """Join a camera to its key; `Cell.camera` does."""
        self._connection = cell._connection
        self.camera = None if isinstance(camera, str) else camera
        self.name = camera if isinstance(camera, str) else camera.name

    def publish(self, frame: Frame) -> None:
        """Put a picture on the camera's key, under its name; stamped with the time of now where it has no time."""
        self._connection.publish(frame._native.named(self.name, frame.stamp_ns or time.time_ns()))

    def run(self, until: threading.Event | None = None) -> None:
        """Take and publish pictures until the event is set, or for ever."""
        if self.camera is None:
            raise InvalidArgument("only a repose.driver.Camera can be run; a camera that is a name is for publish()", "camera")
        due = time.monotonic()
        while until is None or not until.is_set():
            frame = self.camera.read()
            if frame is not None:
                self.publish(frame)
                due = max(due + self.camera.period_s, time.monotonic())
            wait_s = LOOK_S if frame is None else max(due - time.monotonic(), 0.0)
            if until is None:
                time.sleep(wait_s)
            else:
                until.wait(wait_s)


class Cell:
    """A connection for drivers. Make one with `connect`."""

    def __init__(self, connection: _native.Connection) -> None:
        """Wrap a connection; `connect` does."""
        self._connection = connection

    def robot(self, robot: Robot, *, state_period_s: float = 0.01) -> RobotDriver:
        """Join a robot, which must be readable and at rest.

        Args:
            robot: The robot.
            state_period_s: Between two states that are published, seconds; at most 0.05.

        Raises:
            FailedPrecondition: Another driver of that name is there, or the robot stands outside its limits.
            InvalidArgument: A setting of the robot is out of its range; ``field`` says which.

        """
        return RobotDriver(self, robot, state_period_s=state_period_s)

    def camera(self, camera: Camera | str) -> CameraDriver:
        """Join a camera, or just a camera's name to publish frames under."""
        return CameraDriver(self, camera)

    def run(self, *devices: Robot | Camera, until: threading.Event | None = None) -> None:
        """Run devices, each in a thread of its own, until the event is set, Ctrl-C, or one of them fails."""
        ended = threading.Event() if until is None else until
        failed: list[BaseException] = []
        drivers = [self.robot(d) if isinstance(d, Robot) else self.camera(d) for d in devices]

        def guarded(driver: RobotDriver | CameraDriver) -> None:
            try:
                driver.run(ended)
            except BaseException as error:
                failed.append(error)
                ended.set()

        threads = [threading.Thread(target=guarded, args=(d,), daemon=True) for d in drivers]
        for thread in threads:
            thread.start()
        try:
            ended.wait()
        finally:
            ended.set()
            for thread in threads:
                thread.join()
            for driver in drivers:
                if isinstance(driver, RobotDriver):
                    driver.close()
        if failed:
            raise failed[0]

    def close(self) -> None:
        """End the session."""
        self._connection.close()

    def __enter__(self) -> Cell:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def connect(endpoint: str | Sequence[str] | None = None, *, cell: str | None = None, config: str | PathLike[str] | None = None) -> Cell:
    """Connect drivers to a running system; see `repose.connect`."""
    return Cell(connection_to(endpoint, cell, config))


def run(
    *devices: Robot | Camera,
    endpoint: str | Sequence[str] | None = None,
    cell: str | None = None,
    config: str | PathLike[str] | None = None,
) -> None:
    """Connect robots and cameras to a running system, and run them until Ctrl-C, or SIGTERM where the program does nothing else with it."""
    with _sigterm_as_ctrl_c(), connect(endpoint, cell=cell, config=config) as connected:
        try:
            connected.run(*devices)
        except KeyboardInterrupt:
            _log.info("interrupted")
        except ReposeError as error:
            _log.error("%s", error)
            raise


@contextmanager
def _sigterm_as_ctrl_c() -> Iterator[None]:
    # Services are ended by SIGTERM, which Python leaves to the system: the process would be gone with an arm on its way.
    is_free = threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    if is_free:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        if is_free:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
