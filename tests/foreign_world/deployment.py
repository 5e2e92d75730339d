"""Repose's services as processes, without its simulator."""

import os
import signal
import socket
import subprocess
import time

SERVICES = ("perception", "inference", "planner", "motion")
# How long the router may take to listen.
LISTENS_WITHIN_S = 30.0


class Deployment:
    """A router and the services behind it, until closed. Their logs go to a folder."""

    def __init__(self, program, folder, config=None, cell="foreign"):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.connect = f"tcp/127.0.0.1:{free.getsockname()[1]}"
        self.program, self.cell, self.config, self.processes = program, cell, config, []
        try:
            for what in ("router", *SERVICES):
                with open(os.path.join(folder, f"{what}.log"), "w", encoding="utf-8") as log:
                    command = [program, "serve", what, *self._system()]
                    self.processes.append(subprocess.Popen(command, stdout=log, stderr=log))
                if what == "router":
                    self._wait_for_the_router()
        except BaseException:
            # Nobody has this to close.
            self.close()
            raise

    def _system(self):
        system = ["--connect", self.connect, "--cell", self.cell]
        return system + (["--config", self.config] if self.config else [])

    def _wait_for_the_router(self):
        host, port = self.connect.removeprefix("tcp/").split(":")
        give_up = time.monotonic() + LISTENS_WITHIN_S
        while time.monotonic() < give_up:
            with socket.socket() as trial:
                if trial.connect_ex((host, int(port))) == 0:
                    return
            if ended := self.ended():
                raise RuntimeError(f"ended before it listened at {self.connect}: {', '.join(ended)}")
            time.sleep(0.1)
        raise TimeoutError(f"the router does not listen at {self.connect}")

    def ended(self):
        """Which processes have ended though they should not have."""
        names = ("router", *SERVICES)
        return [f"{name} ({p.returncode})" for name, p in zip(names, self.processes) if p.poll() is not None]

    def place(self):
        """The command that asks for a placement, its connection given."""
        return [self.program, "place", *self._system()]

    def close(self):
        for process in reversed(self.processes):
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        for process in reversed(self.processes):
            try:
                process.wait(15)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
