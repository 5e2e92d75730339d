"""Clients of a running system, over Zenoh: one that waits, and one for asyncio.

Calls are made by the code that Repose's services call each other with: the less loaded of two workers, another worker where one is gone or
silent, one deadline for all attempts, an answer or a typed error exactly once.
"""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import AsyncGenerator, Generator, Sequence
from os import PathLike
from types import TracebackType
from typing import Any

from . import _native
from ._cell import Cell
from ._steps import awaiting, blocking
from .calls import Answer, Call, RobotState, connection_to
from .scene import Scene

__all__ = ["AsyncClient", "Client", "connect", "connect_async"]

#: How long one wait for a message lasts within asyncio, seconds: a cancelled task leaves no thread behind that waits for ever.
SLICE_S = 0.5


class _Connected:
    """What both clients are made of."""

    def __init__(self, connection: _native.Connection, camera: str, robot: str) -> None:
        self._core = Cell(connection, camera, robot)

    @property
    def cell(self) -> str:
        """The robot cell."""
        return self._core.connection.cell

    @property
    def camera(self) -> str:
        """The camera that is meant where a call names none."""
        return self._core.camera

    @property
    def robot(self) -> str:
        """The robot that is meant where a call names none."""
        return self._core.robot

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
        missed: bool = False,
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
            missed: Whether the worker is to notice when this process is gone before the call has ended, as for what moves a robot.

        """
        return self._core.call(
            service,
            method,
            schema,
            request,
            deadline_s=deadline_s,
            priority=priority,
            idempotent=idempotent,
            scene=scene,
            worker=worker,
            id=id,
            everyone=everyone,
            missed=missed,
        )

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of cell {self.cell}>"


class Client(_Connected):
    """A client that waits for its answers. Safe to use from several threads. Make one with `connect`."""

    workers = blocking(Cell.workers)
    latest = blocking(Cell.latest)
    scene = blocking(Cell.scene)
    segment = blocking(Cell.segment)
    place = blocking(Cell.place)
    place_call = blocking(Cell.place_call)
    plan_motion = blocking(Cell.plan_motion)
    execute = blocking(Cell.execute)
    execute_call = blocking(Cell.execute_call)
    recover = blocking(Cell.recover)
    robot_state = blocking(Cell.robot_state)
    stop = blocking(Cell.stop)
    reset = blocking(Cell.reset)

    def watch_scene(self, camera: str | None = None, *, timeout_s: float | None = None) -> Generator[dict[str, Any], None, None]:
        """Go through a camera's scene summaries as they are published, the newest only; ends when none comes for ``timeout_s``."""
        for content in self._watch("scene", self.camera if camera is None else camera, timeout_s):
            yield json.loads(content)

    def watch_robot(self, robot: str | None = None, *, timeout_s: float | None = None) -> Generator[RobotState, None, None]:
        """Go through a robot's states as they are published, the newest only; ends when none comes for ``timeout_s``."""
        for content in self._watch("robot_state", self.robot if robot is None else robot, timeout_s):
            yield RobotState._of(content)

    def _watch(self, kind: str, name: str, timeout_s: float | None) -> Generator[bytes, None, None]:
        subscription = self._core.connection.subscribe(kind, name, True)
        try:
            while (message := subscription.recv(timeout_s)) is not None:
                yield message[2]
        finally:
            subscription.close()

    def close(self) -> None:
        """End the session. Calls under way are cancelled; a robot that one of them moves comes to rest."""
        self._core.connection.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


class AsyncClient(_Connected):
    """A client for asyncio. Cancelling the task cancels the call at its worker. Make one with `connect_async`."""

    workers = awaiting(Cell.workers)
    latest = awaiting(Cell.latest)
    scene = awaiting(Cell.scene)
    segment = awaiting(Cell.segment)
    place = awaiting(Cell.place)
    place_call = awaiting(Cell.place_call)
    plan_motion = awaiting(Cell.plan_motion)
    execute = awaiting(Cell.execute)
    execute_call = awaiting(Cell.execute_call)
    recover = awaiting(Cell.recover)
    robot_state = awaiting(Cell.robot_state)
    stop = awaiting(Cell.stop)
    reset = awaiting(Cell.reset)

    async def watch_scene(self, camera: str | None = None, *, timeout_s: float | None = None) -> AsyncGenerator[dict[str, Any], None]:
        """See `Client.watch_scene`; it ends with the client, too."""
        async for content in self._watch("scene", self.camera if camera is None else camera, timeout_s):
            yield json.loads(content)

    async def watch_robot(self, robot: str | None = None, *, timeout_s: float | None = None) -> AsyncGenerator[RobotState, None]:
        """See `Client.watch_robot`; it ends with the client, too."""
        async for content in self._watch("robot_state", self.robot if robot is None else robot, timeout_s):
            yield RobotState._of(content)

    async def _watch(self, kind: str, name: str, timeout_s: float | None) -> AsyncGenerator[bytes, None]:
        subscription = await asyncio.to_thread(self._core.connection.subscribe, kind, name, True)
        within_s = math.inf if timeout_s is None else timeout_s
        try:
            silent_since = time.monotonic()
            while True:
                left_s = max(silent_since + within_s - time.monotonic(), 0.0)
                message = await asyncio.to_thread(subscription.recv, min(left_s, SLICE_S))
                if message is not None:
                    yield message[2]
                    # What the reader took its time over is not the silence of who publishes.
                    silent_since = time.monotonic()
                elif subscription.ended or time.monotonic() - silent_since >= within_s:
                    return
        finally:
            subscription.close()

    async def close(self) -> None:
        """End the session, as `Client.close` does. The loop goes on meanwhile: calls under way may take a moment to be cancelled."""
        await asyncio.to_thread(self._core.connection.close)

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        await self.close()


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
