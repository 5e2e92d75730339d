"""The robot's side of the command key: who commands, which set-points are followed, and when the arm stops by itself.

No physics and no network: commands and milliseconds of robot time in, the joint positions that the motors are to hold out. The rules
are those of Repose's contract: one owner by growing epochs, sequence numbers, a time to live, tasks that their owner has to keep alive,
stops that latch.
"""

import json
from bisect import bisect_left, bisect_right

READY_RAD = (0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398)
# Franka's published limits of the Panda.
LOWER_RAD = (-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973)
UPPER_RAD = (2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973)
VELOCITY_RAD_S = (2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61)
ACCELERATION_RAD_S2 = (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0)
TICK_S = 0.001
START_TOLERANCE_RAD = 1e-3
# How long the difference between the measured place and the first set-point takes to fade out.
FADE_MS = 200.0
BRAKING_SHARE = 0.6
# What rounding makes of differences of differences.
ROUNDING = 1.001


def _hermite(a, b, t_ms):
    """Position on the cubic between two set-points."""
    span_s = (b["t_ms"] - a["t_ms"]) * 1e-3
    s = (t_ms - a["t_ms"]) / (b["t_ms"] - a["t_ms"])
    s2, s3 = s * s, s * s * s
    h = (2 * s3 - 3 * s2 + 1, (s3 - 2 * s2 + s) * span_s, 3 * s2 - 2 * s3, (s3 - s2) * span_s)
    nodes = zip(a["q_rad"], a["dq_rad_s"], b["q_rad"], b["dq_rad_s"])
    return [h[0] * qa + h[1] * va + h[2] * qb + h[3] * vb for qa, va, qb, vb in nodes]


class Stream:
    """Set-points that are followed, and how far they have been."""

    def __init__(self, command, stands_rad):
        self.points = list(command["set_points"])
        self.ends = bool(command.get("ends_stream"))
        self.clock_ms = self.points[0]["t_ms"]
        self.offset_rad = [a - b for a, b in zip(stands_rad, self.points[0]["q_rad"])]
        self.since_start_ms = 0.0

    def extend(self, points):
        if points:
            times = [p["t_ms"] for p in self.points]
            self.points = self.points[: bisect_left(times, points[0]["t_ms"])] + list(points)
            passed = bisect_right([p["t_ms"] for p in self.points], self.clock_ms) - 1
            del self.points[: max(passed, 0)]

    def at(self, t_ms):
        k = bisect_right(self.points, t_ms, key=lambda p: p["t_ms"])
        if k >= len(self.points):
            position = self.points[-1]["q_rad"]
        elif k == 0:
            position = self.points[0]["q_rad"]
        else:
            position = _hermite(self.points[k - 1], self.points[k], t_ms)
        s = min(self.since_start_ms / FADE_MS, 1.0)
        left = 1.0 - s * s * s * (10 - 15 * s + 6 * s * s)
        return [q + left * off for q, off in zip(position, self.offset_rad)]


class ArmControl:
    """One arm's controller. Times of receipt are seconds of a steady clock; `tick` is a millisecond of robot time."""

    def __init__(self, q_rad=READY_RAD):
        self.owner = None
        self.last_command = None
        self.rehome(q_rad)
        self.stop = None
        # The emergency stops of the latched stop, with what they say, the newest first.
        self.estops = []
        self.task = None
        self.expires_s = 0.0
        self.gripper = None
        self.grasps = None
        self.grips = False
        # Streams followed and gripper actions taken, in order: what a watcher tells phases by.
        self.events = []

    def rehome(self, q_rad=READY_RAD):
        """As if carried there, at rest; owner and stop stay."""
        self.position_rad = list(q_rad)
        self.velocity_rad_s = [0.0] * 7
        self.measured_rad = list(q_rad)
        self.stream = None
        self.stream_ms = None
        self.grasps = None
        self.grips = False
        self.events = []

    def forget(self):
        """What latched, and the task that was open, as of a controller that is started anew."""
        self.stop, self.task, self.estops = None, None, []

    @property
    def mode(self):
        return "stopped" if self.stop else "moving" if self.stream else "idle"

    def at_rest(self):
        return self.stream is None and not any(self.velocity_rad_s)

    def emergency_stop(self, payload):
        """Latches, whatever came: nothing that may be a cry for help is refused for its form."""
        try:
            said = json.loads(payload)
            said = said if isinstance(said, dict) else {}
        except ValueError:
            said = {}
        text = {key: said[key] if isinstance(said.get(key), str) and said[key] else "unknown" for key in ("id", "source", "reason")}
        stop = {"kind": "estop", "reason": f"{text['source']}: {text['reason']}"[:256], "estop_id": text["id"][:256]}
        if self.stop and self.stop.get("estop_id") == stop["estop_id"]:
            return
        # The newest is the one to be cleared; with the reasons of those before it, it is another stop than any of them was.
        others = [said for said in self.estops if said[0] != stop["estop_id"]]
        self.estops = [(stop["estop_id"], stop["reason"]), *others][:3]
        self._latch({**stop, "reason": "; before that ".join(said for _, said in self.estops)})

    def command(self, command, received_s, now_s):
        """Takes a command; says why not where it is not taken."""
        expires_s = received_s + command["ttl_ms"] * 1e-3
        if now_s > expires_s:
            return "expired"
        clears, owner = bool(command.get("clear_stop")), command["owner"]
        task = None if clears and self.stop else self.task
        if self.owner is not None:
            same, newer = owner == self.owner, owner["epoch"] > self.owner["epoch"]
            if not same and not newer:
                return "not the owner"
            if same and command["seq"] <= self.last_command:
                if command["seq"] == self.last_command:
                    self.expires_s = max(self.expires_s, expires_s)
                return "sequence number passed"
            if not same and self.stop is None and task is not None:
                return "another task is open"
        if self.stop and not clears:
            return "stopped"
        if clears and self.stop and command.get("clears") not in (None, self.stop):
            return "another stop is latched"
        said = command.get("task")
        if task is not None and said and said["id"] != task:
            return "another task is open"
        if command.get("starts_stream") and not self.at_rest():
            return "still moving"
        self.owner, self.last_command, self.expires_s = owner, command["seq"], expires_s
        if clears and self.at_rest():
            self.forget()
        if not self.stop:
            self._act(command, said)
        return None

    def _act(self, command, task):
        if task and task["open"]:
            if self.task != task["id"]:
                self.events = []
            self.task = task["id"]
        if command.get("gripper"):
            self.gripper = command["gripper"]
            self.grasps = (task or {}).get("grasps")
            self.events.append("gripper")
        if command.get("starts_stream"):
            self._start_stream(command)
        elif self.stream:
            self.stream.extend(command.get("set_points", []))
            self.stream.ends |= bool(command.get("ends_stream"))
        if task and not task["open"] and not self.stop:
            left = "an object in the hand" if self.grips else None if self.at_rest() else "the arm on its way"
            if left:
                self._reflex("task_unfinished", f"task {task['id']} was closed with {left}")
            else:
                self.task = None

    def _start_stream(self, command):
        points = command.get("set_points")
        if not points:
            return self._reflex("invalid_command", "a stream starts without set-points")
        apart = [abs(a - b) for a, b in zip(points[0]["q_rad"], self.measured_rad)]
        if not max(apart) <= START_TOLERANCE_RAD:
            joint = apart.index(max(apart))
            return self._reflex("start_pose_mismatch", f"joint {joint} stands {apart[joint]:.4f} rad from the first set-point")
        self.stream = Stream(command, self.position_rad)
        self.stream_ms = self.stream.clock_ms
        self.events.append("stream")

    def tick(self, now_s):
        """One millisecond of robot time."""
        silent = now_s > self.expires_s
        if self.stop is None and self.task is not None and silent:
            self._reflex("commander_silent", f"task {self.task} is open and its commander has fallen silent")
        if self.stream:
            self._follow(silent)
        elif any(self.velocity_rad_s):
            self._brake()

    def _follow(self, silent):
        stream = self.stream
        if silent and not stream.ends:
            return self._reflex("commander_silent", "the last command outlived its time to live")
        stream.clock_ms += TICK_S * 1e3
        stream.since_start_ms += TICK_S * 1e3
        end_ms = stream.points[-1]["t_ms"]
        over = stream.clock_ms > end_ms + 1e-6
        if over and not stream.ends:
            return self._reflex("commander_silent", f"set-points ran out at {end_ms:.0f} ms")
        target = stream.at(min(stream.clock_ms, end_ms))
        velocity = [(b - a) / TICK_S for a, b in zip(self.position_rad, target)]
        for i, (v, before) in enumerate(zip(velocity, self.velocity_rad_s)):
            if not LOWER_RAD[i] <= target[i] <= UPPER_RAD[i]:
                return self._reflex("joint_position_limit", f"joint {i} at {target[i]:.4f} rad")
            if abs(v) > VELOCITY_RAD_S[i] * ROUNDING:
                return self._reflex("joint_velocity_limit", f"joint {i} at {v:.3f} rad/s")
            if abs(v - before) / TICK_S > ACCELERATION_RAD_S2[i] * ROUNDING:
                return self._reflex("joint_acceleration_limit", f"joint {i} at {(v - before) / TICK_S:.2f} rad/s²")
        self.position_rad, self.velocity_rad_s = target, velocity
        self.stream_ms = min(stream.clock_ms, end_ms)
        if over and max(map(abs, velocity)) < 1e-9:
            self.velocity_rad_s, self.stream = [0.0] * 7, None
        return None

    def _brake(self):
        for i, v in enumerate(self.velocity_rad_s):
            less = BRAKING_SHARE * ACCELERATION_RAD_S2[i] * TICK_S
            v = 0.0 if abs(v) <= less else v - less if v > 0 else v + less
            self.velocity_rad_s[i] = v
            self.position_rad[i] = min(max(self.position_rad[i] + v * TICK_S, LOWER_RAD[i]), UPPER_RAD[i])

    def _reflex(self, kind, reason):
        self._latch({"kind": kind, "reason": reason})

    def _latch(self, stop):
        self.stop, self.stream, self.gripper = stop, None, None
