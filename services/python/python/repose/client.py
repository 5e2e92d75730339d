"""A client of a running system, over Zenoh.

Calls are made by the code that Repose's services call each other with: the less loaded of two workers, another worker where one is gone or
silent, one deadline for all attempts, an answer or a typed error exactly once. `Client` waits; `repose.AsyncClient` is for asyncio.
"""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Iterator, Sequence
from os import PathLike
from types import TracebackType
from typing import Any

from . import _native
from .calls import Call, Calls, Execution, RobotState, robot_state_of, until, wanted_on
from .errors import DeadlineExceeded, Unavailable
from .local import motion_request, place_request
from .placements import Goal, MotionPlan, Placement, Plan
from .scene import Scene

__all__ = ["Client", "connect"]


class Client(Calls):
    """A client that waits for its answers. Safe to use from several threads. Make one with `connect`."""

    def latest(self, camera: str | None = None, *, deadline_s: float = 10.0) -> dict[str, Any]:
        """Return the summary of a camera's newest scene: ``scene_id``, ``objects``, ``surfaces``, ``stamp_ns``."""
        return until(lambda left: self._latest(camera, left).result(), deadline_s)

    def scene(self, scene_id: str | None = None, *, camera: str | None = None, deadline_s: float = 10.0) -> Scene:
        """Return a scene, whole: by its id, or a camera's newest."""
        ends = time.monotonic() + deadline_s
        found = scene_id or str(self.latest(camera, deadline_s=deadline_s)["scene_id"])
        return self._scene(found, max(ends - time.monotonic(), 0.001)).result()

    def place_call(
        self,
        scene: Scene | str | None = None,
        move: int | None = None,
        goal: Goal | None = None,
        *,
        say: str | None = None,
        deadline_s: float = 60.0,
        priority: str = "interactive",
        camera: str | None = None,
        **options: Any,
    ) -> Call[Plan]:
        """Start `place`, to follow its progress or cancel it."""
        if scene is None:
            scene = self.scene(camera=camera) if say is not None else str(self.latest(camera)["scene_id"])
        elif say is not None and not isinstance(scene, Scene):
            scene = self.scene(scene)
        move, terms, taken = wanted_on(scene, move, goal, say, options)
        scene_id = scene.id if isinstance(scene, Scene) else scene
        return self._place(scene, place_request(scene_id, move, terms, options), taken, deadline_s, priority)

    def place(self, scene: Scene | str | None = None, move: int | None = None, goal: Goal | None = None, **options: Any) -> Plan:
        """Ask a planner for placements.

        Args:
            scene: A scene (sent whole to a planner that lacks it), its id, or nothing for the newest of ``camera``.
            move: The object to move.
            goal: Terms that must all hold, as for `repose.plan`.
            options: ``say``, ``deadline_s`` (60), ``priority``, ``camera``, and the options of `repose.plan`.

        Raises:
            ReposeError: The typed error that the call ended in. No placement is no error: the plan is empty then.

        """
        return self.place_call(scene, move, goal, **options).result()

    def plan_motion(
        self,
        scene: Scene,
        placements: Plan | Sequence[Placement] | Any,
        start_joints_rad: Any = None,
        *,
        move: int | None = None,
        robot: str | None = None,
        grasps: list[dict[str, Any]] | None = None,
        seed: int = 0,
        deadline_s: float = 60.0,
    ) -> MotionPlan:
        """Plan the pick and place, from where the robot is unless ``start_joints_rad`` says otherwise; see `repose.plan_motion`."""
        robot = self.robot if robot is None else robot
        start = self.robot_state(robot).joints_rad if start_joints_rad is None else start_joints_rad
        request = motion_request(scene.id, placements, start, move, robot, grasps, seed)
        call = self.call("motion", "plan", "MotionPlanRequest.v1", request, deadline_s=deadline_s, scene=scene)
        return MotionPlan(call.answer().content.decode())

    def execute_call(self, plan: MotionPlan) -> Call[Execution]:
        """Start `execute`, to follow its progress; cancelling brings the robot to a stop."""
        return self._execute(plan)

    def execute(self, plan: MotionPlan) -> Execution:
        """Have the robot carry a plan out. It moves."""
        return self._execute(plan).result()

    def segment(self, frame: bytes, *, deadline_s: float = 10.0) -> Scene:
        """Have perception segment a frame in its wire form."""
        return Scene.from_bytes(Call(self._connection.segment(frame, deadline_s), lambda a: a.content).result())

    def watch_scene(self, camera: str | None = None, *, timeout_s: float | None = None) -> Iterator[dict[str, Any]]:
        """Go through a camera's scene summaries as they are published, the newest only; ends when none comes for ``timeout_s``."""
        for content in self._watch("scene", self.camera if camera is None else camera, timeout_s):
            yield json.loads(content)

    def watch_robot(self, robot: str | None = None, *, timeout_s: float | None = None) -> Iterator[RobotState]:
        """Go through a robot's states as they are published, the newest only; ends when none comes for ``timeout_s``."""
        for content in self._watch("robot_state", self.robot if robot is None else robot, timeout_s):
            yield robot_state_of(content)

    def robot_state(self, robot: str | None = None, *, timeout_s: float = 5.0) -> RobotState:
        """Return what a robot says of itself next."""
        for state in self.watch_robot(robot, timeout_s=timeout_s):
            return state
        raise Unavailable(f"robot {robot or self.robot} does not tell its state")

    def stop(self, robot: str | None = None, reason: str = "asked for", *, timeout_s: float = 5.0) -> RobotState:
        """Stop a robot in an emergency. The stop latches until `reset`. It is repeated until the robot shows it.

        Raises:
            DeadlineExceeded: The robot has not shown the stop within ``timeout_s``. It was sent all the same.

        """
        robot = self.robot if robot is None else robot
        id = str(uuid.uuid4())
        ends = time.monotonic() + timeout_s
        states = self._connection.subscribe("robot_state", robot, True)
        while time.monotonic() < ends:
            self._stop_once(robot, id, reason)
            heard = states.recv(0.1)
            if heard is not None and (state := robot_state_of(heard[2])).mode == "stopped":
                return state
        raise DeadlineExceeded(f"robot {robot} has not shown the stop within {timeout_s} s")

    def reset(self, robot: str | None = None) -> None:
        """Clear a latched stop."""
        self._reset(robot).result()

    def _watch(self, kind: str, name: str, timeout_s: float | None) -> Iterator[bytes]:
        subscription = self._connection.subscribe(kind, name, True)
        try:
            while (message := subscription.recv(timeout_s)) is not None:
                yield message[2]
        finally:
            subscription.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def connect(
    endpoint: str | Sequence[str] | None = None,
    *,
    cell: str | None = None,
    config: str | PathLike[str] | None = None,
    camera: str = "front",
    robot: str = "panda",
) -> Client:
    """Connect to a running system.

    Args:
        endpoint: A router of the deployment, ``tcp/192.168.1.5:7447``, or several to try; without it the configuration's, or
            ``tcp/127.0.0.1:7447``.
        cell: The robot cell; ``cell`` where nothing says otherwise.
        config: A configuration file (TOML) with the sections ``[session]`` and ``[caller]``: TLS, user, password, retries.
        camera: The camera that is meant where a call names none.
        robot: The robot that is meant where a call names none.

    Raises:
        Unavailable: No router answers there.

    """
    return Client(connection_to(endpoint, cell, config), camera, robot)


def connection_to(endpoint: str | Sequence[str] | None, cell: str | None, config: str | PathLike[str] | None) -> _native.Connection:
    endpoints = [endpoint] if isinstance(endpoint, str) else list(endpoint or [])
    return _native.Connection(endpoints, cell, config)
