"""What is asked in a scene: which object, which goal. Fixed before the first trial; what is excluded is counted.

An object may be asked for when the hand can span it as it lies and gets over it; a goal when it does not hold yet and some free place
within reach would make it true.
"""

import math
from dataclasses import dataclass

import numpy as np

from . import relations, scenes
from .objects import GRIP_MAX_M

# Fewest pixels of what is moved and of what the goal names.
PIXELS_MIN = 300
GRID_M = 0.03
# Where a place may be: the hand's straight reach over it, seen from above.
REACH_M = (0.32, 0.70)


@dataclass
class Problem:
    """An object, by its place in the scene from 0, and a goal for it."""

    query: int
    relation: str
    anchor: int

    @property
    def goal(self):
        return f"{self.relation}:{self.anchor + 1}"


def extents(world, index, pose, yaw_rad):
    shape = world.placed[index].shape
    return relations.Extents(shape.low_m, shape.high_m, pose, yaw_rad)


def chosen(world, rng):
    """A problem and nothing, or nothing and why there is none."""
    _, _, labels = world.picture()
    pixels = np.bincount(labels.ravel(), minlength=len(world.objects) + 1)[1:]
    seen = [k for k in range(len(world.objects)) if pixels[k] >= PIXELS_MIN]
    spanned = [k for k in seen if world.placed[k].shape.width_m <= GRIP_MAX_M]
    if not spanned:
        return None, "no object that the hand can span is seen"
    over = [k for k in spanned if _hand_over(world, k)]
    if not over:
        return None, "the hand gets over no object that it can span"
    yaw_rad = relations.view_yaw_rad(world.furniture.camera.world_from_camera)
    candidates = [(k, relation, j) for k in over for j in seen if j != k for relation in relations.DIRECTIONS]
    for choice in rng.permutation(len(candidates)):
        query, relation, anchor = candidates[choice]
        problem = Problem(query, relation, anchor)
        if not is_true(world, problem, yaw_rad) and _has_place(world, problem, yaw_rad):
            return problem, None
    return None, "no goal that does not hold has a free place within reach"


def is_true(world, problem, yaw_rad):
    """Whether the goal holds where things are."""
    query, anchor = (extents(world, k, world.pose(k), yaw_rad) for k in (problem.query, problem.anchor))
    return relations.holds(problem.relation, query, anchor)


def _hand_over(world, index):
    pose, shape = world.start[index], world.placed[index].shape
    return _reaches(world, pose[0, 3], pose[1, 3], pose[2, 3] + shape.high_m[2], world.placed[index].yaw_rad)


def _reaches(world, x, y, top_m, yaw_rad):
    """Whether the hand gets to the top of a thing and 10 cm above it, at one of two turns."""
    if not REACH_M[0] <= math.hypot(x, y) <= REACH_M[1]:
        return False
    turns = (yaw_rad % math.pi, yaw_rad % math.pi + math.pi / 2)
    return any(all(world.robot.reaches((x, y, top_m + up), turn) for up in (-0.01, 0.10)) for turn in turns)


def _has_place(world, problem, yaw_rad):
    """Whether the object, only moved and not turned, would stand free within reach at some place of a grid with the goal true."""
    placed, start = world.placed[problem.query], world.start[problem.query]
    others = [p for k, p in enumerate(world.placed) if k != problem.query]
    anchor = extents(world, problem.anchor, world.start[problem.anchor], yaw_rad)
    for surface in world.furniture.surfaces:
        for x in np.arange(surface.low_m[0], surface.high_m[0], GRID_M):
            for y in np.arange(surface.low_m[1], surface.high_m[1], GRID_M):
                if not REACH_M[0] <= math.hypot(x, y) <= REACH_M[1]:
                    continue
                pose = start.copy()
                pose[:3, 3] = (x, y, surface.height_m - placed.shape.low_m[2])
                if not relations.holds(problem.relation, extents(world, problem.query, pose, yaw_rad), anchor):
                    continue
                rectangle = scenes.outline(placed.shape, x, y, placed.yaw_rad)
                if not scenes.stands_free(rectangle, placed.shape, surface, world.furniture, others):
                    continue
                if _reaches(world, x, y, pose[2, 3] + placed.shape.high_m[2], placed.yaw_rad):
                    return True
    return False
