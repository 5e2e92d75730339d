"""Objects of the cell: scans from a folder, and shapes made here.

A shape's frame is its centre of mass with the axes that it was made in; z points up as it lies. Bodies are compounds of convex parts.
"""

import math
import os
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.spatial import ConvexHull

GRIP_MAX_M = 0.075
SIDES = 24
# A scan whose hull has less than this times the volume of its convex parts is taken for its hull.
CONVEX = 1.08


@dataclass
class Shape:
    """A rigid object."""

    name: str
    mass_kg: float
    # Each part convex: its vertices, metres.
    parts: list
    # What is drawn: vertices and triangles.
    vertices: np.ndarray
    triangles: np.ndarray
    low_m: np.ndarray = field(init=False)
    high_m: np.ndarray = field(init=False)

    def __post_init__(self):
        center = _center_of_mass(self.vertices, self.triangles)
        self.vertices = self.vertices - center
        self.parts = [part - center for part in self.parts]
        self.low_m, self.high_m = self.vertices.min(0), self.vertices.max(0)

    @property
    def extent_m(self):
        return self.high_m - self.low_m

    def surface(self, count=4000):
        """Points spread evenly over the surface, the same in every call."""
        rng = np.random.default_rng(1)
        a, b, c = (self.vertices[self.triangles[:, k]] for k in range(3))
        areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        chosen = rng.choice(len(areas), count, p=areas / areas.sum())
        u, v = np.sqrt(rng.random(count)), rng.random(count)
        return ((1 - u)[:, None] * a[chosen]) + (u * (1 - v))[:, None] * b[chosen] + (u * v)[:, None] * c[chosen]

    @property
    def width_m(self):
        """The narrowest width of its outline seen from above: what the fingers have to span."""
        outline = self.vertices[:, :2]
        turns = np.linspace(0, math.pi, 90, endpoint=False)
        along = outline @ np.stack([np.cos(turns), np.sin(turns)])
        return float((along.max(0) - along.min(0)).min())


def _center_of_mass(vertices, triangles):
    """That of the solid within a surface; the middle of the box around it where the surface is not closed enough to tell."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    middle = (vertices.min(0) + vertices.max(0)) / 2
    volume = volumes.sum()
    if abs(volume) < 1e-9:
        return middle
    center = (volumes[:, None] * (a + b + c) / 4).sum(0) / volume
    inside = np.all(center > vertices.min(0)) and np.all(center < vertices.max(0))
    return center if inside else middle


def scans(folder):
    """The scans of a folder: in each of its folders `mesh.obj`, `convex_parts.stl`, and `model.urdf`, which gives the mass."""
    found = []
    for name in sorted(os.listdir(folder)):
        mesh = os.path.join(folder, name, "mesh.obj")
        if os.path.exists(mesh):
            vertices, triangles = _read_obj(mesh)
            parts = _as_hull(vertices, _read_parts(os.path.join(folder, name, "convex_parts.stl")))
            urdf = ElementTree.parse(os.path.join(folder, name, "model.urdf"))
            mass_kg = float(urdf.find(".//inertial/mass").get("value"))
            found.append(Shape(name, mass_kg, parts, vertices, triangles))
    if not found:
        raise FileNotFoundError(f"{folder}: no folder with a mesh.obj in it")
    return found


def _read_obj(path):
    vertices, triangles = [], []
    with open(path, encoding="utf-8") as lines:
        for line in lines:
            if line.startswith("v "):
                vertices.append([float(v) for v in line.split()[1:4]])
            elif line.startswith("f "):
                triangles.append([int(v.split("/")[0]) - 1 for v in line.split()[1:4]])
    return np.array(vertices), np.array(triangles)


def _read_parts(path):
    """The vertices of each part of a binary STL: closed surfaces one after the other. Neighbours share vertices: only the order tells."""
    data = np.fromfile(path, dtype=np.uint8)[84:].reshape(-1, 50)
    corners = np.ascontiguousarray(data[:, 12:48]).view("<f4").reshape(-1, 3).astype(float)
    places, index = np.unique(corners.round(6), axis=0, return_inverse=True)
    parts, open_edges, members = [], set(), set()
    for a, b, c in index.reshape(-1, 3).tolist():
        members |= {a, b, c}
        for edge in ((a, b), (b, c), (c, a)):
            if edge[::-1] in open_edges:
                open_edges.remove(edge[::-1])
            else:
                open_edges.add(edge)
        if not open_edges:
            parts.append(places[sorted(members)])
            members = set()
    if members:
        parts.append(places[sorted(members)])
    return parts


def _as_hull(vertices, parts):
    """One convex part in place of many where the scan is all but convex: its foot is flat then, and contacts are few."""
    whole = ConvexHull(vertices)
    if whole.volume > CONVEX * sum(ConvexHull(part).volume for part in parts):
        return parts
    return [vertices[whole.vertices]]


def _box(size, at=(0.0, 0.0, 0.0)):
    half = np.array(size) / 2
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))]
    return signs * half + np.array(at), np.array(triangles)


def _lathe(profile):
    """The solid of a profile of (radius, height) turned about z, and a convex part for every stretch of it."""
    turns = np.arange(SIDES) * 2 * math.pi / SIDES
    circle = np.stack([np.cos(turns), np.sin(turns)], 1)
    rings = [np.column_stack([circle * radius, np.full(SIDES, height)]) for radius, height in profile]
    vertices = np.vstack([*rings, [[0, 0, profile[0][1]], [0, 0, profile[-1][1]]]])
    bottom, top, last = len(vertices) - 2, len(vertices) - 1, (len(rings) - 1) * SIDES
    triangles = []
    for i in range(SIDES):
        k = (i + 1) % SIDES
        triangles += [(bottom, k, i), (top, last + i, last + k)]
        for ring in range(0, last, SIDES):
            triangles += [(ring + i, ring + k, ring + SIDES + k), (ring + i, ring + SIDES + k, ring + SIDES + i)]
    return vertices, np.array(triangles), [np.vstack(pair) for pair in pairwise(rings)]


def _joined(solids):
    vertices = np.vstack([v for v, _ in solids])
    starts = np.cumsum([0] + [len(v) for v, _ in solids])
    return vertices, np.vstack([t + start for (_, t), start in zip(solids, starts)])


def generated(rng):
    """A shape drawn at random: box, bar, can, bottle, or two boxes that make an L."""
    kind = rng.choice(["box", "bar", "can", "bottle", "ell"], p=[0.3, 0.15, 0.2, 0.25, 0.1])
    density = rng.uniform(250, 700)
    u = rng.uniform
    if kind in ("box", "bar"):
        size = (u(0.03, 0.07), u(0.05, 0.11), u(0.05, 0.19)) if kind == "box" else (u(0.02, 0.045), u(0.10, 0.18), u(0.025, 0.06))
        vertices, triangles = _box(size)
        parts, volume = [vertices], float(np.prod(size))
    elif kind == "ell":
        foot, high = (u(0.035, 0.06), u(0.07, 0.11), u(0.03, 0.05)), u(0.05, 0.10)
        back = (foot[0], u(0.03, 0.045), high)
        solids = [_box(foot), _box(back, (0, (foot[1] - back[1]) / 2, (foot[2] + high) / 2))]
        vertices, triangles = _joined(solids)
        parts, volume = [v for v, _ in solids], float(np.prod(foot) + np.prod(back))
    elif kind == "can":
        radius, height = u(0.02, 0.036), u(0.06, 0.16)
        vertices, triangles, parts = _lathe([(radius, 0), (radius, height)])
        volume = math.pi * radius**2 * height
    else:
        radius, body, shoulder = u(0.024, 0.036), u(0.08, 0.13), u(0.015, 0.035)
        neck, cap = u(0.011, 0.015), u(0.025, 0.045)
        profile = [(radius, 0), (radius, body), (neck, body + shoulder), (neck, body + shoulder + cap)]
        vertices, triangles, parts = _lathe(profile)
        volume = math.pi * (radius**2 * body + (radius**2 + neck**2) / 2 * shoulder + neck**2 * cap)
    mass_kg = float(np.clip(density * volume, 0.04, 0.7))
    return Shape(str(kind), mass_kg, parts, vertices, triangles)


class Meshes:
    """Writes shapes where PyBullet can read them: a file of convex parts, and one to draw."""

    def __init__(self, folder):
        self.folder, self.count, self.known = folder, 0, {}

    def files(self, shape):
        if id(shape) not in self.known:
            self.count += 1
            stem = os.path.join(self.folder, f"{self.count:04}")
            with open(f"{stem}-parts.obj", "w", encoding="ascii") as out:
                start = 1
                for k, part in enumerate(shape.parts):
                    # Bullet takes each object's hull; a fan names all of its vertices.
                    fan = np.array([(0, i, i + 1) for i in range(1, len(part) - 1)])
                    _write(out, f"part{k}", part, fan + start)
                    start += len(part)
            with open(f"{stem}.obj", "w", encoding="ascii") as out:
                _write(out, "mesh", shape.vertices, shape.triangles + 1)
            self.known[id(shape)] = (shape, f"{stem}-parts.obj", f"{stem}.obj")
        return self.known[id(shape)][1:]


def _write(out, name, vertices, triangles):
    out.write(f"o {name}\n")
    np.savetxt(out, vertices, "v %.6f %.6f %.6f")
    np.savetxt(out, triangles, "f %d %d %d")
