"""Calls to a running system, and what both clients make of them."""

from __future__ import annotations

import asyncio
import json
import time
import uuid
from collections.abc import AsyncIterator, Callable, Generator, Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from . import _native
from .errors import InvalidArgument, NotFound, ReposeError, Unavailable
from .local import wanted
from .placements import Goal, MotionPlan, Plan, Taken
from .scene import Scene

__all__ = ["Answer", "Call", "Calls", "Execution", "RobotState"]

#: How long an execution may take, seconds; the longest that a call may.
EXECUTION_S = 600.0

T = TypeVar("T")


@dataclass(frozen=True)
class Answer:
    """What a worker answered.

    Attributes:
        data: The result's JSON, read; ``None`` for a bulk result.
        content: The bytes as they came.
        schema: The result's schema, ``PlaceResult.v1``.
        worker: The worker that answered.
        attempts: How many attempts it took.
        timing_ms: Milliseconds by stage, as the worker counted them.

    """

    data: Any
    content: bytes
    schema: str
    worker: str
    attempts: int
    timing_ms: dict[str, float]


@dataclass(frozen=True)
class Execution:
    """How an execution ended: ``outcome`` is ``done``, ``stopped`` or ``grasp_lost``."""

    outcome: str
    reason: str | None
    data: dict[str, Any]


@dataclass(frozen=True)
class RobotState:
    """What a robot says of itself.

    Attributes:
        joints_rad: Joint positions, radians, ``[7]``.
        velocities_rad_s: Joint velocities, ``[7]``.
        gripper_width_m: Opening, metres.
        mode: ``idle``, ``moving`` or ``stopped``.
        stop: Why it is stopped: ``kind``, ``reason``; ``None`` where it is not.
        data: Everything, as it travels.

    """

    joints_rad: NDArray[np.float64]
    velocities_rad_s: NDArray[np.float64]
    gripper_width_m: float
    mode: str
    stop: dict[str, Any] | None
    data: dict[str, Any]


class Call(Generic[T]):
    """A call under way: wait for its `result`, or await it; go through its `progress`; `cancel` it."""

    def __init__(self, pending: _native.Pending, read: Callable[[Answer], T]) -> None:
        """Wrap a native call; private."""
        self._pending = pending
        self._read = read
        self._answer: Answer | None = None

    def result(self, timeout_s: float | None = None) -> T:
        """Wait for the result.

        Raises:
            ReposeError: The typed error that the call ended in.
            TimeoutError: It has not ended within ``timeout_s``; it goes on.

        """
        return self._read(self.answer(timeout_s))

    def answer(self, timeout_s: float | None = None) -> Answer:
        """Wait for the result together with who gave it."""
        if self._answer is None:
            try:
                ended = self._pending.wait(timeout_s)
            except KeyboardInterrupt:
                self._pending.cancel()
                raise
            if ended is None:
                raise TimeoutError(f"the call has not ended within {timeout_s} s")
            schema, bulk, content, worker, attempts, timing_ms = ended
            data = None if bulk else json.loads(content)
            self._answer = Answer(data, content, schema, worker, attempts, timing_ms)
        return self._answer

    def progress(self) -> Iterator[dict[str, Any]]:
        """Go through the progress replies as they come, until the call ends."""
        while (reply := self._pending.next_progress()) is not None:
            yield json.loads(reply)

    def done(self) -> bool:
        """Whether the call has ended."""
        return self._pending.done()

    def cancel(self) -> None:
        """End the call with `repose.Cancelled`, and tell its worker."""
        self._pending.cancel()

    def __await__(self) -> Generator[Any, None, T]:
        return self._ended().__await__()

    async def _ended(self) -> T:
        loop = asyncio.get_running_loop()
        ended = loop.create_future()

        def wake() -> None:
            if not ended.done():
                ended.set_result(None)

        def call_back() -> None:
            # A loop that is closed waits for nothing.
            if not loop.is_closed():
                loop.call_soon_threadsafe(wake)

        self._pending.on_done(call_back)
        try:
            await ended
        except asyncio.CancelledError:
            self._pending.cancel()
            raise
        return self.result(0)

    async def aprogress(self) -> AsyncIterator[dict[str, Any]]:
        """Go through the progress replies in asyncio."""
        while (reply := await asyncio.to_thread(self._pending.next_progress)) is not None:
            yield json.loads(reply)


class Calls:
    """The calls that both clients make."""

    def __init__(self, connection: _native.Connection, camera: str, robot: str) -> None:
        self._connection = connection
        self.camera = camera
        self.robot = robot

    @property
    def cell(self) -> str:
        """The robot cell."""
        return self._connection.cell

    def workers(self, service: str) -> list[str]:
        """Return the names of a service's workers that are alive."""
        return self._connection.workers(service)

    def call(
        self,
        service: str,
        method: str,
        schema: str,
        request: dict[str, Any],
        *,
        deadline_s: float = 10.0,
        priority: str = "interactive",
        idempotent: bool = True,
        scene: Scene | None = None,
        worker: str | None = None,
        id: str | None = None,
        everyone: bool = False,
    ) -> Call[Answer]:
        """Start any call of the contract.

        Args:
            service: ``perception``, ``inference``, ``planner``, ``motion`` or ``simulator``.
            method: The method.
            schema: The request's schema, ``PlaceRequest.v1``.
            request: The request.
            deadline_s: When the answer must be there, seconds from now, for all attempts together.
            priority: ``interactive`` or ``batch``.
            idempotent: Whether it may be computed twice, and so be tried again on another worker. Never for what moves a robot.
            scene: Sent whole to a worker that does not hold it.
            worker: This worker only.
            id: The request's id.
            everyone: Ask every worker, and take the first result: whoever holds what is asked for.

        """
        body = json.dumps(request, allow_nan=False).encode()
        pending = self._connection.call(
            service,
            method,
            schema,
            body,
            deadline_s=deadline_s,
            priority=priority,
            idempotent=idempotent,
            scene=None if scene is None else scene._native,
            worker=worker,
            id=id,
            everyone=everyone,
        )
        return Call(pending, lambda answer: answer)

    def _latest(self, camera: str | None, deadline_s: float) -> Call[dict[str, Any]]:
        request = {"camera": self.camera if camera is None else camera}
        call = self.call("perception", "latest", "LatestRequest.v1", request, deadline_s=deadline_s, everyone=True)
        return Call(call._pending, lambda answer: dict(answer.data))

    def _scene(self, scene_id: str, deadline_s: float) -> Call[Scene]:
        call = self.call("perception", "scene", "SceneRequest.v1", {"scene_id": scene_id}, deadline_s=deadline_s, everyone=True)
        return Call(call._pending, lambda answer: Scene.from_bytes(answer.content))

    def _place(self, scene: Scene | str, request: dict[str, Any], taken: list[Taken], deadline_s: float, priority: str) -> Call[Plan]:
        whole = scene if isinstance(scene, Scene) else None
        call = self.call("planner", "place", "PlaceRequest.v1", request, deadline_s=deadline_s, priority=priority, scene=whole)
        return Call(call._pending, lambda answer: Plan(answer.content.decode(), taken))

    def _execute(self, plan: MotionPlan) -> Call[Execution]:
        call = self.call("motion", "execute", "MotionPlan.v1", plan.data, deadline_s=EXECUTION_S, idempotent=False)
        return Call(call._pending, lambda a: Execution(a.data["outcome"], a.data.get("reason"), a.data))

    def _reset(self, robot: str | None) -> Call[Any]:
        call = self.call("motion", "reset", "RobotResetRequest.v1", {"robot": robot or self.robot}, idempotent=False)
        return Call(call._pending, lambda answer: answer.data)

    def close(self) -> None:
        """End the session."""
        self._connection.close()

    def _stop_once(self, robot: str, id: str, reason: str) -> None:
        stop = {"v": 1, "id": id, "source": f"python-{uuid.uuid4().hex[:8]}", "reason": reason, "stamp_ns": time.time_ns()}
        self._connection.put("robot_estop", robot, "EmergencyStop.v1", json.dumps(stop).encode(), False)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of cell {self.cell}>"


def robot_state_of(content: bytes) -> RobotState:
    data = json.loads(content)
    return RobotState(np.array(data["q_rad"]), np.array(data["dq_rad_s"]), data["gripper_width_m"], data["mode"], data.get("stop"), data)


def wanted_on(
    scene: Scene | str, move: int | None, goal: Goal | None, say: str | None, options: dict[str, Any]
) -> tuple[int, Goal, list[Taken]]:
    if isinstance(scene, Scene):
        return wanted(scene, move, goal, say, options.get("view_yaw_rad"))
    if move is None or goal is None:
        raise InvalidArgument("give move and goal, or say", "move" if move is None else "goal")
    return move, goal, []


def may_come(error: ReposeError, ends: float) -> bool:
    """Whether what nobody has yet may still come: a camera's first scene, a first worker."""
    return isinstance(error, NotFound | Unavailable) and time.monotonic() < ends


def until(ask: Callable[[float], T], deadline_s: float) -> T:
    ends = time.monotonic() + deadline_s
    while True:
        try:
            return ask(max(ends - time.monotonic(), 0.001))
        except ReposeError as error:
            if not may_come(error, ends):
                raise
        time.sleep(0.1)
