"""Grasps as a network of somebody else's would offer them: antipodal pairs on the true surface, as poses of the hand in the camera's frame.

They stand in for such a network: nothing of Repose's own search for grasps is in them, and they know the object as it is.
"""

import math

import numpy as np

PAIRS, COUNT = 4000, 64
# From the hand's frame to the point between the fingertips, and how far the fingers reach beyond it, metres.
HAND_TO_TCP_M, TIP_M = 0.1034, 0.009
OPENING_M, ROOM_M = 0.08, 0.003
PAD_HALF_M, THICK_M, LENGTH_M = 0.0105, 0.022, 0.045
# The cosines from which two surfaces oppose each other, and from which an approach comes from above.
OPPOSED, FROM_ABOVE = math.cos(math.radians(20)), math.cos(math.radians(60))
TURNS_RAD = (0.0, 0.4, -0.4, 0.8, -0.8)
ABOVE_SUPPORT_M = 0.004


def offered(world, query, rng):
    """A document of grasps on an object, as `scripts/graspnet.py` reads it; without any where the hand gets round it nowhere."""
    points, normals = _surface(world, query, rng)
    rest = np.vstack([_surface(world, k, rng)[0] for k in range(len(world.objects)) if k != query] + [np.zeros((0, 3))])
    floor_m = points[:, 2].min() + TIP_M + ABOVE_SUPPORT_M
    middle = world.pose(query)[:3, 3]
    found = []
    for i in rng.integers(len(points), size=PAIRS):
        line = points - points[i]
        length = np.linalg.norm(line, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            along = line / length[:, None]
        opposed = (length > 0.005) & (length < OPENING_M - 2 * ROOM_M)
        opposed &= (along @ -normals[i] > OPPOSED) & (np.einsum("ij,ij->i", along, normals) > OPPOSED)
        for k in np.flatnonzero(opposed)[:1]:
            found += _around(points[i], points[k], points, rest, floor_m, middle)
        if len(found) >= COUNT:
            break
    camera_from_world = np.linalg.inv(world.furniture.camera.world_from_camera)
    grasps = [{"pose": (camera_from_world @ pose).tolist(), "width_m": OPENING_M, "score": score} for score, pose in found]
    return {"frame": "camera", "convention": "hand", "grasps": sorted(grasps, key=lambda grasp: -grasp["score"])}


def _surface(world, index, rng):
    """Points of an object's true surface and their outward normals, world frame."""
    shape, pose = world.placed[index].shape, world.pose(index)
    a, b, c = (shape.vertices[shape.triangles[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    areas = np.linalg.norm(cross, axis=1)
    chosen = rng.choice(len(areas), 4000, p=areas / areas.sum())
    u, v = np.sqrt(rng.random((4000, 1))), rng.random((4000, 1))
    points = (1 - u) * a[chosen] + u * (1 - v) * b[chosen] + u * v * c[chosen]
    normals = cross[chosen] / areas[chosen, None]
    return points @ pose[:3, :3].T + pose[:3, 3], normals @ pose[:3, :3].T


def _around(a, b, points, rest, floor_m, middle):
    """Poses of the hand that close on two places from above, where it has room; each with its score."""
    closing = (b - a) / np.linalg.norm(b - a)
    steepest = np.array([0, 0, -1.0]) + closing * closing[2]
    if np.linalg.norm(steepest) < 0.1:
        return []
    steepest /= np.linalg.norm(steepest)
    sideways = np.cross(closing, steepest)
    grasps = []
    for turn in TURNS_RAD:
        approach = math.cos(turn) * steepest + math.sin(turn) * sideways
        place = (a + b) / 2
        place[2] = max(place[2], floor_m)
        # The hand's axes: x the closing direction, z the approach.
        rotation = np.column_stack([closing, np.cross(approach, closing), approach])
        if -approach[2] < FROM_ABOVE or not _has_room(place, rotation, points, rest):
            continue
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, place - HAND_TO_TCP_M * approach
        aside_m = np.linalg.norm(np.cross(middle - place, approach))
        grasps.append((float(-approach[2] - aside_m / 0.1), pose))
    return grasps


def _has_room(place, rotation, points, rest):
    """Whether open fingers and the palm touch neither the object nor what stands around it."""
    for cloud in (points, rest):
        x, y, z = ((cloud - place) @ rotation).T
        beyond = np.abs(x) - OPENING_M / 2
        finger = (beyond > -ROOM_M) & (beyond < THICK_M) & (np.abs(y) < PAD_HALF_M) & (z > -LENGTH_M) & (z < TIP_M)
        palm = (z < -LENGTH_M + 0.012) & (z > -0.16) & (np.abs(x) < 0.105) & (np.abs(y) < 0.035)
        if finger.any() or palm.any():
            return False
    return True
