#!/usr/bin/env python3
"""Picks and places in a world that is not ours: PyBullet's Panda, contacts and pictures, on Repose's keys.

`pip install -r tests/foreign_world/requirements.txt`, then
`scripts/foreign_world.py --trials 12 --kind table --seed 1 --objects YCB` (a folder of scans: in each folder `mesh.obj`,
`convex_parts.stl` and `model.urdf`; without it only shapes made here). Starts a router and the services, asks `repose place --execute` for goals that do not hold yet, and judges by PyBullet's
poses: within 5 cm of the plan, the goal true, tilted by less than 15 degrees, nothing else moved by 2 cm.

Prints a JSON line per trial (or per exclusion) and one of totals at the end. Exits 0 when at least `--least` trials succeed, else 1.
"""

import argparse
import contextlib
import json
import math
import os
import sys
import tempfile
from collections import Counter

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "tests"))

import numpy as np
from foreign_world import frames, objects, offline, problems, scenes, trial
from foreign_world.cell import Cell
from foreign_world.deployment import Deployment
from foreign_world.world import STEP_S, World

# Shapes made here that are drawn from beside the scans.
GENERATED = 60


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=12, help="trials to run; excluded scenes do not count")
    parser.add_argument("--kind", choices=scenes.KINDS, default="table", help="what stands on the table beside the objects")
    parser.add_argument("--seed", type=int, default=0, help="of the scenes: trial k is of seed * 1000 + k")
    parser.add_argument("--first", type=int, default=0, help="the first k: to run one trial again")
    parser.add_argument("--objects", metavar="DIR", help="scans: in each folder mesh.obj, convex_parts.stl and model.urdf")
    parser.add_argument("--program", default=os.environ.get("REPOSE_COMMAND", "target/release/repose"), help="the repose program")
    parser.add_argument("--config", metavar="FILE", help="a configuration of the services")
    parser.add_argument("--time-scale", type=float, default=1.0, help="seconds of robot time in a second, as far as the machine keeps up")
    parser.add_argument("--pictures", metavar="DIR", help="where to put a strip of pictures of each trial")
    parser.add_argument("--frames", metavar="DIR", help="where to put a frame folder of each trial's scene, to look into what was planned")
    parser.add_argument("--logs", metavar="DIR", help="where the services' logs go; default: nowhere")
    parser.add_argument("--offline", action="store_true", help="without a network and a clock: one plan, followed as it is")
    parser.add_argument("--grasps", action="store_true", help="with --offline: grasps from elsewhere, by way of scripts/graspnet.py")
    parser.add_argument("--least", type=int, default=0, help="successes below which this exits 1")
    args = parser.parse_args()
    if args.grasps and not args.offline:
        parser.error("--grasps needs --offline")
    return args


def sound(world, shapes):
    """Those that stand after a drop, and the names of the others."""
    world.clear()
    kept, dropped = [], []
    for shape in shapes:
        stands = scenes.stands_after_a_drop(world.client, world.meshes, shape, STEP_S)
        (kept if stands else dropped).append(shape)
    return kept, [shape.name for shape in dropped]


def interval(good, of):
    """Wilson's 95 % interval of a rate, in percent."""
    if of == 0:
        return [0, 100]
    z, p = 1.96, good / of
    middle, half = p + z * z / (2 * of), z * math.sqrt(p * (1 - p) / of + z * z / (4 * of * of))
    return [round(100 * (middle + sign * half) / (1 + z * z / of)) for sign in (-1, 1)]


def trials(args, world, run, shapes, say):
    """Runs them with `run(problem, seed, rng)`; totals."""
    done, k = 0, args.first
    good, causes, excluded, floor = 0, Counter(), Counter(), 0
    while done < args.trials and k < args.first + 5 * args.trials + 10:
        seed = args.seed * 1000 + k
        k += 1
        rng = np.random.default_rng(seed)
        # Scans are half of what is drawn, however many there are.
        scanned, made = shapes
        few = [scanned[i] for i in rng.permutation(len(scanned))[:6]] if scanned else []
        pool = few + [made[i] for i in rng.permutation(len(made))[: max(6, len(few))]]
        if not world.furnish(args.kind, pool, rng):
            excluded["the scene does not stand"] += 1
            continue
        problem, why = problems.chosen(world, rng)
        if problem is None:
            excluded[why] += 1
            say({"seed": seed, "excluded": why})
            continue
        if args.frames:
            frames.save(world, np.random.default_rng(seed), os.path.join(args.frames, str(seed)))
        result = run(problem, seed, rng)
        done += 1
        good += result["success"]
        causes.update([result["cause"]] if result["cause"] else [])
        floor += bool(result["on_floor"])
        say({"seed": seed, "kind": args.kind, **result})
        # The next trial has a new robot; what the last one left latched or open is forgotten with it.
        world.control.forget()
    return {"trials": done, "good": good, "interval": interval(good, done), "causes": causes, "on_floor": floor, "excluded": excluded}


def offline_trials(args, world, _, shapes, say):
    """Trials without a network."""

    def run(problem, seed, rng):
        return offline.run(world, rng, problem, args.program, seed, args.pictures, args.grasps)

    return trials(args, world, run, shapes, say)


def live_trials(args, world, logs, shapes, say):
    """Trials of a deployment that is started for them."""
    with contextlib.closing(Deployment(args.program, logs, args.config)) as deployment:
        with contextlib.closing(Cell(world, deployment.connect, deployment.cell, time_scale=args.time_scale)) as cell:

            def run(problem, seed, rng):
                cell.begin(rng)
                if not cell.until_seen():
                    raise RuntimeError("perception makes no scenes of the camera's frames")
                result = trial.run(cell, problem, deployment.place(), seed, args.pictures)
                if deployment.ended():
                    raise RuntimeError(f"ended before its time: {', '.join(deployment.ended())}")
                return result

            return trials(args, world, run, shapes, say)


def main():
    args = arguments()
    # PyBullet prints to the standard output, which is for results.
    results = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)

    def say(line):
        print(json.dumps(line), file=results, flush=True)

    with tempfile.TemporaryDirectory() as folder:
        logs = args.logs or folder
        for made in filter(None, (args.logs, args.pictures, args.frames)):
            os.makedirs(made, exist_ok=True)
        world = World(objects.Meshes(folder))
        drawn = np.random.default_rng(7)
        scanned, unsound = sound(world, objects.scans(args.objects)) if args.objects else ([], [])
        made, unsound_made = sound(world, [objects.generated(drawn) for _ in range(GENERATED)])
        say({"unsound": unsound, "unsound_generated": len(unsound_made), "scans": len(scanned), "generated": len(made)})
        ran = offline_trials if args.offline else live_trials
        totals = ran(args, world, logs, (scanned, made), say)
        say(totals)
    sys.exit(0 if totals["good"] >= args.least else 1)


if __name__ == "__main__":
    main()
