"""Repose's processes, and a client on the cell's keys that is none of Repose's: plain Zenoh, JSON, safetensors."""

import contextlib
import json
import os
import signal
import socket
import struct
import subprocess
import threading
import time
import uuid

import zenoh

CELL = "repose/v1/cell"
READY_RAD = [0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398]
REPOSE = os.environ["REPOSE"]


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def until(what, holds, seconds=30.0):
    """Waits until something holds, and returns it."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found := holds():
            return found
        time.sleep(0.02)
    raise AssertionError(f"not within {seconds} s: {what() if callable(what) else what}")


class Programs:
    """Processes of Repose, with their logs."""

    def __init__(self, folder):
        self.folder, self.running = folder, {}
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"

    def start(self, name, *arguments):
        with open(self.path(name), "ab") as log:
            self.running[name] = subprocess.Popen([REPOSE, *arguments, "--connect", self.endpoint], stdout=log, stderr=log)

    def send(self, name, what):
        self.running[name].send_signal(what)

    def end(self, name, how=signal.SIGTERM):
        process = self.running.pop(name)
        process.send_signal(how)
        try:
            return process.wait(20)
        except subprocess.TimeoutExpired:
            # It is in no list any more: nobody else would end it.
            process.kill()
            process.wait()
            raise

    def path(self, name):
        return os.path.join(self.folder, f"{name}.log")

    def log(self, name):
        with open(self.path(name), encoding="utf-8") as log:
            return log.read()

    def robot(self, action, *options):
        """`repose robot ACTION`."""
        command = [REPOSE, "robot", action, *options, "--connect", self.endpoint, "--json"]
        return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)

    def close(self):
        for name in reversed(list(self.running)):
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.end(name)


class Client:
    """A commander of the robot, who sees its states."""

    def __init__(self, endpoint, robot="panda"):
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        config.insert_json5("scouting/multicast/enabled", "false")
        self.session, self.key = zenoh.open(config), f"{CELL}/robot/{robot}"
        self.state, self.came, self.seq, self.changed = None, 0.0, 0, threading.Condition()
        self.subscriber = self.session.declare_subscriber(f"{self.key}/state", self._take)
        self.owner = {"id": "tester", "epoch": 1}

    def close(self):
        """Before the interpreter ends, which would wait for the session's threads."""
        self.subscriber.undeclare()
        self.session.close()

    def _take(self, sample):
        with self.changed:
            self.state, self.came = json.loads(sample.payload.to_bytes()), time.monotonic()

    def fresh(self):
        """The state, if it is new."""
        return self.state if time.monotonic() - self.came < 0.3 else None

    def is_in(self, mode):
        state = self.fresh()
        return state if state and state["mode"] == mode else None

    def stopped_by(self):
        state = self.is_in("stopped")
        return state["stop"]["kind"] if state else None

    def shown(self):
        """The mode and the kind of the stop, as soon as there is a state that is new: on a machine that is busy the last one may be old."""
        state = until(lambda: f"a state; {self.state}", self.fresh)
        return state["mode"], (state["stop"] or {}).get("kind")

    def is_taken(self):
        """Whether the last command was taken."""
        return self.state["owner"] == self.owner and self.state["last_command"] == self.seq

    def own(self):
        """Takes the robot over: under a higher epoch than any before."""
        owner = self.state["owner"]
        self.owner, self.seq = {"id": "tester", "epoch": (owner["epoch"] if owner else 0) + 1}, 0

    def command(self, ttl_ms=500, **what):
        self.seq += 1
        command = {"v": 1, "seq": self.seq, "owner": self.owner, "ttl_ms": ttl_ms, **what}
        self.session.put(f"{self.key}/command", json.dumps(command), encoding="application/json;repose.RobotCommand.v1")

    def stream(self, to_rad, span_s, ends=True, share=1.0):
        """A smooth motion from where the arm stands, or the first part of it."""
        self.own()
        from_rad, steps = self.state["q_rad"], round(span_s * 100)
        points = []
        for k in range(int(steps * share) + 1):
            s = k / steps
            place = s**3 * (10 - 15 * s + 6 * s * s)
            rate = 30 * s * s * (1 - s) ** 2 / span_s
            q = [a + place * (b - a) for a, b in zip(from_rad, to_rad)]
            points.append({"t_ms": 10.0 * k, "q_rad": q, "dq_rad_s": [rate * (b - a) for a, b in zip(from_rad, to_rad)]})
        self.command(ttl_ms=10_000, starts_stream=True, ends_stream=ends, set_points=points)

    def emergency_stop(self):
        stop = {"v": 1, "id": str(uuid.uuid4()), "source": "tester", "reason": "a test", "stamp_ns": time.time_ns()}
        self.session.put(f"{self.key}/@estop", json.dumps(stop))

    def call(self, worker, method, payload, encoding, seconds=60.0):
        """A call's result; the progress before it is left out."""
        attachment = {"v": 1, "id": str(uuid.uuid4()), "method": method, "remaining_ms": int(seconds * 1e3), "priority": "interactive", "attempt": 0}
        replies = self.session.get(
            f"{CELL}/service/motion/{worker}/call",
            payload=payload,
            encoding=encoding,
            attachment=json.dumps(attachment),
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=seconds,
        )
        for reply in replies:
            told = json.loads(reply.ok.attachment.to_bytes())
            if told["kind"] == "progress":
                continue
            answer = json.loads(reply.ok.payload.to_bytes())
            assert told["kind"] == "result", answer
            return answer
        raise AssertionError(f"no answer to {method}")


def safetensors(tensors, metadata):
    """Bulk form. `tensors`: (dtype, shape, bytes) by name."""
    header, offset = {"__metadata__": metadata}, 0
    for name, (dtype, shape, data) in tensors.items():
        header[name] = {"dtype": dtype, "shape": shape, "data_offsets": [offset, offset + len(data)]}
        offset += len(data)
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + b"".join(data for _, _, data in tensors.values())
