"""What stands in the cell: furniture of a kind, and objects on it, all drawn from a seed.

Everything that decides how hard the world is stands here and was fixed before the first trial: friction, masses, gaps, heights.
"""

import math
from dataclasses import dataclass

import numpy as np
import pybullet

from .camera import Camera

KINDS = ("table", "box", "shelf")
# Lateral friction; Bullet multiplies that of both bodies, and the pads of its Panda have 1.
OBJECT_FRICTION = (0.45, 0.8)
FURNITURE_FRICTION = 0.9
# Objects among which one is moved.
COUNT = (4, 6)
# Least gap between the outlines of two objects: a finger is 2.2 cm thick.
GAP_M = 0.025
# Where objects are put, seen from above: a ring around the base, and a box.
REACH_M = (0.34, 0.68)
WORKSPACE_M = ((0.33, -0.34), (0.66, 0.34))
DROP_M = 0.02
# What has stood after a drop: upright, and where it was.
STOOD_RAD, STOOD_M = math.radians(5), 0.02
FLOOR_M = -0.7


@dataclass
class Surface:
    """A level rectangle that things can stand on."""

    height_m: float
    low_m: tuple
    high_m: tuple

    def holds(self, x, y, margin_m):
        inside = (low + margin_m <= v <= high - margin_m for low, v, high in zip(self.low_m, (x, y), self.high_m))
        return all(inside)


class Furniture:
    """The boxes that a kind of scene is made of, and the surfaces on them."""

    def __init__(self, kind, rng):
        self.boxes, self.surfaces = [], []
        u = rng.uniform
        table_m = u(-0.12, 0.12)
        self._add((0.27, -0.55), (1.0, 0.55), table_m - 0.04, table_m)
        side = rng.choice([-1, 1])
        angle, distance, raised = u(-0.9, 0.9), u(0.75, 0.95), u(0.55, 0.8)
        target = (0.5, 0.0, table_m + 0.05)
        if kind == "box":
            size, at = (u(0.20, 0.28), u(0.26, 0.38), u(0.10, 0.22)), (u(0.47, 0.56), side * u(0.06, 0.16))
            low, high = [a - s / 2 for a, s in zip(at, size)], [a + s / 2 for a, s in zip(at, size)]
            self._add(low, high, table_m, table_m + size[2])
        if kind == "shelf":
            self._shelf(rng, table_m)
            # The shelf is open towards the robot: the camera looks over its shoulder.
            angle, distance, raised, target = math.pi - side * u(0.55, 0.8), u(0.8, 0.95), u(0.5, 0.65), (0.55, 0.0, table_m + 0.15)
        place = (target[0] + distance * math.cos(angle), target[1] + distance * math.sin(angle), target[2] + raised)
        self.camera = Camera(place, target)
        self.table_m = table_m

    def _add(self, low, high, bottom_m, top_m):
        self.boxes.append(((*low, bottom_m), (*high, top_m)))
        self.surfaces.append(Surface(top_m, tuple(low), tuple(high)))

    def _shelf(self, rng, table_m):
        """Two boards between two sides and a back."""
        u = rng.uniform
        front, depth, half, board = u(0.50, 0.54), 0.26, u(0.28, 0.34), 0.018
        low = table_m + u(0.03, 0.06)
        high = low + u(0.30, 0.36)
        for top in (low, high):
            self._add((front, -half), (front + depth, half), top - board, top)
        for y in (-half - board, half):
            self.boxes.append(((front, y, table_m), (front + depth, y + board, high)))
        self.boxes.append(((front + depth, -half, table_m), (front + depth + board, half, high)))


def add_box(client, low, high, color):
    """A fixed box between two corners; its body id."""
    half = [(b - a) / 2 for a, b in zip(low, high)]
    middle = [(a + b) / 2 for a, b in zip(low, high)]
    collision = client.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half)
    visual = client.createVisualShape(pybullet.GEOM_BOX, halfExtents=half, rgbaColor=[*color, 1])
    body = client.createMultiBody(0, collision, visual, middle)
    client.changeDynamics(body, -1, lateralFriction=FURNITURE_FRICTION)
    return body


def add_object(client, meshes, shape, place_m, yaw_rad, friction, color):
    """A free object as its shape lies, turned about z; its body id."""
    parts, mesh = meshes.files(shape)
    collision = client.createCollisionShape(pybullet.GEOM_MESH, fileName=parts)
    visual = client.createVisualShape(pybullet.GEOM_MESH, fileName=mesh, rgbaColor=[*color, 1])
    turn = client.getQuaternionFromEuler([0, 0, yaw_rad])
    body = client.createMultiBody(shape.mass_kg, collision, visual, place_m, turn)
    client.changeDynamics(
        body,
        -1,
        lateralFriction=friction,
        spinningFriction=0.001,
        rollingFriction=0.0002,
        restitution=0.0,
        linearDamping=0,
        angularDamping=0.02,
    )
    return body


def pose_of(client, body):
    """`world_from_object`, 4×4."""
    place, turn = client.getBasePositionAndOrientation(body)
    pose = np.eye(4)
    pose[:3, :3] = np.reshape(client.getMatrixFromQuaternion(turn), (3, 3))
    pose[:3, 3] = place
    return pose


def tilt_rad(pose):
    """How far an object's own z is from up."""
    return math.acos(min(1.0, max(-1.0, pose[2, 2])))


def settle(client, bodies, longest_s, step_s):
    """Steps until all bodies rest; whether they do."""
    calm = 0
    for _ in range(int(longest_s / step_s)):
        client.stepSimulation()
        calm = calm + 1 if all(_rests(client, body) for body in bodies) else 0
        if calm * step_s >= 0.1:
            return True
    return False


def _rests(client, body):
    linear, angular = client.getBaseVelocity(body)
    return math.hypot(*linear) < 0.004 and math.hypot(*angular) < 0.08


def stands_after_a_drop(client, meshes, shape, step_s):
    """Whether an object stands where it is dropped from 2 cm: a scan whose foot or centre of mass is unsound does not."""
    table = add_box(client, (-0.5, -0.5, -0.04), (0.5, 0.5, 0.0), (0.6, 0.6, 0.6))
    body = add_object(client, meshes, shape, (0, 0, DROP_M - shape.low_m[2]), 0.3, 0.6, (1, 1, 1))
    rests = settle(client, [body], 4.0, step_s)
    pose = pose_of(client, body)
    client.removeBody(body)
    client.removeBody(table)
    return rests and tilt_rad(pose) < STOOD_RAD and math.hypot(pose[0, 3], pose[1, 3]) < STOOD_M


def outline(shape, x, y, yaw_rad):
    """The rectangle around an object seen from above: its middle, its half sides, its turn."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    middle = (shape.low_m + shape.high_m)[:2] / 2
    return (x + c * middle[0] - s * middle[1], y + s * middle[0] + c * middle[1]), shape.extent_m[:2] / 2, yaw_rad


def gap_m(a, b):
    """A lower bound of the gap between two rectangles: along the best of their four axes."""
    best = -math.inf
    for turn in (a[2], a[2] + math.pi / 2, b[2], b[2] + math.pi / 2):
        axis = np.array([math.cos(turn), math.sin(turn)])
        apart = abs(axis @ (np.array(a[0]) - np.array(b[0])))
        best = max(best, apart - _half_along(a, turn) - _half_along(b, turn))
    return best


def _half_along(rectangle, turn):
    c, s = abs(math.cos(turn - rectangle[2])), abs(math.sin(turn - rectangle[2]))
    return c * rectangle[1][0] + s * rectangle[1][1]


@dataclass
class Placed:
    """An object of a scene."""

    shape: object
    surface: Surface
    x: float
    y: float
    yaw_rad: float
    friction: float
    color: tuple


def drawn(kind, shapes, furniture, rng):
    """Objects on the furniture with gaps between them; fewer than wanted where there is no room."""
    placed = []
    wanted = int(rng.integers(COUNT[0], COUNT[1] + 1))
    (x_low, y_low), (x_high, y_high) = WORKSPACE_M
    for _ in range(400):
        if len(placed) == wanted:
            break
        shape = shapes[int(rng.integers(len(shapes)))]
        # A scan is there once.
        if any(p.shape is shape for p in placed):
            continue
        surface = furniture.surfaces[int(rng.integers(len(furniture.surfaces)))]
        x, y, yaw = rng.uniform(x_low, x_high), rng.uniform(y_low, y_high), rng.uniform(-math.pi, math.pi)
        if not REACH_M[0] <= math.hypot(x, y) <= REACH_M[1]:
            continue
        if not stands_free(outline(shape, x, y, yaw), shape, surface, furniture, placed):
            continue
        color = tuple(rng.uniform(0.15, 0.95, 3))
        placed.append(Placed(shape, surface, x, y, yaw, rng.uniform(*OBJECT_FRICTION), color))
    return placed


def stands_free(rectangle, shape, surface, furniture, placed):
    """Whether an object of that outline stands wholly on a surface, with the gap to all others and to what rises from it."""
    reach = math.hypot(*rectangle[1])
    if not surface.holds(*rectangle[0], reach * 0.85):
        return False
    foot, top = surface.height_m + 0.001, surface.height_m + shape.extent_m[2] + 0.02
    for low, high in furniture.boxes:
        if low[2] < top and high[2] > foot:
            middle = ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2)
            half = np.array([(high[0] - low[0]) / 2, (high[1] - low[1]) / 2])
            if gap_m(rectangle, (middle, half, 0.0)) < GAP_M:
                return False
    return all(gap_m(rectangle, outline(p.shape, p.x, p.y, p.yaw_rad)) >= GAP_M for p in placed)
