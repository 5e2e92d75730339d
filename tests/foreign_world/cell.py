"""The cell on Zenoh: states and frames out, commands and stops in. The contract's robot and camera keys, and nothing else.

One thread steps the world and puts messages; what comes in waits in queues until it looks. Frames are taken while the arm rests.
"""

import contextlib
import json
import queue
import struct
import time

import numpy as np
import zenoh

from .camera import sensed
from .world import STEP_S

STATE_PERIOD_S = 0.02
FRAME_PERIOD_S = 0.7
# Real time that is made up for when the thread was held up; more is lost to robot time.
CATCH_UP_S = 0.06
# Longest that the world is stepped between two looks at what came in.
LISTENS_AFTER_S = 0.01
# A world in which nothing has moved for so long, and nobody has a task, is not stepped.
IDLE_S = 0.5


def bulk(metadata, tensors):
    """Safetensors: text beside little-endian arrays of u16 and u8."""
    header, blobs, offset = {"__metadata__": metadata}, [], 0
    for name in sorted(tensors):
        blob = np.ascontiguousarray(tensors[name])
        dtype = {"uint16": "U16", "uint8": "U8"}[blob.dtype.name]
        header[name] = {"dtype": dtype, "shape": list(blob.shape), "data_offsets": [offset, offset + blob.nbytes]}
        offset += blob.nbytes
        blobs.append(blob.tobytes())
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    return struct.pack("<Q", len(text)) + text + b"".join(blobs)


class Cell:
    """A world joined to a router."""

    def __init__(self, world, connect, cell, robot="panda", camera="front", time_scale=1.0):
        self.world, self.camera, self.time_scale = world, camera, time_scale
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([connect]))
        config.insert_json5("scouting/multicast/enabled", "false")
        self.session = zenoh.open(config)
        self.root = root = f"repose/v1/{cell}"
        self.commands, self.stops = queue.Queue(64), queue.Queue(16)
        self.subscribers = [
            self.session.declare_subscriber(f"{root}/robot/{robot}/command", self._receive(self.commands)),
            self.session.declare_subscriber(f"{root}/robot/{robot}/@estop", self._receive(self.stops)),
        ]
        express = {"express": True, "congestion_control": zenoh.CongestionControl.DROP}
        state = zenoh.Encoding("application/json;repose.RobotState.v1")
        frame = zenoh.Encoding("application/octet-stream;repose.Frame.v1")
        self.states = self.session.declare_publisher(
            f"{root}/robot/{robot}/state", encoding=state, priority=zenoh.Priority.INTERACTIVE_HIGH, **express
        )
        self.frames = self.session.declare_publisher(
            f"{root}/camera/{camera}/frame",
            encoding=frame,
            priority=zenoh.Priority.DATA_LOW,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )
        self.seq = 0
        self.ignored = []
        self.behind_s = 0.0
        self.rng = None

    @staticmethod
    def _receive(waiting):
        def receive(sample):
            # Where the queue is full the sender repeats what is not shown as taken.
            with contextlib.suppress(queue.Full):
                waiting.put_nowait((time.monotonic(), sample.payload.to_bytes()))

        return receive

    def close(self):
        self.session.close()

    def begin(self, rng):
        """After the world was furnished anew: noise from here on is of `rng`."""
        self.rng, self.drawn, self.still_s = rng, None, 0.0
        self.ignored = []
        now = time.monotonic()
        self.stepped_to, self.next_state, self.next_frame = now, now, now

    def until_seen(self, longest_s=60.0):
        """Runs until perception has made a scene of a frame of the world as it is; whether it has."""
        began, since_ns, seen = time.monotonic(), time.time_ns(), []

        def receive(sample):
            if json.loads(sample.payload.to_bytes()).get("stamp_ns", 0) > since_ns:
                seen.append(True)

        scenes = self.session.declare_subscriber(f"{self.root}/scene/{self.camera}", receive)
        self.run(lambda: bool(seen) or time.monotonic() - began > longest_s)
        scenes.undeclare()
        return bool(seen)

    def run(self, until):
        """Steps the world in real time (times the scale) until `until()` says so; it is asked every few milliseconds."""
        while not until():
            now = time.monotonic()
            before = self.world.control.mode
            self._take(now)
            self._catch_up(now)
            if now >= self.next_state or self.world.control.mode != before:
                self.next_state = now + STATE_PERIOD_S
                self.seq += 1
                self.states.put(json.dumps(self.world.state(self.seq, time.time_ns())))
            if now >= self.next_frame and self.world.control.at_rest() and not self.world.control.task:
                self.next_frame = now + FRAME_PERIOD_S
                self._put_frame()
            time.sleep(0.001)

    def _catch_up(self, now):
        """Steps the world up to now, for some milliseconds at most: one that cannot keep up hears of stops and commands all the same."""
        late = now - self.stepped_to - CATCH_UP_S
        if late > 0:
            self.stepped_to += late
            self.behind_s += late
        began = time.monotonic()
        while self.stepped_to + STEP_S / self.time_scale <= now and time.monotonic() - began < LISTENS_AFTER_S:
            self.stepped_to += STEP_S / self.time_scale
            self._step(now)

    def _step(self, now):
        control = self.world.control
        busy = control.task or control.gripper or not control.at_rest() or not self.world.robot.settled
        if busy or not self.world.at_rest():
            self.still_s = 0.0
        else:
            self.still_s += STEP_S
        if self.still_s < IDLE_S:
            self.drawn = None
            self.world.step(now)
        else:
            self.world.robot_s += STEP_S

    def _take(self, now):
        while not self.stops.empty():
            self.world.control.emergency_stop(self.stops.get_nowait()[1])
        while not self.commands.empty():
            received, payload = self.commands.get_nowait()
            try:
                why = self.world.control.command(json.loads(payload), received, now)
            except (ValueError, KeyError, TypeError) as error:
                why = f"not a command: {error!r}"
            if why and why != "sequence number passed":
                self.ignored.append(why)

    def _put_frame(self):
        if self.drawn is None:
            self.drawn = self.world.picture()
        color, depth_m, labels = self.drawn
        stamp_ns = time.time_ns()
        metadata = {"camera": self.camera, "stamp_ns": str(stamp_ns), "camera_json": json.dumps(self.world.furniture.camera.model())}
        tensors = {"depth": sensed(depth_m, self.rng), "color": color, "labels": labels}
        self.seq += 1
        self.states.put(json.dumps(self.world.state(self.seq, stamp_ns)))
        self.frames.put(bulk(metadata, tensors))
