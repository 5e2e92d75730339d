"""Calls to a running system, and what comes back."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncGenerator, Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from os import PathLike
from types import TracebackType
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._steps import Step

__all__ = ["Answer", "Call", "Execution", "RobotState"]

T = TypeVar("T")
U = TypeVar("U")

#: How long whoever gives a call up waits for it to end, seconds. Its worker has been told by then.
GIVEN_UP_WITHIN_S = 0.5
#: What a robot may be doing.
MODES = ("idle", "moving", "stopped")


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
    """How a motion of the robot ended.

    Attributes:
        outcome: ``done``, ``stopped`` or ``grasp_lost``.
        reason: Why, where it is not done.
        data: Everything, as it travels.

    """

    outcome: str
    reason: str | None
    data: dict[str, Any]


@dataclass(frozen=True, eq=False)
class RobotState:
    """What a robot says of itself.

    Attributes:
        joints_rad: Joint positions, radians, ``[7]``.
        velocities_rad_s: Joint velocities, radians a second, ``[7]``.
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

    @classmethod
    def _of(cls, content: bytes) -> RobotState:
        data = json.loads(content)
        return cls(np.array(data["q_rad"]), np.array(data["dq_rad_s"]), data["gripper_width_m"], data["mode"], data.get("stop"), data)

    @classmethod
    def _if_readable(cls, content: bytes) -> RobotState | None:
        """Read a state; ``None`` where it cannot be read: what a robot's side tells is no fault of whoever listens."""
        try:
            state = cls._of(content)
        except (KeyError, TypeError, ValueError, RecursionError):
            return None
        is_known = state.mode in MODES and (state.stop is None or isinstance(state.stop, dict))
        return state if is_known else None


class Call(Generic[T]):
    """A call under way: wait for its `result`, or await it; go through its `progress`; `cancel` it.

    Ctrl-C while one waits for it cancels it, as does any exception that a signal's handler raises meanwhile, and the end of a block
    that it is the context of::

        with client.execute_call(motion) as call:
            for step in call.progress():
                print(step["phase"])
            print(call.result().outcome)

    Whoever only lets go of it leaves it to go on.
    """

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
            except BaseException:
                # Of a signal's handler: Ctrl-C, or a time limit. A call that has ended in its own error has nothing left to give up.
                self._pending.give_up()
                raise
            if ended is None:
                raise TimeoutError(f"the call has not ended within {timeout_s} s")
            schema, bulk, content, worker, attempts, timing_ms = ended
            data = None if bulk else json.loads(content)
            self._answer = Answer(data, content, schema, worker, attempts, timing_ms)
        return self._answer

    def progress(self) -> Generator[dict[str, Any], None, None]:
        """Go through the progress replies as they come, until the call ends.

        A loop that is left before that, by Ctrl-C, an exception or ``break``, cancels the call; a robot that it moves comes to rest. To
        look at some of the progress and let the call go on, keep the iterator: ``steps = call.progress(); next(steps)``.
        """
        try:
            while (reply := self._pending.next_progress()) is not None:
                yield json.loads(reply)
        except BaseException:
            self._pending.give_up()
            raise

    async def aprogress(self) -> AsyncGenerator[dict[str, Any], None]:
        """Go through the progress replies in asyncio; as `progress`, where the task is cancelled, too."""
        # A thread of its own: a reply may be minutes away, and asyncio has a handful of threads for everything else that waits.
        listener = ThreadPoolExecutor(1, "repose-progress")
        loop = asyncio.get_running_loop()
        try:
            while (reply := await loop.run_in_executor(listener, self._pending.next_progress)) is not None:
                yield json.loads(reply)
        except BaseException:
            # Which also ends the thread that waits for the next reply.
            self._pending.cancel()
            raise
        finally:
            listener.shutdown(wait=False)

    def done(self) -> bool:
        """Whether the call has ended."""
        return self._pending.done()

    def cancel(self) -> None:
        """End the call with `repose.Cancelled`, and tell its worker."""
        self._pending.cancel()

    def __enter__(self) -> Call[T]:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._pending.give_up()

    async def __aenter__(self) -> Call[T]:
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        # Not by a thread: while there is none free the call would go on.
        self._pending.cancel()
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._end(), GIVEN_UP_WITHIN_S)

    def __await__(self) -> Generator[Any, None, T]:
        return self._ended().__await__()

    async def _ended(self) -> T:
        try:
            await self._end()
        except BaseException:
            self._pending.cancel()
            raise
        return self.result(0)

    async def _end(self) -> None:
        # What it ends in is not looked at.
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
        await ended

    def _step(self) -> Step[T]:
        return Step(self.result, lambda: self)

    def _read_as(self, read: Callable[[Answer], U]) -> Call[U]:
        return Call(self._pending, read)


def connection_to(endpoint: str | Sequence[str] | None, cell: str | None, config: str | PathLike[str] | None) -> _native.Connection:
    """Open a session: one endpoint, several to try, or the configuration's."""
    endpoints = [endpoint] if isinstance(endpoint, str) else list(endpoint or [])
    return _native.Connection(endpoints, cell, config)
