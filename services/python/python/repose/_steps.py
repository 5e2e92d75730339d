"""What waits, written once: a coroutine of steps that is run by blocking, or within asyncio.

A step says how it waits in either world. `blocking` and `awaiting` make of a method of steps the methods of the two clients, with its
signature and its documentation.
"""

from __future__ import annotations

import asyncio
import functools
import time
from collections.abc import Awaitable, Callable, Coroutine, Generator
from typing import Any, Concatenate, Generic, ParamSpec, Protocol, TypeVar

T = TypeVar("T")
S = TypeVar("S")
S_co = TypeVar("S_co", covariant=True)
P = ParamSpec("P")


class Step(Generic[T]):
    """Something to wait for: by blocking, or by awaiting."""

    def __init__(self, block: Callable[[], T], awaitable: Callable[[], Awaitable[T]]) -> None:
        self.block = block
        self.awaitable = awaitable

    def __await__(self) -> Generator[Step[Any], Any, T]:
        waited: T = yield self
        return waited


def pause(seconds: float) -> Step[None]:
    """Wait for a time."""
    return Step(lambda: time.sleep(seconds), lambda: asyncio.sleep(seconds))


def threaded(wait: Callable[[], T]) -> Step[T]:
    """Wait for what only blocks; within asyncio a thread does."""
    return Step(wait, lambda: asyncio.to_thread(wait))


#: Steps that end in a T.
Steps = Coroutine[Step[Any], Any, T]


def run(steps: Steps[T]) -> T:
    """Run steps by blocking."""
    try:
        step = steps.send(None)
        while True:
            try:
                waited = step.block()
            except BaseException as error:
                step = steps.throw(error)
            else:
                step = steps.send(waited)
    except StopIteration as end:
        result: T = end.value
        return result
    finally:
        steps.close()


async def drive(steps: Steps[T]) -> T:
    """Run steps within asyncio."""
    try:
        step = steps.send(None)
        while True:
            try:
                waited = await step.awaitable()
            except BaseException as error:
                step = steps.throw(error)
            else:
                step = steps.send(waited)
    except StopIteration as end:
        result: T = end.value
        return result
    finally:
        steps.close()


class _Face(Protocol[S_co]):
    """A client, and what it is the face of."""

    @property
    def _core(self) -> S_co: ...


def blocking(method: Callable[Concatenate[S, P], Steps[T]]) -> Callable[Concatenate[_Face[S], P], T]:
    """Make the method of a client that waits."""

    @functools.wraps(method)
    def face(self: _Face[S], /, *args: P.args, **kwargs: P.kwargs) -> T:
        return run(method(self._core, *args, **kwargs))

    return face


def awaiting(method: Callable[Concatenate[S, P], Steps[T]]) -> Callable[Concatenate[_Face[S], P], Coroutine[Any, Any, T]]:
    """Make the method of a client for asyncio."""

    @functools.wraps(method)
    async def face(self: _Face[S], /, *args: P.args, **kwargs: P.kwargs) -> T:
        return await drive(method(self._core, *args, **kwargs))

    return face
