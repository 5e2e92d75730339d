"""Two networks with a router each, and a slow link between: the robot's cell and the office, as network namespaces of this machine."""

import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time

RELAY = pathlib.Path(__file__).with_name("relay.py")
CELL_ADDRESS, OFFICE_ADDRESS = "10.78.0.1", "10.78.0.2"
# Where each network's processes find their router.
ENDPOINT = "tcp/127.0.0.1:7447"
# How long the services may take to come up, seconds.
READY_WITHIN_S = 60.0


def missing():
    """Why namespaces cannot be made here; none where they can."""
    if os.geteuid() != 0:
        return "only root makes network namespaces"
    if not os.path.exists("/dev/net/tun"):
        return "there is no /dev/net/tun"
    name = f"repose-try-{os.getpid()}"
    try:
        made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True)
    except FileNotFoundError:
        return "there is no `ip` (iproute2)"
    if made.returncode != 0:
        return f"no network namespace can be made: {made.stderr.strip()}"
    subprocess.run(["ip", "netns", "del", name], check=True)
    return None


class Networks:
    """The two networks. Everything in them ends with this."""

    def __init__(self, program, log):
        self.program, self.log = str(program), log
        self.cell, self.office = (f"repose-{name}-{os.getpid()}" for name in ("cell", "office"))
        self.processes, self.relay, self.folder = [], None, tempfile.TemporaryDirectory()

    def __enter__(self):
        try:
            for namespace in (self.cell, self.office):
                self._ip("netns", "add", namespace)
                self._ip("-n", namespace, "link", "set", "lo", "up")
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
            self.relay = subprocess.Popen([sys.executable, str(RELAY), self.cell, self.office], **pipes)
            device = json.loads(self.relay.stdout.readline())["device"]
            for namespace, address in ((self.cell, CELL_ADDRESS), (self.office, OFFICE_ADDRESS)):
                self._ip("-n", namespace, "addr", "add", f"{address}/30", "dev", device)
                self._ip("-n", namespace, "link", "set", device, "up")
            self.device = device
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_):
        for process in self.processes:
            process.kill()
            process.wait()
        if self.relay is not None:
            self.relay.kill()
            self.relay.wait()
        for namespace in (self.cell, self.office):
            subprocess.run(["ip", "netns", "del", namespace], capture_output=True)
        self.folder.cleanup()

    @staticmethod
    def _ip(*words):
        subprocess.run(["ip", *words], check=True)

    def link(self, **change):
        """Changes the link; what has come to it so far, by network."""
        self.relay.stdin.write(json.dumps(change) + "\n")
        self.relay.stdin.flush()
        so_far = json.loads(self.relay.stdout.readline())
        return {"cell": so_far[self.cell], "office": so_far[self.office]}

    def rate(self, mbit):
        """Bounds what either side sends, Mbit/s; none: not at all. Queues hold a quarter of a second, as a cheap router's do."""
        for namespace in (self.cell, self.office):
            device = ["dev", self.device, "root"]
            subprocess.run(["tc", "-n", namespace, "qdisc", "del", *device], capture_output=True)
            if mbit is not None:
                shape = ["tbf", "rate", f"{mbit}mbit", "burst", "16kb", "latency", "250ms"]
                subprocess.run(["tc", "-n", namespace, "qdisc", "add", *device, *shape], check=True)

    def start(self, namespace, what, config=None, environment=None, log=None):
        """Starts `repose serve WHAT` in a network."""
        words = ["serve", what, "--until-stdin-ends"]
        if config is None:
            words += ["--connect", ENDPOINT]
        else:
            file = pathlib.Path(self.folder.name, f"{namespace}-{what}.toml")
            file.write_text(config)
            words += ["--config", str(file)]
        process = subprocess.Popen(
            ["ip", "netns", "exec", namespace, self.program, *words],
            stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=log or self.log, env={**os.environ, **(environment or {})},
        )
        self.processes.append(process)
        return process

    def start_routers(self, environments=(None, None), logs=(None, None)):
        """The cell's router, and the office's, which finds it over the link."""
        listen = 'mode = "router"\nlisten = ["tcp/{}:7447"]\n'
        cell = "[session]\n" + listen.format("0.0.0.0")
        office = "[session]\n" + listen.format("127.0.0.1") + f'connect = ["tcp/{CELL_ADDRESS}:7447"]\n'
        self.start(self.cell, "router", cell, environments[0], logs[0])
        self.start(self.office, "router", office, environments[1], logs[1])

    def repose(self, namespace, *words, environment=None, timeout_s=300):
        """Runs a client in a network: exit code, document, seconds, log."""
        command = ["ip", "netns", "exec", namespace, self.program, "--json", *map(str, words), "--connect", ENDPOINT]
        begin = time.monotonic()
        ran = subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, env={**os.environ, **(environment or {})})
        seconds = time.monotonic() - begin
        try:
            document = json.loads(ran.stdout)
        except ValueError:
            document = None
        return ran.returncode, document, seconds, ran.stderr

    def wait_for(self, namespace, services):
        """Waits until a network sees a worker of each service, and a scene where there is perception."""
        give_up = time.monotonic() + READY_WITHIN_S
        while True:
            _, status, _, log = self.repose(namespace, "status", "--seconds", "0.6")
            alive = {worker["service"] for worker in (status or {}).get("workers", [])}
            if set(services) <= alive and ("perception" not in services or status["cameras"]):
                return status
            if time.monotonic() > give_up:
                raise SystemExit(f"not up within {READY_WITHIN_S:.0f} s: {sorted(alive)} of {sorted(services)}\n{log}")


def bytes_between(before, after):
    """Bytes that each network has sent the other between two readings of the link."""
    return {name: after[name]["bytes"] - before[name]["bytes"] for name in before}
