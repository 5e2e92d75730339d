#!/usr/bin/env python3
"""Access control as a client that is not ours sees it: plain eclipse-zenoh, with the files that `repose deploy` wrote.

    python3 -m venv out/venv && out/venv/bin/pip install eclipse-zenoh==1.10.2
    repose deploy roles.toml --out DIR && repose serve router --config DIR/router/router.toml &
    out/venv/bin/python tests/deployment/independent_client.py DIR

The roles file must have the users display (viewer), asker (planner), anna (operator), arm (driver of panda and wrist) and motion (service) in the
cell lab. Exits 0 when every user may do what its role says and nothing else.
"""

import sys
import threading
import time
from pathlib import Path

import zenoh

PREFIX = "repose/v1/lab"
# user, verb, key, whether it is allowed; `by` is who listens, serves or puts at the other end.
CASES = [
    ("arm", "put", "robot/panda/state", "display", True),
    ("arm", "put", "robot/other/state", "display", False),
    ("display", "put", "robot/panda/state", "asker", False),
    ("display", "put", "robot/panda/@estop", "arm", True),
    ("asker", "put", "robot/panda/command", "arm", False),
    ("motion", "put", "robot/panda/command", "arm", True),
    ("asker", "query", "service/motion/m/call", "motion", True),
    ("asker", "query", "service/motion/m/operate", "motion", False),
    ("anna", "query", "service/motion/m/operate", "motion", True),
    ("display", "query", "service/motion/m/call", "motion", False),
]


def allowed(tries, other, verb, key):
    """Whether what one session tries reaches the other, tried for two seconds."""
    key = f"{PREFIX}/{key}"
    came = threading.Event()
    if verb == "put":
        held = other.declare_subscriber(key, lambda _: came.set())
        attempt = lambda: tries.put(key, b"x")
    else:
        held = other.declare_queryable(key, lambda query: query.reply(query.key_expr, b"x"))
        attempt = lambda: [came.set() for reply in tries.get(key, timeout=0.3) if reply.ok]
    give_up = time.monotonic() + 2
    while not came.is_set() and time.monotonic() < give_up:
        attempt()
        came.wait(0.05)
    held.undeclare()
    return came.is_set()


def main():
    users = Path(sys.argv[1]) / "users"
    names = {name for case in CASES for name in (case[0], case[3])}
    sessions = {name: zenoh.open(zenoh.Config.from_file(str(users / name / "zenoh.json5"))) for name in sorted(names)}
    wrong = 0
    for user, verb, key, by, expected in CASES:
        if allowed(sessions[user], sessions[by], verb, key) != expected:
            wrong += 1
            print(f"WRONG: {user} {verb} {key}: expected {'allowed' if expected else 'denied'}")
    for session in sessions.values():
        session.close()
    print(f"{len(CASES)} tried, {wrong} wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
