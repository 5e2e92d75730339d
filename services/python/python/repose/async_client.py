"""A client of a running system for asyncio."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Sequence
from os import PathLike
from types import TracebackType
from typing import Any

from .calls import Call, Calls, Execution, RobotState, may_come, robot_state_of, wanted_on
from .client import Client, connection_to
from .errors import ReposeError, Unavailable
from .local import motion_request, place_request
from .placements import Goal, MotionPlan, Placement, Plan
from .scene import Scene

__all__ = ["AsyncClient", "connect_async"]


class AsyncClient(Calls):
    """A client for asyncio: what `Client` waits for, this one awaits. Cancelling the task cancels the call at its worker."""

    async def latest(self, camera: str | None = None, *, deadline_s: float = 10.0) -> dict[str, Any]:
        """See `Client.latest`."""
        ends = time.monotonic() + deadline_s
        while True:
            try:
                return await self._latest(camera, max(ends - time.monotonic(), 0.001))
            except ReposeError as error:
                if not may_come(error, ends):
                    raise
            await asyncio.sleep(0.1)

    async def scene(self, scene_id: str | None = None, *, camera: str | None = None, deadline_s: float = 10.0) -> Scene:
        """See `Client.scene`."""
        ends = time.monotonic() + deadline_s
        found = scene_id or str((await self.latest(camera, deadline_s=deadline_s))["scene_id"])
        return await self._scene(found, max(ends - time.monotonic(), 0.001))

    async def place(
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
    ) -> Plan:
        """See `Client.place`."""
        return await (await self.place_call(scene, move, goal, say=say, deadline_s=deadline_s, priority=priority, camera=camera, **options))

    async def place_call(
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
            scene = await self.scene(camera=camera) if say is not None else str((await self.latest(camera))["scene_id"])
        elif say is not None and not isinstance(scene, Scene):
            scene = await self.scene(scene)
        move, terms, taken = wanted_on(scene, move, goal, say, options)
        scene_id = scene.id if isinstance(scene, Scene) else scene
        return self._place(scene, place_request(scene_id, move, terms, options), taken, deadline_s, priority)

    async def plan_motion(
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
        """See `Client.plan_motion`."""
        robot = self.robot if robot is None else robot
        start = (await self.robot_state(robot)).joints_rad if start_joints_rad is None else start_joints_rad
        request = motion_request(scene.id, placements, start, move, robot, grasps, seed)
        answer = await self.call("motion", "plan", "MotionPlanRequest.v1", request, deadline_s=deadline_s, scene=scene)
        return MotionPlan(answer.content.decode())

    async def execute(self, plan: MotionPlan) -> Execution:
        """See `Client.execute`."""
        return await self._execute(plan)

    async def watch_scene(self, camera: str | None = None) -> AsyncIterator[dict[str, Any]]:
        """See `Client.watch_scene`."""
        async for content in self._watch("scene", self.camera if camera is None else camera):
            yield json.loads(content)

    async def watch_robot(self, robot: str | None = None) -> AsyncIterator[RobotState]:
        """See `Client.watch_robot`."""
        async for content in self._watch("robot_state", self.robot if robot is None else robot):
            yield robot_state_of(content)

    async def robot_state(self, robot: str | None = None, *, timeout_s: float = 5.0) -> RobotState:
        """See `Client.robot_state`."""
        subscription = self._connection.subscribe("robot_state", self.robot if robot is None else robot, True)
        heard = await asyncio.to_thread(subscription.recv, timeout_s)
        if heard is None:
            raise Unavailable(f"robot {robot or self.robot} does not tell its state")
        return robot_state_of(heard[2])

    async def stop(self, robot: str | None = None, reason: str = "asked for", *, timeout_s: float = 5.0) -> RobotState:
        """See `Client.stop`."""
        return await asyncio.to_thread(Client.stop, self, robot, reason, timeout_s=timeout_s)  # type: ignore[arg-type]

    async def reset(self, robot: str | None = None) -> None:
        """See `Client.reset`."""
        await self._reset(robot)

    async def _watch(self, kind: str, name: str) -> AsyncIterator[bytes]:
        subscription = self._connection.subscribe(kind, name, True)
        try:
            while True:
                # In slices, so that a cancelled task leaves no thread behind that waits for ever.
                message = await asyncio.to_thread(subscription.recv, 0.5)
                if message is not None:
                    yield message[2]
        finally:
            subscription.close()

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        await asyncio.to_thread(self.close)


async def connect_async(
    endpoint: str | Sequence[str] | None = None,
    *,
    cell: str | None = None,
    config: str | PathLike[str] | None = None,
    camera: str = "front",
    robot: str = "panda",
) -> AsyncClient:
    """Connect to a running system from asyncio; see `connect`."""
    return AsyncClient(await asyncio.to_thread(connection_to, endpoint, cell, config), camera, robot)
