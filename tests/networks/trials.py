#!/usr/bin/env python3
"""A robot's cell and an office in networks of their own, with a slow, narrow, lossy or cut link between: what of Repose bears that, and how well.

    tests/networks/trials.py --program target/release/repose [short delay narrow execute cut clocks]

The cell has a router, the simulator, perception and motion; the office has a router, a planner and an inference process. Prints a JSON document for
each measurement, and with `short`, which `cargo test` runs, fails where something does not hold. Needs root, iproute2 and nothing else: without them
it says so on standard error and exits 77.
"""

import argparse
import contextlib
import csv
import json
import os
import pathlib
import statistics
import subprocess
import sys
import time

from networks import ENDPOINT, Networks, bytes_between, missing

CELL_SERVICES, OFFICE_SERVICES = ("simulator", "perception", "motion"), ("inference", "planner")
# What exits where something that is needed is not there.
SKIPPED = 77
# A library that gives a process a clock of its own (Debian's libfaketime), where it is.
FAKETIME = "/usr/lib/x86_64-linux-gnu/faketime/libfaketime.so.1"


@contextlib.contextmanager
def system(settings, cell=CELL_SERVICES, office=OFFICE_SERVICES, environment=None, seed=1):
    """Both networks with their routers and services; `environment` by service."""
    environment = environment or {}
    with Networks(settings.program, settings.log) as networks:
        networks.start_routers()
        for namespace, services in ((networks.cell, cell), (networks.office, office)):
            for service in services:
                own = {"REPOSE_INFERENCE__THREADS": "1", "REPOSE_SIMULATOR__SEED": str(seed), **environment.get(service, {})}
                networks.start(namespace, service, environment=own)
        networks.wait_for(networks.office, (*cell, *office))
        yield networks


def told(trial, **what):
    """Prints a measurement."""
    print(json.dumps({"trial": trial, **what}), flush=True)


def load(networks, namespace, *words):
    """A run of `repose load` in a network: its report."""
    code, report, _, log = networks.repose(namespace, "load", *words)
    if report is None:
        raise SystemExit(f"load ended with {code}:\n{log}")
    return report


def place_words(variant):
    return ["place", "--move", "1", "--goal", "near:2", "--variant", variant, "--deadline-ms", "30000"]


def placed(networks, namespace, variant, count):
    """So many `repose place` commands, each on a scene that the office has not seen: seconds, and bytes over the link, of each that was answered."""
    seconds, sent, failed = [], [], []
    for _ in range(count):
        before = networks.link()
        code, document, took, _ = networks.repose(namespace, *place_words(variant))
        between = bytes_between(before, networks.link())
        if code in (0, 3):
            seconds.append(took)
            sent.append(between)
        else:
            failed.append((document or {}).get("error", {}).get("message", f"exit {code}"))
    summary = {"answered": len(seconds), "failed": failed}
    if seconds:
        summary |= {"p50_s": round(statistics.median(seconds), 3), "most_s": round(max(seconds), 3)}
        summary |= {f"{name}_bytes": int(statistics.median(one[name] for one in sent)) for name in ("cell", "office")}
    return summary


def idle(networks, seconds):
    """Bytes a second that cross the link while nobody asks anything."""
    before, begin = networks.link(), time.monotonic()
    time.sleep(seconds)
    took = time.monotonic() - begin
    return {name: round(count / took) for name, count in bytes_between(before, networks.link()).items()}


def asked(networks, namespace, variant, requests):
    """Latencies of requests by a scene's id, in a closed loop, and bytes over the link for each."""
    base, begin = idle(networks, 3), None
    words = ["--clients", 1, "--warm-up", 4, "--variant", variant, "--seed", 1]
    reports, sent, took = [], [], []
    # What a run needs beside its requests is the same in both.
    for count in (requests, 3 * requests):
        before, begin = networks.link(), time.monotonic()
        reports.append(load(networks, namespace, "--requests", count, *words))
        took.append(time.monotonic() - begin)
        sent.append(bytes_between(before, networks.link()))
    each = {name: round((sent[1][name] - sent[0][name] - base[name] * (took[1] - took[0])) / (2 * requests)) for name in base}
    latency, stages = reports[1]["latency_ms"], reports[1]["stages_ms"]
    return {
        "p50_ms": latency["p50"], "p99_ms": latency["p99"], "network_p50_ms": stages.get("network", {}).get("p50"),
        "bytes_a_request": each, "outcomes": reports[1]["outcomes"],
    }


def delay(settings):
    """No delay, 20 and 80 ms each way: a request by its scene's id, from either network, and the whole command on a new scene."""
    with system(settings) as networks:
        for delay_ms in (0, 20, 80):
            networks.link(delay_ms=delay_ms)
            time.sleep(2)
            link = {"delay_ms": delay_ms}
            told("idle", link=link, bytes_per_s=idle(networks, 5))
            for where in ("cell", "office"):
                namespace = getattr(networks, where)
                told("request", link=link, client=where, **asked(networks, namespace, settings.variant, 20))
                told("command", link=link, client=where, **placed(networks, namespace, settings.variant, 5))


def narrow(settings):
    """1 % loss, 10 Mbit/s, and both, at 20 ms each way; with scenes as they are, and packed."""
    for is_packed in (False, True):
        environment = {"planner": {"REPOSE_CALLER__PACKED_SCENES": "true"}} if is_packed else {}
        with system(settings, environment=environment) as networks:
            links = ((0.01, None), (0.0, 10)) if settings.brief else ((0.0, None), (0.01, None), (0.0, 10), (0.01, 10))
            for loss, mbit in links:
                networks.link(delay_ms=20, loss=loss)
                networks.rate(mbit)
                time.sleep(2)
                link = {"delay_ms": 20, "loss": loss, "mbit": mbit}
                if not is_packed:
                    told("request", link=link, client="cell", **asked(networks, networks.cell, settings.variant, 30))
                told("command", link=link, client="office", packed=is_packed, **placed(networks, networks.office, settings.variant, 3 if settings.brief else 5))


def execution(networks, client, environment=None):
    """`place --execute`: how it ended, and how the robot stands afterwards."""
    words = [*place_words("geometric"), "--execute", "--attempts", "1"]
    code, document, seconds, log = networks.repose(client, *words, environment=environment)
    step = ((document or {}).get("steps") or [{}])[-1]
    error = (document or {}).get("error") or {}
    time.sleep(1)
    _, state, _, _ = networks.repose(networks.cell, "robot", "state")
    state = (state or {}).get("state", state) or {}
    speeds = state.get("dq_rad_s") or [1.0]
    return {
        "exit": code, "seconds": round(seconds, 1), "execution": step.get("execution"), "holds": step.get("holds"),
        "reason": error.get("message") or step.get("reason"), "mode": state.get("mode"), "stop": (state.get("stop") or {}).get("kind"),
        "stands": max(map(abs, speeds)) < 1e-6, "said": log.strip().splitlines()[-1:] if document is None else [],
    }


def execute(settings):
    """Executions with motion in the cell, and with its set-points over the link, whose delay, jitter and loss grow."""
    with system(settings) as networks:
        networks.link(delay_ms=80, loss=0.01)
        told("execute", motion="cell", link={"delay_ms": 80, "loss": 0.01}, **execution(networks, networks.office))
    links = [
        {"delay_ms": 80}, {"delay_ms": 150}, {"delay_ms": 250}, {"delay_ms": 400}, {"delay_ms": 20, "jitter_ms": 300},
        {"delay_ms": 20, "loss": 0.01}, {"delay_ms": 80, "loss": 0.03},
    ]
    for link in [links[0], links[2], links[3]] if settings.brief else links:
        with system(settings, cell=("simulator", "perception"), office=("planner", "motion")) as networks:
            networks.link(**link)
            told("execute", motion="office", link=link, **execution(networks, networks.office))


def carries_scenes(networks):
    """Waits until a scene comes over the link as quickly as the link allows: after its delay has changed TCP sends little at first, for seconds."""
    words = ["--clients", 1, "--requests", 2, "--variant", "geometric", "--deadline-ms", 30000]
    for seed in range(12):
        # Every run takes the newest scene, which the office has not seen.
        if load(networks, networks.cell, *words, "--seed", seed)["latency_ms"]["max"] < 1500.0:
            return
    raise SystemExit("the link does not carry a scene within 1.5 s")


def requests_through_a_cut(networks, folder, cut_s, around_s):
    """Requests from the cell, four a second, while the link is cut: what ended how, and how long after the link came back the first was answered."""
    lines = pathlib.Path(folder, "cut.csv")
    carries_scenes(networks)
    # Enough of them for the time after the cut, although the first may take some of it.
    rate, seconds = 4, cut_s + 2 * around_s + 4
    words = ["load", "--rate", rate, "--requests", int(rate * seconds), "--variant", "geometric", "--deadline-ms", 20000]
    command = ["ip", "netns", "exec", networks.cell, networks.program, "--json", *map(str, words), "--csv", str(lines), "--connect", ENDPOINT]
    log_level = {"REPOSE_LOG": "warn,repose::commands::load=debug"}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, **log_level})
    # It says when the first request has ended: until then it gets ready.
    log = process.stderr.readline()
    while "request ended" not in log:
        if not log:
            raise SystemExit(f"load ended with {process.wait()}: {process.stdout.read()}")
        log = process.stderr.readline()
    time.sleep(around_s)
    networks.link(is_cut=True)
    time.sleep(cut_s)
    networks.link(is_cut=False)
    printed, log = process.communicate(timeout=120)
    if not printed.strip():
        raise SystemExit(f"load ended with {process.returncode}:\n{log}")
    report = json.loads(printed)
    with open(lines, encoding="utf-8") as table:
        ended = [(float(row["due_s"]), float(row["due_s"]) + float(row["took_ms"]) / 1e3, row["outcome"]) for row in csv.DictReader(table)]
    # The run's own time began with its first request, ours when that, or another, had ended: on a busy machine seconds later.
    ours_s = min(end for _, end, _ in ended)
    cut_at_s, mended_s = ours_s + around_s, ours_s + around_s + cut_s
    answered = sorted(end for _, end, outcome in ended if outcome in ("result", "none"))
    after = [end for end in answered if end > mended_s]
    unanswered = [due for due, _, outcome in ended if outcome not in ("result", "none")]
    return {
        "cut_s": cut_s, "requests": report["requests"], "outcomes": report["outcomes"], "late": report["late"],
        "answered_meanwhile": sum(cut_at_s + 0.5 < end < mended_s for end in answered),
        "first_answer_after_s": round(after[0] - mended_s, 2) if after else None,
        "last_unanswered_after_s": round(max(unanswered) - mended_s, 2) if unanswered else None,
        "slowest_ms": report["latency_ms"]["max"],
    }


def cut(settings):
    """The link cut for one second, and for five."""
    with system(settings) as networks:
        networks.link(delay_ms=20)
        for cut_s in (5,) if settings.brief else (1, 5):
            told("cut", link={"delay_ms": 20}, **requests_through_a_cut(networks, networks.folder.name, cut_s, 8))


def clocks(settings):
    """Hosts whose clocks are two seconds ahead or behind: executions end as ever, and `status` says whose clock is off."""
    if not os.path.exists(FAKETIME):
        print(f"clocks left out: there is no {FAKETIME} (Debian's libfaketime)", file=sys.stderr)
        return
    shifted = {s: {"LD_PRELOAD": FAKETIME, "FAKETIME": f"{s:+d}s", "DONT_FAKE_MONOTONIC": "1", "FAKETIME_DONT_RESET": "1"} for s in (-2, 2)}
    # The simulator is the robot's side and its camera.
    cases = [(who, seconds) for who in ("client", "motion", "simulator") for seconds in (-2, 2)]
    for who, seconds in cases[:3] if settings.brief else cases:
        environment = {who: shifted[seconds]}
        with system(settings, environment=environment) as networks:
            client = environment.get("client")
            ended = execution(networks, networks.office, client)
            _, status, _, _ = networks.repose(networks.office, "status", environment=client)
            wrong = [sentence for sentence in (status or {}).get("wrong", []) if "clock" in sentence]
            told("clock", of=who, ahead_s=seconds, **ended, status=wrong)


def short(settings):
    """What holds in every deployment, in twenty seconds: delay is paid once, nothing crosses unasked, a cut link heals."""
    with system(settings, cell=("simulator", "perception"), office=("planner",)) as networks:
        settings.variant = "geometric"
        words = ["--clients", 1, "--requests", 12, "--warm-up", 2, "--variant", "geometric"]
        near = load(networks, networks.cell, *words)
        networks.link(delay_ms=50)
        far = load(networks, networks.cell, *words)
        more_ms = far["latency_ms"]["p50"] - near["latency_ms"]["p50"]
        told("request", near_ms=near["latency_ms"]["p50"], far_ms=far["latency_ms"]["p50"])
        # There and back once, and what a busy machine adds; twice would be 200 ms.
        hold(80.0 < more_ms < 180.0, f"50 ms each way cost {more_ms:.0f} ms")
        quiet = idle(networks, 2)
        told("idle", bytes_per_s=quiet)
        hold(quiet["cell"] < 20_000, f"{quiet['cell']} bytes a second leave the cell unasked")
        through = requests_through_a_cut(networks, networks.folder.name, 4, 2)
        told("cut", **through)
        outcomes = through["outcomes"]
        # While nobody is in sight a call is told so after a second.
        ended = sum(outcomes.get(name, 0) for name in ("result", "none", "unavailable"))
        hold(ended == through["requests"] and outcomes["duplicate"] == 0, f"{outcomes}")
        hold(through["answered_meanwhile"] == 0, "requests were answered through a cut link")
        healed_s = through["first_answer_after_s"]
        hold(healed_s is not None and healed_s < 10.0, f"the link healed after {healed_s} s")


def hold(condition, otherwise):
    if not condition:
        raise SystemExit(f"does not hold: {otherwise}")


TRIALS = {"short": short, "delay": delay, "narrow": narrow, "execute": execute, "cut": cut, "clocks": clocks}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("trials", nargs="*", choices=[*TRIALS, []], help="which; all but `short` by default")
    parser.add_argument("--program", default="target/release/repose", help="the program")
    parser.add_argument("--variant", default="geometric", help="how placements are searched for")
    parser.add_argument("--brief", action="store_true", help="fewer cases of each")
    parser.add_argument("--log", help="where the services' log goes; nowhere by default")
    settings = parser.parse_args()
    settings.program = pathlib.Path(settings.program).resolve()
    if why := missing():
        print(f"left out: {why}", file=sys.stderr)
        sys.exit(SKIPPED)
    with open(settings.log or os.devnull, "a", encoding="utf-8") as settings.log:
        for name in settings.trials or [name for name in TRIALS if name != "short"]:
            TRIALS[name](settings)


if __name__ == "__main__":
    main()
