#!/usr/bin/env python3
"""Goals about several objects, brought about by the simulated robot: `repose arrange --execute` on simulated cells, one task a scene.

`scripts/arrange_trials.py --goals 3 --tasks 10 --first 1000` starts `repose up` with the seeds from 1000 on, draws goals about sides of one object
that stays, until the planner has moves for them on the first view and none of them holds yet, and has them carried out. Scenes with too few objects, or for
whose goals the planner has no moves in ten draws, are left out and counted. So are draws that are refused before anything moves, as an object of them
offers the hand no grasp: others are drawn. What is said of the goals is what the last view shows, by rule; of what is hidden at the end, what was seen last.

Prints a JSON line for each task, and one of totals at the end. Exits 0 when at least `--least` tasks are achieved, else 1.
"""

import argparse
import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections import Counter

SIDES = ("left_of", "right_of", "in_front_of", "behind")
DRAWS = 10
READY_WITHIN_S = 180


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--goals", type=int, default=3, help="goals of each task; an object more must be seen")
    parser.add_argument("--tasks", type=int, default=10, help="tasks to run; scenes that are left out do not count")
    parser.add_argument("--first", type=int, default=0, help="seed of the first scene")
    parser.add_argument("--attempts", type=int, default=3, help="how often an object is tried")
    parser.add_argument("--deadline", type=float, default=120, help="seconds for a call that does not move the robot")
    parser.add_argument("--patience", type=float, default=900, help="seconds for a task, at most")
    parser.add_argument("--program", default=os.environ.get("REPOSE", "target/release/repose"), help="the repose program")
    parser.add_argument("--config", metavar="FILE", help="a configuration of the services")
    parser.add_argument("--least", type=int, default=0, help="achieved tasks below which this exits 1")
    return parser.parse_args()


class System:
    """A simulated cell with its services, until closed."""

    def __init__(self, args, seed):
        with socket.socket() as free, socket.socket() as page:
            free.bind(("127.0.0.1", 0))
            page.bind(("127.0.0.1", 0))
            self.connect, console = f"tcp/127.0.0.1:{free.getsockname()[1]}", f"127.0.0.1:{page.getsockname()[1]}"
        self.program, self.deadline_ms = args.program, round(args.deadline * 1000)
        config = ["--config", args.config] if args.config else []
        command = [args.program, "--json", "up", "--listen", self.connect, "--seed", str(seed), *config]
        environment = {**os.environ, "REPOSE_CONSOLE__LISTEN": console}
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(30)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def ask(self, *words, within_s):
        """What a command prints as JSON; None where it prints nothing in time."""
        command = [self.program, "--json", *words, "--connect", self.connect, f"--deadline-ms={self.deadline_ms}"]
        try:
            said = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=within_s, check=False).stdout
        except subprocess.TimeoutExpired:
            return None
        return json.loads(said) if said.strip() else None

    def scene(self):
        """The newest scene, once there is one."""
        give_up = time.monotonic() + READY_WITHIN_S
        while time.monotonic() < give_up and self.process.poll() is None:
            scene = self.ask("scene", within_s=60)
            if scene and scene.get("objects"):
                return scene
            time.sleep(1)
        raise TimeoutError("the cell shows no scene")


def drawn(system, ids, goals, rng):
    """Goals of which none holds yet and for which the planner has moves, with its plan; None where no draw gives some."""
    for _ in range(DRAWS):
        stays, *moves = rng.sample(ids, goals + 1)
        wanted = [f"--goal={object}={rng.choice(SIDES)}:{stays}" for object in moves]
        plan = system.ask("arrange", *wanted, within_s=300)
        if plan and plan.get("outcome") == "found" and not plan["satisfied"]:
            return wanted, plan
    return None


def reason(told):
    """Why a task was not achieved, in a word or two, for counting: what went wrong with its last moves."""
    if told is None:
        return "no answer in time"
    if told.get("ended") == "achieved":
        return None
    if "error" in told and "ended" not in told:
        return told["error"].get("message", "an error")
    failed = [step.get("execution") or "not executed" for step in told["steps"] if step.get("reason") or step.get("execution") != "done"]
    return f"{told['ended']}: {told.get('why', '')}" + (f" ({', '.join(failed)})" if failed else "")


def is_refused(told):
    """Whether nothing was tried, as the hand cannot make one of the moves."""
    return told is not None and told.get("ended") == "no_arrangement" and not told["steps"]


def task(args, seed):
    """One task; None where the scene gives none."""
    rng = random.Random(seed)
    with System(args, seed) as system:
        ids = [seen["id"] for seen in system.scene()["objects"]]
        if len(ids) <= args.goals:
            return None
        refused = []
        while len(refused) < DRAWS:
            found = drawn(system, ids, args.goals, rng)
            if found is None:
                return None
            wanted, plan = found
            started = time.monotonic()
            told = system.ask("arrange", *wanted, "--execute", f"--attempts={args.attempts}", within_s=args.patience)
            if not is_refused(told):
                break
            refused.append(told["why"])
        else:
            return None
        return {
            "seed": seed,
            "goals": [goal.removeprefix("--goal=") for goal in wanted],
            "planned_moves": len(plan["moves"]),
            "probability": plan["probability"],
            "achieved": told is not None and told.get("ended") == "achieved",
            "goals_that_hold": (told or {}).get("achieved"),
            "remembered": (told or {}).get("remembered", []),
            "refused": refused,
            "moves": [
                {key: step.get(key) for key in ("object", "execution", "reason", "fates")} | {"purpose": step["planned"]["purpose"]}
                for step in (told or {}).get("steps", [])
            ],
            "reason": reason(told),
            "robot": (told or {}).get("robot"),
            "seconds": round(time.monotonic() - started, 1),
        }


def main():
    args = arguments()
    done, left_out, seed = [], 0, args.first
    while len(done) < args.tasks and seed < args.first + 20 * args.tasks:
        result = task(args, seed)
        seed += 1
        if result is None:
            left_out += 1
            continue
        done.append(result)
        print(json.dumps(result), flush=True)
    achieved = sum(result["achieved"] for result in done)
    reasons = Counter(result["reason"] for result in done if result["reason"])
    refused = sum(len(result["refused"]) for result in done)
    totals = {"goals": args.goals, "tasks": len(done), "achieved": achieved, "left_out": left_out, "refused": refused}
    print(json.dumps(totals | {"reasons": dict(reasons.most_common())}))
    return 0 if achieved >= args.least else 1


if __name__ == "__main__":
    sys.exit(main())
