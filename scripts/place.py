#!/usr/bin/env python3
"""Asks a running Repose for a placement: `pip install ./services/python`, then
`scripts/place.py --move 2 --goal left_of:3 --goal not:near:4` or `scripts/place.py --say "put the red mug left of the box"`.

Prints the result as JSON; exits 0 with a placement, 3 without one, 2 on bad input, 1 on anything else.
"""

import argparse
import sys

import repose

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--connect", help="a router of the deployment (tcp/127.0.0.1:7447)")
parser.add_argument("--config", metavar="FILE", help="a configuration file: cell, TLS, user and password")
parser.add_argument("--move", type=int, help="the object to move")
parser.add_argument("--goal", action="append", help="RELATION:ANCHOR or not:RELATION:ANCHOR")
parser.add_argument("--say", metavar="SENTENCE", help="both in words")
args = parser.parse_args()

try:
    with repose.connect(args.connect, config=args.config) as client:
        plan = client.place(move=args.move, goal=args.goal, say=args.say)
except repose.ReposeError as error:
    print(f"{error.code}: {error}", file=sys.stderr)
    sys.exit(2 if error.code in ("invalid_argument", "not_found", "failed_precondition") else 1)
print(plan.json)
sys.exit(0 if plan else 3)
