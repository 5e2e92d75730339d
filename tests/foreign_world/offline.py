"""The same trial without a network and without a clock: `repose plan --motion` plans on a frame folder, and the world follows the plan.

What comes of it does not depend on how busy the machine is, so it can be repeated; what it leaves out is the execution's own part: the
link, looking again, trying again. The arm's controller keeps the same rules.
"""

import json
import os
import subprocess
import sys
import tempfile

import numpy as np

from . import frames, grasps
from .trial import REST_S, Watched, reported, wish
from .world import STEP_S

CONVERTER = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "scripts", "graspnet.py")
OWNER = {"id": "offline", "epoch": 1}
# Placements that the arm may choose from, as `repose place --execute` asks for.
COUNT = 5
LAG_S, GRIPPER_S, REACHED_M, CLOSED_SHARE = 3.0, 3.0, 0.004, 0.3


class Ended(Exception):
    """The execution is over before its end; says as what, and why."""


def run(world, rng, problem, program, seed, pictures=None, grasps_from_elsewhere=False):
    """Plans, follows, judges; where grasps come from elsewhere, Repose is given them in place of finding its own."""
    watched = Watched(world, problem.query, pictures)
    with tempfile.TemporaryDirectory() as folder:
        frames.save(world, rng, folder)
        motion = os.path.join(folder, "motion.json")
        asked = [program, "plan", folder, *wish(problem, seed), "--count", str(COUNT), "--motion", motion, "--json"]
        offered = _grasps(world, problem.query, seed, folder) if grasps_from_elsewhere else None
        if offered:
            asked += ["--grasps", offered]
        planned = subprocess.run(asked, capture_output=True, text=True, check=False)
        plan = None
        if os.path.exists(motion):
            with open(motion, encoding="utf-8") as read:
                plan = json.load(read)
    said = json.loads(planned.stdout) if planned.stdout.strip() else {}
    step = {"result": said if planned.returncode in (0, 3) else {}}
    if grasps_from_elsewhere and not offered:
        step["reason"] = "no grasp was offered"
    elif plan:
        step["placement"] = plan["placement"]
        try:
            _follow(world, plan, watched)
            step["execution"] = "done"
        except Ended as ended:
            step["execution"], step["reason"] = ended.args
    elif planned.returncode not in (0, 3):
        # Planning the motion failed: the placements were there.
        error = said.get("error", said)
        step = {"result": {"placements": ["unserved"]}, "reason": f"{error.get('message', planned.stderr.strip()[-300:])}"}
    for k in range(round(REST_S / STEP_S)):
        world.step(0.0)
        if k * STEP_S > 0.5 and world.at_rest():
            break
    return reported(watched, problem, seed, ({"steps": [step]}, planned.stderr, planned.returncode), pictures)


def _grasps(world, query, seed, folder):
    """The file that the documented command makes of somebody else's grasps; none where there are none."""
    document = grasps.offered(world, query, np.random.default_rng(seed))
    if not document["grasps"]:
        return None
    theirs, ours = (os.path.join(folder, f"{name}.json") for name in ("network", "grasps"))
    with open(theirs, "w", encoding="utf-8") as out:
        json.dump(document, out)
    with open(ours, "w", encoding="utf-8") as out:
        subprocess.run([sys.executable, CONVERTER, theirs, "--frame", folder], stdout=out, check=True)
    return ours


def _follow(world, plan, watched):
    """The phases of a plan, one after the other, with the same judgement of fingers and arrival as the execution's."""
    control, seq, width_m = world.control, 0, 0.0
    control.owner, control.last_command = None, None

    def command(**fields):
        nonlocal seq
        seq += 1
        why = control.command({"v": 1, "seq": seq, "owner": OWNER, "ttl_ms": 1000, **fields}, 0.0, 0.0)
        if why:
            raise Ended("stopped", why)

    def steps(until, longest_s):
        for _ in range(round(longest_s / STEP_S)):
            world.step(0.0)
            watched.look()
            if control.stop:
                raise Ended("stopped", f"{control.stop['kind']}: {control.stop['reason']}")
            if until():
                return True
        return False

    command(task={"id": plan["scene_id"], "open": True})
    for phase in plan["phases"]:
        carrying = phase["name"] in ("lift", "transfer", "lower")
        if phase.get("gripper"):
            command(gripper=phase["gripper"])
            steps(lambda: False, 0.1)
            settled = steps(lambda: world.robot.settled, GRIPPER_S)
            wanted_m = phase["gripper"]["width_m"]
            if phase["name"] == "grasp":
                if not world.robot.grips and world.robot.width_m <= wanted_m + REACHED_M:
                    raise Ended("grasp_lost", "the gripper closed on nothing")
                width_m = world.robot.width_m
            elif not settled and abs(world.robot.width_m - wanted_m) > REACHED_M:
                raise Ended("stopped", f"the gripper stands at {world.robot.width_m:.3f} m and was sent to {wanted_m:.3f} m")
        points = phase.get("set_points")
        if points:
            command(starts_stream=True, ends_stream=True, set_points=points)
            end = points[-1]["q_rad"]
            there = lambda end=end: control.at_rest() and max(abs(a - b) for a, b in zip(end, control.measured_rad)) <= 1e-3  # noqa: E731
            if not steps(there, points[-1]["t_ms"] * 1e-3 + LAG_S):
                outcome = ("grasp_lost", "the hand met something before it was at the object")
                raise Ended(*(outcome if phase["name"] == "approach" else ("stopped", "the robot did not follow its set-points")))
        if carrying and not world.robot.grips and width_m - world.robot.width_m > CLOSED_SHARE * width_m:
            raise Ended("grasp_lost", "the object was lost on the way")
    command(task={"id": plan["scene_id"], "open": False})
