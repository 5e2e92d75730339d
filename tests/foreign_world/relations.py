"""Which relations hold between bodies whose boxes are known: the paper's appendix, written down once more, for judging.

Boxes are of the eight corners of an object's own box, in the viewer's axes: x right, y away, z up.
"""

import math

import numpy as np

DIRECTIONS = ("left_of", "right_of", "in_front_of", "behind")


class Extents:
    """What an object spans in the viewer's axes."""

    def __init__(self, low_m, high_m, world_from_object, view_yaw_rad):
        corners = np.array([[x, y, z] for x in (low_m[0], high_m[0]) for y in (low_m[1], high_m[1]) for z in (low_m[2], high_m[2])])
        world = corners @ world_from_object[:3, :3].T + world_from_object[:3, 3]
        c, s = math.cos(view_yaw_rad), math.sin(view_yaw_rad)
        viewed = world @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]).T
        self.low, self.high, self.center = viewed.min(0), viewed.max(0), viewed.mean(0)


def view_yaw_rad(world_from_camera):
    """The turn of a viewer who looks where the camera does; 0 looks along y.

    The cameras here are not rolled: at any steepness the line of sight over the ground is then also what the picture shows as up."""
    forward = world_from_camera[:3, 2]
    return math.atan2(-forward[0], forward[1])


def holds(relation, query, anchor):
    """Whether a directional relation holds between two extents."""
    axis = 0 if relation in ("left_of", "right_of") else 1
    first, second = (query, anchor) if relation in ("left_of", "in_front_of") else (anchor, query)
    return bool(_toward_low(first, second, axis) > 0)


def _toward_low(i, j, axis):
    """Least slack of: centre in the trapezoid that opens from j's low side, beyond that side, wholly before j's centre."""
    past = j.low[axis] - i.center[axis]
    slack = [past, j.center[axis] - i.high[axis]]
    for side in ((axis + 1) % 3, (axis + 2) % 3):
        slack += [past + j.high[side] - i.center[side], past + i.center[side] - j.low[side]]
    return min(slack)
