"""One trial: a placement is asked of Repose and carried out, and PyBullet's poses say what came of it."""

import contextlib
import json
import math
import os
import subprocess
import tempfile
import time

import numpy as np
from PIL import Image, ImageDraw

from . import problems, relations, scenes

WITHIN_M = 0.05
TILT_RAD = math.radians(15)
MOVED_M = 0.02
# How long a trial may take, and how long the world may then take to come to rest in robot time.
LONGEST_S, REST_S = 240.0, 4.0
# Half the width of a finger pad.
PAD_HALF_M = 0.0105
PICTURED = ("approach", "grasp", "lift", "transfer", "lower", "release")


class Asked:
    """A program that runs beside the world, and ends with the trial.

    It prints into files: a pipe that nobody reads in time would hold it up."""

    def __init__(self, command):
        self.files = [tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") for _ in range(2)]
        self.process = subprocess.Popen(command, stdout=self.files[0], stderr=self.files[1])

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if not self.ended():
            self.process.kill()
        self.process.wait()
        for file in self.files:
            file.close()

    def ended(self):
        return self.process.poll() is not None

    def printed(self):
        """What it has printed, and its log."""
        for file in self.files:
            file.seek(0)
        return [file.read() for file in self.files]


class Watched:
    """Pictures at the ends of phases, and where the object was in the hand."""

    def __init__(self, world, query, pictures):
        self.world, self.query, self.strip = world, query, []
        self.pictures, self.phase, self.grasp = pictures, world.phase, None
        self._picture("before")

    def look(self):
        phase = self.world.phase
        if phase != self.phase:
            if self.phase in PICTURED:
                self._picture(self.phase)
            if phase == "grasp":
                self.grasp = self._fingers()
            self.phase = phase

    def end(self):
        self._picture("end")

    def _fingers(self):
        """Where the fingers close: how far aside of the centre of mass seen from above, how high, and the true room beside each finger."""
        place, turn = self.world.robot.tcp()
        pose, shape = self.world.pose(self.query), self.world.placed[self.query].shape
        rotation = np.reshape(self.world.client.getMatrixFromQuaternion(turn), (3, 3))
        surface = shape.surface() @ pose[:3, :3].T + pose[:3, 3]
        in_hand = (surface - place) @ rotation
        between = in_hand[(np.abs(in_hand[:, 0]) < PAD_HALF_M) & (in_hand[:, 2] > -0.03) & (in_hand[:, 2] < 0.011)]
        half = self.world.robot.width_m / 2
        room = [half + between[:, 1].min(), half - between[:, 1].max()] if len(between) else []
        return {
            "aside_m": round(math.hypot(place[0] - pose[0, 3], place[1] - pose[1, 3]), 4),
            "below_top_m": round(surface[:, 2].max() - place[2], 4),
            "above_foot_m": round(place[2] - surface[:, 2].min(), 4),
            "tilt_rad": round(math.acos(min(1.0, max(-1.0, -rotation[2, 2]))), 3),
            "opening_m": round(self.world.robot.width_m, 4),
            "room_m": [round(r, 4) for r in room],
        }

    def _picture(self, name):
        if self.pictures:
            color, _, _ = self.world.picture(scale=2)
            image = Image.fromarray(color)
            ImageDraw.Draw(image).text((4, 2), name, fill=(255, 255, 0))
            self.strip.append(image)

    def save(self, path):
        if self.strip:
            width, height = self.strip[0].size
            sheet = Image.new("RGB", (width * min(4, len(self.strip)), height * -(-len(self.strip) // 4)))
            for k, image in enumerate(self.strip):
                sheet.paste(image, (width * (k % 4), height * (k // 4)))
            sheet.save(path)


def run(cell, problem, command, seed, pictures=None):
    """Has `command` (the program and how it connects) place and execute; a dictionary of what came of it."""
    world = cell.world
    asked = [*command, *wish(problem, seed), "--execute", "--json"]
    watched = Watched(world, problem.query, pictures)
    began, robot_began_s, behind_s = time.monotonic(), world.robot_s, cell.behind_s
    with Asked(asked) as program:

        def over():
            watched.look()
            if time.monotonic() - began > LONGEST_S and not program.ended():
                program.process.terminate()
            return program.ended()

        cell.run(over)
        out, log = program.printed()
    rest_until_s = world.robot_s + REST_S
    cell.run(lambda: world.robot_s >= rest_until_s or (world.at_rest() and world.robot_s > rest_until_s - REST_S + 0.5))
    document = {}
    with contextlib.suppress(ValueError):
        document = json.loads(out)
    result = reported(watched, problem, seed, (document, log, program.process.returncode), pictures)
    result |= {
        "robot_s": round(world.robot_s - robot_began_s, 1),
        "wall_s": round(time.monotonic() - began, 1),
        "behind_s": round(cell.behind_s - behind_s, 1),
    }
    if cell.ignored:
        result["ignored"] = cell.ignored[:8]
    return result


def wish(problem, seed):
    """The arguments of `repose` that say what is wanted."""
    return ["--move", str(problem.query + 1), "--goal", problem.goal, "--seed", str(seed)]


def reported(watched, problem, seed, ended, pictures):
    """What came of a trial, the world at rest; `ended` is what `repose` printed, its log, and its exit status."""
    world, (document, log, status) = watched.world, ended
    shape = world.placed[problem.query].shape
    watched.end()
    result = {
        "object": shape.name,
        "query": problem.query + 1,
        "goal": problem.goal,
        "width_m": round(shape.width_m, 4),
        "height_m": round(float(shape.extent_m[2]), 4),
        "mass_kg": round(shape.mass_kg, 3),
        "friction": round(world.placed[problem.query].friction, 2),
        "objects": [p.shape.name for p in world.placed],
        "exit": status,
    }
    result |= _judged(world, problem, document, log)
    result |= {
        "ended_in": watched.phase,
        "stop": world.control.stop,
        "grasp": watched.grasp,
        "first_stirred": {str(k + 1): phase for k, phase in world.stirred.items()},
        "peak_n": _peaks(world),
    }
    if pictures:
        watched.save(os.path.join(pictures, f"{seed}-{'good' if result['success'] else result['cause']}.png"))
    return result


def _peaks(world):
    """The largest force of each part of the robot on each object in each phase, newtons: `{"approach finger 2": 31}`; 0 is no object."""
    return {" ".join(map(str, key)): round(force) for key, force in sorted(world.peaks.items()) if force >= 1}


def _judged(world, problem, document, log):
    step = (document.get("steps") or [{}])[0]
    error = document.get("error") or {}
    reason = step.get("reason") or error.get("message") or (log.strip().splitlines() or [""])[-1]
    placements = (step.get("result") or {}).get("placements") or []
    judged = {
        "execution": step.get("execution"),
        "reason": reason[:1000],
        "offered": len(placements),
        "attempts": [a.get("reason") or "the goal did not hold" for a in step.get("attempts", [])] or None,
    }
    query, start = problem.query, world.start
    now = [world.pose(k) for k in range(len(world.objects))]
    moved = {k + 1: round(math.dist(now[k][:3, 3], start[k][:3, 3]), 3) for k in range(len(now)) if k != query}
    disturbed = {k: m for k, m in moved.items() if m > MOVED_M}
    tipped = [k + 1 for k in range(len(now)) if k != query and scenes.tilt_rad(now[k]) - scenes.tilt_rad(start[k]) > TILT_RAD]
    floor = [k + 1 for k in range(len(now)) if world.on_floor(k)]
    yaw_rad = relations.view_yaw_rad(world.furniture.camera.world_from_camera)
    goal = problems.is_true(world, problem, yaw_rad)
    judged |= {"goal_true": goal, "disturbed": disturbed | {k: 0.0 for k in tipped if k not in disturbed}, "on_floor": floor}
    tilt = _turned(start[query], now[query])
    off_m = None
    if step.get("placement") is not None:
        placed_from_observed = np.reshape(placements[step["placement"]]["placed_from_observed"], (4, 4))
        wanted = placed_from_observed @ (world.observed or start)[query]
        off_m = math.dist(wanted[:3, 3], now[query][:3, 3])
    judged |= {"off_m": None if off_m is None else round(off_m, 4), "tilt_rad": round(tilt, 3)}
    cause = _cause(judged, step, reason, off_m, tilt, goal, placements)
    return judged | {"success": cause is None, "cause": cause}


def _turned(before, now):
    """How far the object's up has turned from what it was, radians."""
    cosine = float(before[2, :3] @ now[2, :3])
    return math.acos(min(1.0, max(-1.0, cosine)))


def _cause(judged, step, reason, off_m, tilt, goal, placements):
    """The first thing that went wrong, in the order in which a pick and place goes; none where nothing did."""
    if not step:
        return "refused"
    if not placements:
        return "no_placement"
    if step.get("execution") is None:
        return "no_grasp" if "no grasp" in reason else "no_motion"
    bad = {"grasp_lost": "grasp_lost", "stopped": "stopped"}.get(step["execution"])
    if judged["on_floor"]:
        return "on_floor"
    if bad:
        return bad
    if off_m is None or off_m > WITHIN_M:
        return "moved"
    if tilt > TILT_RAD:
        return "tipped"
    if judged["disturbed"]:
        return "disturbed"
    return None if goal else "goal_not_true"
