"""A simulated cell of real processes, and `repose mcp` in it as agents start it."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from mcp import Client, Implementation, StdioServerParameters

sys.path.insert(0, str(Path(__file__).resolve().parents[4] / "tests" / "common"))
from robot_command import robot_command  # noqa: E402

#: What the tests say of themselves; the server's log must say it again.
WHO = Implementation(name="repose-tests", version="1.2.3")


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    return "asyncio"


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Cell:
    """`repose up` until the end of the tests."""

    def __init__(self, program: str) -> None:
        self.program = program
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        # A motion process that waits half a second for a core is not lost, nor one that waits longer where the environment has it so;
        # and two pictures a second are enough.
        environment = {"REPOSE_MOTION__COMMAND_TTL_MS": "2000", **os.environ, "REPOSE_SIMULATOR__FRAME_PERIOD_MS": "500"}
        command = [program, "--json", "up", "--listen", self.endpoint, "--seed", "1"]
        self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, env=environment)
        assert self.process.stdout is not None
        if not self.process.stdout.readline():
            raise RuntimeError(f"repose up ended with status {self.process.wait()}")

    def end(self) -> None:
        self.process.send_signal(signal.SIGINT)
        self.process.wait(60)

    def arguments(self, *more: str) -> list[str]:
        return ["mcp", "--connect", self.endpoint, *more]

    def bring_back(self) -> None:
        for action in ("reset", "open", "retreat", "home"):
            robot_command(self.program, self.endpoint, action)

    def agent(self, *more: str, mode: str = "auto") -> Client:
        """An agent that starts a server of its own, on standard input and output."""
        server = StdioServerParameters(command=self.program, args=self.arguments(*more), env=dict(os.environ))
        return Client(server, mode=mode, client_info=WHO, read_timeout_seconds=120)

    @contextmanager
    def server(self, *more: str, log: Path | None = None) -> Iterator[str]:
        """A server over HTTP; its address."""
        port = free_port()
        with (log or Path(os.devnull)).open("wb") as errors:
            command = [self.program, *self.arguments("--http", f"127.0.0.1:{port}", *more)]
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=errors)
            try:
                while process.poll() is None:
                    with socket.socket() as s:
                        if s.connect_ex(("127.0.0.1", port)) == 0:
                            break
                assert process.poll() is None, f"the server ended with status {process.returncode}"
                yield f"http://127.0.0.1:{port}/mcp"
            finally:
                process.send_signal(signal.SIGINT)
                process.wait(30)


@pytest.fixture(scope="session")
def cell() -> Iterator[Cell]:
    program = os.environ.get("REPOSE")
    if not program:
        pytest.skip("REPOSE does not name the repose program")
    running = Cell(program)
    yield running
    running.end()
