#!/usr/bin/env python3
"""Grasps from elsewhere as Repose takes them: 4×4 poses of a grasp network in, the grasps of a motion request out.

`scripts/graspnet.py grasps.json --frame FRAME > ours.json`, then `repose plan FRAME --move 2 --goal left_of:3 --motion plan.json --grasps ours.json`;
the same list goes into `grasps` of a `MotionPlanRequest` and of the Python client's `plan_motion`. Needs numpy; the format is in
`services/motion/README.md`. Exits 0, or 2 on bad input.
"""

import argparse
import json
import os
import sys

import numpy as np

# From the Panda's hand to the point between its fingertips, and from there to their very ends, metres.
HAND_TO_TCP_M, TCP_TO_TIP_M = 0.1034, 0.009
OPENING_MAX_M = 0.08
COUNT_MAX = 256
# Further from a rotation than this is a mistake, nearer is rounding.
ROUNDING = 1e-3

# The axes of ours (x, y the closing direction, z the approach) in those of a convention, as columns.
CONVENTIONS = {
    # Contact-GraspNet and 6-DOF GraspNet: the Panda's hand, x the closing direction, z the approach.
    "hand": np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    # GraspNet-1Billion: x the approach, y the closing direction; the fingers end `depth_m` ahead of the origin.
    "graspnet": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    # Ours: nothing to convert.
    "tcp": np.eye(3),
}


class BadGrasps(ValueError):
    """A file that cannot be used; says which field."""


def converted(document, world_from_camera=None):
    """The grasps of a document, best first: dictionaries of `world_from_tcp` (16 numbers, row by row), `width_m` and `score`."""
    if not isinstance(document, dict):
        raise BadGrasps("expected an object with convention, frame and grasps; a list of grasps is Repose's own already")
    convention, frame = document.get("convention"), document.get("frame")
    if convention not in CONVENTIONS:
        raise BadGrasps(f"convention: expected one of {', '.join(CONVENTIONS)}, got {convention!r}")
    if frame not in ("camera", "world"):
        raise BadGrasps(f"frame: expected camera or world, got {frame!r}")
    if frame == "camera" and world_from_camera is None:
        raise BadGrasps("frame: grasps in the camera's frame need its pose (--frame)")
    given = document.get("grasps")
    if not isinstance(given, list) or not given:
        raise BadGrasps("grasps: expected a list of one or more")
    world_from_frame = np.eye(4) if frame == "world" else world_from_camera
    grasps = [_grasp(f"grasps[{i}]", grasp, convention, world_from_frame) for i, grasp in enumerate(given)]
    grasps.sort(key=lambda grasp: -grasp["score"])
    return grasps[:COUNT_MAX]


def _grasp(field, grasp, convention, world_from_frame):
    if not isinstance(grasp, dict):
        raise BadGrasps(f"{field}: expected an object")
    pose = _pose(f"{field}.pose", grasp.get("pose"))
    width_m = _number(f"{field}.width_m", grasp.get("width_m", OPENING_MAX_M), 0.0)
    ahead_m = {
        "hand": lambda: HAND_TO_TCP_M,
        "graspnet": lambda: _number(f"{field}.depth_m", grasp.get("depth_m"), 0.0) - TCP_TO_TIP_M,
        "tcp": lambda: 0.0,
    }[convention]()
    frame_from_tcp = np.eye(4)
    frame_from_tcp[:3, :3] = pose[:3, :3] @ CONVENTIONS[convention]
    frame_from_tcp[:3, 3] = pose[:3, 3] + ahead_m * frame_from_tcp[:3, 2]
    world_from_tcp = world_from_frame @ frame_from_tcp
    score = _number(f"{field}.score", grasp.get("score"))
    return {"world_from_tcp": world_from_tcp.ravel().tolist(), "width_m": min(width_m, OPENING_MAX_M), "score": score}


def _pose(field, rows):
    """A rigid transform: rotations of networks are rounded, so the nearest one is taken."""
    try:
        pose = np.array(rows, float)
    except (TypeError, ValueError):
        pose = np.zeros(0)
    if pose.shape != (4, 4) or not np.isfinite(pose).all() or not np.allclose(pose[3], [0, 0, 0, 1]):
        raise BadGrasps(f"{field}: expected four rows of four numbers, the last one 0 0 0 1")
    u, _, v = np.linalg.svd(pose[:3, :3])
    rotation = u @ v
    if np.abs(rotation - pose[:3, :3]).max() > ROUNDING or np.linalg.det(rotation) < 0:
        raise BadGrasps(f"{field}: its upper left part is no rotation")
    pose[:3, :3] = rotation
    return pose


def _number(field, value, least=-np.inf):
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value) or value < least:
        raise BadGrasps(f"{field}: expected a number{'' if least == -np.inf else f' of {least:g} or more'}, got {value!r}")
    return float(value)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("grasps", help="the network's grasps, JSON")
    parser.add_argument("--frame", metavar="FOLDER", help="the frame folder that they are of: its camera.json has the camera's pose")
    args = parser.parse_args()
    try:
        with open(args.grasps, encoding="utf-8") as file:
            document = json.load(file)
        world_from_camera = None
        if args.frame:
            with open(os.path.join(args.frame, "camera.json"), encoding="utf-8") as file:
                world_from_camera = np.reshape(json.load(file)["world_from_camera"], (4, 4))
        print(json.dumps(converted(document, world_from_camera)))
    except (OSError, ValueError, KeyError, TypeError) as error:
        print(f"graspnet.py: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
