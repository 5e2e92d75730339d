#!/usr/bin/env python3
"""A Zenoh gateway: a region of clients behind one session at a router, as `zenohd` would be with the same configuration.

    gateway.py ROUTER LISTEN        # tcp/127.0.0.1:7447 tcp/127.0.0.1:7500

Needs PyPI's eclipse-zenoh, of the version that Repose is built with (1.10.2). It ends with its standard input.
"""

import json
import sys

import zenoh


def main():
    router, listen = sys.argv[1:3]
    config = zenoh.Config()
    settings = {
        # A client of the router above it, and a router to those below.
        "mode": "client",
        "connect/endpoints": [router],
        "listen/endpoints": [listen],
        "gateway": {"south": [{"filters": [{"modes": ["client", "peer"]}]}]},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/unicast/max_sessions": 1000,
        "transport/unicast/accept_pending": 1000,
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config):
        print("up", flush=True)
        sys.stdin.read()


if __name__ == "__main__":
    main()
