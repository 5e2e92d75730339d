#!/usr/bin/env python3
"""What a deployment on this machine bears: capacity, cells on one pool, overload, faults and a soak, each a run of `repose load --up`; and networks apart.

    deploy/record/measure.py --program target/release/repose --commit "$(git rev-parse --short HEAD)" [capacity cells idle light light2 gateways overload recovery faults soak]
    deploy/record/measure.py --program target/release/repose --commit … networks --trials delay narrow execute cut clocks      # as root

Every run starts a system of its own (router, simulated cell, services), asks it, and ends it. One JSON document a run is appended to
`runs.jsonl` beside this file (or to --out), with the command, what it printed, and the memory, descriptors and processor time of the
system's processes over time, and a line a run is printed. `networks` appends what `tests/networks/trials.py` prints. Needs nothing but
Python's standard library.
"""

import argparse
import csv
import datetime
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import threading
import time

# Seconds between two readings of memory, descriptors and processor time.
READ_EVERY_S = 5.0
# Where systems of `repose up` listen.
UP = "tcp/127.0.0.1:17440"
TICKS_PER_S = os.sysconf("SC_CLK_TCK")
TRIALS = pathlib.Path(__file__).parents[2] / "tests/networks/trials.py"


def family(root):
    """The processes below `root`, with what each is."""
    parents = {}
    for entry in pathlib.Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
                parents.setdefault(int(fields[1]), []).append(int(entry.name))
            except OSError:
                pass
    found, open_ids = [], [root]
    while open_ids:
        children = parents.get(open_ids.pop(), [])
        found += children
        open_ids += children
    return found


def reading(process):
    """Resident memory (MiB), open descriptors and processor time (s) of a process; none once it has ended."""
    try:
        folder = pathlib.Path(f"/proc/{process}")
        words = (folder / "cmdline").read_bytes().split(b"\0")
        resident = next(line for line in (folder / "status").read_text().splitlines() if line.startswith("VmRSS"))
        what = words[words.index(b"serve") + 1].decode() if b"serve" in words else "load"
        used = (folder / "stat").read_text().rpartition(")")[2].split()[11:13]
        return what, int(resident.split()[1]) / 1024, len(os.listdir(folder / "fd")), sum(map(int, used)) / TICKS_PER_S
    except (OSError, StopIteration, ValueError, IndexError):
        return None


class Watch(threading.Thread):
    """Reads the memory and descriptors of a run's processes, by service: the largest process of each; and the processor time of all of them."""

    def __init__(self, root):
        super().__init__(daemon=True)
        self.root, self.readings, self.used, self.over = root, [], [], threading.Event()

    def run(self):
        while not self.over.wait(READ_EVERY_S):
            now, used = {}, {}
            # The program that asks is the root.
            for process, read in ((process, reading(process)) for process in (self.root, *family(self.root))):
                if read is None:
                    continue
                what, memory, descriptors, used[what, process] = read
                before = now.get(what, (0.0, 0))
                now[what] = (max(before[0], round(memory, 1)), max(before[1], descriptors))
            if now:
                self.readings.append(now)
                self.used.append((time.monotonic(), used))

    def summary(self):
        """By service: memory and descriptors after a tenth of the run, at its end, and the most."""
        if not self.readings:
            return {}
        first = self.readings[len(self.readings) // 10]
        last = self.readings[-1]
        services = set(first) & set(last)
        return {
            what: {
                "mib": [first[what][0], last[what][0], max(r[what][0] for r in self.readings if what in r)],
                "descriptors": [first[what][1], last[what][1], max(r[what][1] for r in self.readings if what in r)],
            }
            for what in sorted(services)
        }

    def cores(self):
        """By service: cores in use by all its processes in the second half of the run, when everything has started."""
        if len(self.used) < 4:
            return {}
        (begin, before), (end, after) = self.used[len(self.used) // 2], self.used[-1]
        cores = {}
        for process, seconds in after.items():
            if process in before:
                cores[process[0]] = cores.get(process[0], 0.0) + (seconds - before[process]) / (end - begin)
        return {what: round(share, 3) for what, share in sorted(cores.items())}


def run(settings, group, name, words):
    """One run; its document, or none where it was not asked for."""
    if settings.only not in name:
        return None
    command = [settings.program, "load", "--up", "--json", *map(str, words)]
    began = datetime.datetime.now(datetime.timezone.utc)
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    watch = Watch(process.pid)
    watch.start()
    # Both pipes are read at once: a full one would hold the run up.
    printed, log = process.communicate()
    watch.over.set()
    document = {
        "group": group,
        "name": name,
        "command": " ".join(["repose", *command[1:]]),
        "commit": settings.commit,
        "began": began.isoformat(timespec="seconds"),
        "load_before": os.getloadavg()[0],
        "cores": os.cpu_count(),
        "exit": process.returncode,
        "report": json.loads(printed) if printed.strip() else None,
        "processes": watch.summary(),
        "cores_used": watch.cores(),
        # A process that aborts says so on its last line.
        "aborts": [line for line in log.splitlines() if "panicked" in line or "allocation of" in line or "SIGABRT" in line][:20],
    }
    with open(settings.out, "a", encoding="utf-8") as out:
        out.write(json.dumps(document) + "\n")
    print(line(document), flush=True)
    return document


def line(document):
    """A run in a line."""
    report = document["report"]
    if not report or "error" in report:
        return f"{document['group']:9} {document['name']:34} exit {document['exit']}"
    latency, priorities = report["latency_ms"], report["priorities"]
    refused = report["outcome_latency_ms"].get("resource_exhausted", {}).get("p99")
    share = {p: f"{v['outcomes'].get('result', 0)}/{v['requests']}" for p, v in priorities.items() if v["requests"]}
    return (
        f"{document['group']:9} {document['name']:34} {report['achieved_per_s']:6.2f}/s goodput {report['goodput_per_s']:6.2f}/s"
        f"  p50 {latency['p50']:7.0f} ms p99 {latency['p99']:7.0f} ms  late {report['late']}  lost {report['outcomes'].get('lost', 0)}"
        f"  twice {report['outcomes'].get('duplicate', 0)}  answered {share}  refusals p99 {refused}  aborts {len(document['aborts'])}"
    )


def capacity(settings):
    """One to eight workers, one and two routers, with and without encryption, and with a slow link."""
    count = settings.requests
    closed = ["--clients", 8, "--requests", count, "--warm-up", 16]
    for workers in (1, 2, 4, 8):
        run(settings, "capacity", f"{workers} planners", [*closed, "--planners", workers])
    run(settings, "capacity", "2 planners, 2 inference", [*closed, "--planners", 2, "--inference", 2])
    run(settings, "capacity", "2 planners, 2 routers", [*closed, "--planners", 2, "--routers", 2])
    run(settings, "capacity", "2 planners, QUIC", [*closed, "--planners", 2, "--secured"])
    for delay in (20, 80):
        run(settings, "capacity", f"2 planners, {delay} ms each way", [*closed, "--planners", 2, "--fault", f"delay:{delay}ms"])


def cells(settings):
    """One to sixteen light cells on one planner and one inference process, with as many clients."""
    # Two scenes a cell.
    os.environ.update({"REPOSE_PLANNER__SCENES": "32", "REPOSE_INFERENCE__SCENES": "32"})
    for count in (1, 2, 4, 8, 16):
        words = ["--cells", count, "--clients", count, "--requests", settings.requests, "--warm-up", 8 * count]
        run(settings, "cells", f"{count} cells", words)


def started(settings, words, environment=None):
    """`repose up`, once everything is up; and its command."""
    command = [settings.program, "--json", "up", "--listen", UP, *words]
    environment = {**os.environ, "REPOSE_CONSOLE__LISTEN": "127.0.0.1:0", **(environment or {})}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment)
    # One document, over several lines, when everything is up.
    said = process.stdout.readline()
    while said and said.rstrip() != "}":
        said = process.stdout.readline()
    return process, " ".join(["repose", *command[1:]])


def threads(process):
    """Processor time (s) of a process's threads, and how often they were switched to, by name without its number; nothing once it has ended."""
    now = {}
    try:
        for thread in pathlib.Path(f"/proc/{process}/task").iterdir():
            name, fields = (thread / "stat").read_text().partition("(")[2].rpartition(")")[::2]
            switches = sum(int(line.split()[1]) for line in (thread / "status").read_text().splitlines() if "ctxt_switches" in line)
            before = now.get(name.rstrip("0123456789-"), (0.0, 0))
            now[name.rstrip("0123456789-")] = (before[0] + sum(map(int, fields.split()[11:13])) / TICKS_PER_S, before[1] + switches)
    except OSError:
        pass
    return now


def memory(process):
    """What of a process is in memory, MiB: all, its share where pages are shared with others, and what is no file's."""
    try:
        lines = pathlib.Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()[1:]
    except OSError:
        return {}
    values = {line.split(":")[0]: int(line.split()[1]) / 1024 for line in lines}
    return {name: round(values.get(key, 0.0), 1) for name, key in (("resident", "Rss"), ("share", "Pss"), ("own", "Pss_Anon"))}


def parts(root, seconds):
    """By service: the memory of its largest process, and over so many seconds its threads' share of a core and switches a second."""
    before = {process: threads(process) for process in family(root)}
    time.sleep(seconds)
    found = {}
    for process, then in before.items():
        read, now = reading(process), threads(process)
        if read is None or (read[0] in found and found[read[0]]["mib"].get("resident", 0.0) >= read[1]):
            continue
        share = {
            name: [round((used - then.get(name, (0.0, 0))[0]) / seconds, 4), round((switches - then.get(name, (0.0, 0))[1]) / seconds)]
            for name, (used, switches) in now.items()
        }
        found[read[0]] = {"mib": memory(process), "threads": {name: of for name, of in sorted(share.items()) if of[0] > 0}}
    return found


def idle(settings):
    """What cells cost that nobody asks anything: one, one with a camera as real ones are, and four that share a pool."""
    real = {"REPOSE_SIMULATOR__LABELS": "false", "REPOSE_SIMULATOR__FRAME_PERIOD_MS": "66"}
    for name, count, environment in (("1 cells", 1, {}), ("1 cells, 15 frames a second without labels", 1, real), ("4 cells", 4, {})):
        began = datetime.datetime.now(datetime.timezone.utc)
        process, command = started(settings, ["--cells", str(count)], environment)
        # Its own start asked for scenes, which is remembered for ten seconds.
        time.sleep(20)
        watch = Watch(process.pid)
        watch.start()
        found = parts(process.pid, 8 * READ_EVERY_S)
        watch.over.set()
        document = {
            "group": "idle", "name": name, "command": " ".join([*(f"{key}={value}" for key, value in environment.items()), command]),
            "commit": settings.commit, "began": began.isoformat(timespec="seconds"), "load": os.getloadavg()[0], "cores": os.cpu_count(),
            "processes": watch.summary(), "cores_used": watch.cores(), "parts": found,
        }
        process.terminate()
        process.wait()
        with open(settings.out, "a", encoding="utf-8") as out:
            out.write(json.dumps(document) + "\n")
        print(f"idle      {name}: cores {document['cores_used']}", flush=True)
        for what, part in found.items():
            print(f"          {what}: MiB {part['mib']}, threads (share of a core, switches a second) {part['threads']}", flush=True)


def gateways(settings):
    """Two hundred light cells at the router of their pool, and behind four gateways of it: what the router has to do. Needs eclipse-zenoh."""
    for count in (0, 4):
        began = datetime.datetime.now(datetime.timezone.utc)
        system, up = started(settings, [])
        endpoints = [f"tcp/127.0.0.1:{17451 + k}" for k in range(count)]
        script = pathlib.Path(__file__).with_name("gateway.py")
        between = [
            subprocess.Popen([sys.executable, script, UP, at], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for at in endpoints
        ]
        for gateway in between:
            gateway.stdout.readline()
        words = ["--pool", "cell", "--cells", 200, "--rate", 0.5, "--requests", 13, "--variant", "geometric"]
        command = [settings.program, "--json", "load", "--connect", ",".join(endpoints or [UP]), *map(str, words)]
        watch = Watch(system.pid)
        watch.start()
        ran = subprocess.run(command, capture_output=True, text=True)
        watch.over.set()
        below = {"gateway": [reading(gateway.pid)[1] for gateway in between]}
        for process in (*between, system):
            process.terminate()
            process.wait()
        document = {
            "group": "gateways", "name": f"200 light cells, {count} gateways", "command": " ".join(["repose", *command[1:]]), "up": up,
            "commit": settings.commit, "began": began.isoformat(timespec="seconds"), "load": os.getloadavg()[0], "cores": os.cpu_count(),
            "report": json.loads(ran.stdout) if ran.stdout.strip() else None, "processes": watch.summary(), "cores_used": watch.cores(),
            "gateways_mib": below["gateway"],
        }
        with open(settings.out, "a", encoding="utf-8") as out:
            out.write(json.dumps(document) + "\n")
        report, router = document["report"] or {}, document["processes"].get("router")
        print(f"gateways  {count}: {report.get('light') or report}, router {router}, cores {document['cores_used']}, MiB {below}", flush=True)


def light(settings, routers=1):
    """One to two hundred light cells with the traffic of robots and perception, and a request every other second from one of them."""
    for count in settings.light_cells:
        words = ["--cells", count, "--routers", routers, "--rate", 0.5, "--requests", 13, "--warm-up", 2, "--variant", "geometric"]
        document = run(settings, "light", f"{count} light cells, {routers} routers", words)
        report, router = document["report"] or {}, document["processes"].get("router", {})
        print(f"          {report.get('light')}\n          router {router} cores {document['cores_used']}")


def light2(settings):
    """The same on two routers: every other cell is at the second."""
    light(settings, 2)


def networks(settings):
    """A cell and an office in networks of their own."""
    for trial in settings.trials:
        command = [sys.executable, str(TRIALS), "--program", settings.program, *(["--brief"] if settings.brief else []), trial]
        began = datetime.datetime.now(datetime.timezone.utc)
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        for printed in process.stdout:
            document = {
                "group": "networks", "command": " ".join(["tests/networks/trials.py", *command[4:]]), "commit": settings.commit,
                "began": began.isoformat(timespec="seconds"), "load": os.getloadavg()[0], "cores": os.cpu_count(), **json.loads(printed),
            }
            with open(settings.out, "a", encoding="utf-8") as out:
                out.write(json.dumps(document) + "\n")
            print(printed.strip(), flush=True)
        if process.wait() != 0:
            print(f"{trial}: exit {process.returncode}", flush=True)


def overload(settings):
    """Half as much again, and three times what can be done, a third of it interactive."""
    count = settings.requests
    deadline = ["--deadline-ms", 3000]
    measured = run(settings, "overload", "capacity, 8 clients", ["--clients", 8, "--requests", count, "--warm-up", 16])
    rate = measured["report"]["achieved_per_s"]
    for factor in (1.5, 3.0):
        words = ["--rate", f"{factor * rate:.2f}", "--requests", int(factor * count), "--interactive", 0.3, "--warm-up", 16, *deadline]
        document = run(settings, "overload", f"{factor} x", words)
        print(f"          goodput {document['report']['goodput_per_s'] / rate:.3f} of the capacity")


def recovery(settings):
    """How a steady interactive load at half of the capacity fares before, during and after fifteen seconds of three times the capacity in batch requests."""
    process, command = started(settings, [])
    asked = [settings.program, "--json", "load", "--connect", UP, "--deadline-ms", "3000"]
    try:
        closed = subprocess.run([*asked, "--clients", "8", "--requests", "150", "--warm-up", "16"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        rate = json.loads(closed.stdout)["achieved_per_s"]
        with tempfile.TemporaryDirectory() as folder:
            lines = pathlib.Path(folder, "steady.csv")
            words = ["--rate", f"{rate / 2:.2f}", "--requests", str(int(rate / 2 * 45)), "--csv", str(lines)]
            log_level = {**os.environ, "REPOSE_LOG": "warn,repose::commands::load=debug"}
            steady = subprocess.Popen([*asked, *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=log_level)
            # It says when its first request has ended: from then on its time runs.
            while "request ended" not in steady.stderr.readline():
                pass
            begin = time.monotonic()
            threading.Thread(target=steady.stderr.read, daemon=True).start()
            time.sleep(10)
            flood = [*asked, "--rate", f"{3 * rate:.2f}", "--requests", str(int(3 * rate * 15)), "--interactive", "0"]
            flooded_s = time.monotonic() - begin
            subprocess.run(flood, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            over_s = time.monotonic() - begin
            steady.wait()
            with open(lines, encoding="utf-8") as table:
                ended = [(float(row["due_s"]), float(row["took_ms"]), row["outcome"]) for row in csv.DictReader(table)]
            # Its own time began with its first request, ours when the first had ended.
            ours_s = min(due + took / 1e3 for due, took, _ in ended)
            flooded_s, over_s = flooded_s + ours_s, over_s + ours_s
    finally:
        process.terminate()
        process.wait()

    def between(first_s, last_s):
        took = sorted(took for due, took, outcome in ended if first_s <= due < last_s and outcome in ("result", "none"))
        asked_then = sum(first_s <= due < last_s for due, _, _ in ended)
        return {"answered": len(took), "of": asked_then, "p50_ms": took[len(took) // 2] if took else None, "most_ms": took[-1] if took else None}

    document = {
        "group": "recovery", "command": command, "commit": settings.commit, "load_before": os.getloadavg()[0], "cores": os.cpu_count(),
        "capacity_per_s": rate, "flood_s": [flooded_s, over_s], "before": between(0, flooded_s), "during": between(flooded_s, over_s),
        "first_second_after": between(over_s, over_s + 1), "second_after": between(over_s + 1, over_s + 2), "rest": between(over_s + 2, 1e9),
    }
    with open(settings.out, "a", encoding="utf-8") as out:
        out.write(json.dumps(document) + "\n")
    print(json.dumps(document), flush=True)


def faults(settings):
    """Trouble while it is asked, each for the given minutes."""
    rate = 4
    asked = ["--planners", 2, "--inference", 2, "--rate", rate, "--requests", int(rate * 60 * settings.minutes), "--deadline-ms", 10000]
    for fault in ("kill:planner:5s", "kill:inference:5s", "stop:inference:10s:2s", "router:20s:1s", "delay:80ms"):
        run(settings, "faults", fault, [*asked, "--fault", fault])
    run(settings, "faults", "one of 2 routers:20s:1s", [*asked, "--routers", 2, "--fault", "router:20s:1s"])


def soak(settings):
    """Encrypted, with workers and the router killed all the while: memory and descriptors stay, and nothing aborts."""
    rate = 2
    asked = ["--planners", 2, "--inference", 2, "--rate", rate, "--requests", int(rate * 60 * settings.minutes), "--deadline-ms", 10000]
    kills = ["--fault", "kill:planner:40s", "--fault", "kill:inference:40s", "--fault", "router:120s:1s"]
    run(settings, "soak", f"{settings.minutes} minutes, QUIC", [*asked, "--secured", *kills])


GROUPS = {
    "capacity": capacity, "cells": cells, "gateways": gateways, "idle": idle, "light": light, "light2": light2, "networks": networks, "overload": overload, "recovery": recovery, "faults": faults,
    "soak": soak,
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("groups", nargs="*", choices=[*GROUPS, []], help="which runs; all by default")
    parser.add_argument("--program", default="target/release/repose", help="the program")
    parser.add_argument("--commit", default="", help="what it was built from")
    parser.add_argument("--requests", type=int, default=400, help="requests of a run of capacity")
    parser.add_argument("--light-cells", type=int, nargs="+", default=[1, 10, 50, 200], help="light cells of a run of light")
    parser.add_argument("--trials", nargs="+", default=["delay", "narrow", "execute", "cut", "clocks"], help="trials of networks")
    parser.add_argument("--brief", action="store_true", help="fewer cases of each trial")
    parser.add_argument("--minutes", type=float, default=10.0, help="length of a run with faults, and of the soak")
    parser.add_argument("--only", default="", metavar="TEXT", help="of capacity, cells and faults, the runs whose name has this in it")
    parser.add_argument("--out", default=pathlib.Path(__file__).parent / "runs.jsonl", help="where documents are appended")
    settings = parser.parse_args()
    if settings.only and "overload" in (settings.groups or GROUPS):
        parser.error("--only: the runs of overload belong together")
    for group in settings.groups or GROUPS:
        GROUPS[group](settings)


if __name__ == "__main__":
    main()
