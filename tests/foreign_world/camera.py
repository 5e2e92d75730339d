"""A depth camera: what PyBullet draws, with the faults of a real one.

Depth has noise that grows with its square and comes in steps, edges lose readings, grazed surfaces and a few patches give none.
"""

import numpy as np
import pybullet

WIDTH, HEIGHT, FOCAL_PX = 640, 480, 525.0
# Where the renderer draws the middle of the picture: it takes its samples at the lower left corners of pixels.
CENTER_PX = (WIDTH / 2, HEIGHT / 2 - 1)
NEAR_M, FAR_M = 0.2, 4.0
DEPTH_UNIT_M = 0.001
# Standard deviation of depth: so much, and so much per square metre of it.
NOISE_M, NOISE_PER_M2 = 0.0006, 0.0014
# A step in depth to a neighbour that loses readings, and how often it does.
EDGE_M, EDGE_LOST = 0.012, 0.55
# The cosine to the line of sight below which a surface gives nothing.
GRAZED = 0.12
PATCHES = 6


class Camera:
    """A camera that stands at a place and looks at another."""

    def __init__(self, at_m, target_m):
        self.at_m, self.target_m = np.array(at_m, float), np.array(target_m, float)
        forward = self.target_m - self.at_m
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1])
        right /= np.linalg.norm(right)
        self.world_from_camera = np.eye(4)
        self.world_from_camera[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
        self.world_from_camera[:3, 3] = self.at_m

    def model(self):
        """The contract's camera."""
        return {
            "width": WIDTH,
            "height": HEIGHT,
            "fx": FOCAL_PX,
            "fy": FOCAL_PX,
            "cx": CENTER_PX[0],
            "cy": CENTER_PX[1],
            "depth_unit_m": DEPTH_UNIT_M,
            "world_from_camera": self.world_from_camera.ravel().tolist(),
        }

    def picture(self, client, scale=1):
        """Colour u8 [h, w, 3], true depth in metres [h, w] (infinite where nothing is), and body ids [h, w] (-1 where nothing is)."""
        width, height = WIDTH // scale, HEIGHT // scale
        view = pybullet.computeViewMatrix(self.at_m.tolist(), self.target_m.tolist(), [0, 0, 1])
        n, f = NEAR_M, FAR_M
        lens = (2 * FOCAL_PX / WIDTH, 2 * FOCAL_PX / HEIGHT, -(f + n) / (f - n), -2 * f * n / (f - n))
        projection = [lens[0], 0, 0, 0, 0, lens[1], 0, 0, 0, 0, lens[2], -1, 0, 0, lens[3], 0]
        drawn = client.getCameraImage(width, height, view, projection, shadow=0, renderer=pybullet.ER_TINY_RENDERER)
        color = np.reshape(drawn[2], (height, width, 4))[..., :3].astype(np.uint8)
        buffer = np.reshape(drawn[3], (height, width)).astype(float)
        bodies = np.reshape(drawn[4], (height, width)).astype(int)
        depth_m = f * n / (f - (f - n) * buffer)
        depth_m[bodies < 0] = np.inf
        return color, depth_m, bodies


def sensed(depth_m, rng):
    """Depth counts u16 [h, w] that the camera reports of true depth; 0 where it has no reading."""
    height, width = depth_m.shape
    seen = np.isfinite(depth_m)
    depth = np.where(seen, depth_m, 0.0)
    noisy = depth + rng.normal(0, 1, depth.shape) * (NOISE_M + NOISE_PER_M2 * depth**2)
    steps = np.zeros_like(depth)
    for axis in (0, 1):
        step = np.abs(np.diff(np.where(seen, depth_m, FAR_M), axis=axis))
        before = [(0, 1) if k == axis else (0, 0) for k in (0, 1)]
        after = [(1, 0) if k == axis else (0, 0) for k in (0, 1)]
        steps = np.maximum(steps, np.maximum(np.pad(step, before), np.pad(step, after)))
    lost = (steps > EDGE_M) & (rng.random(depth.shape) < EDGE_LOST)
    lost |= (_cosines(depth) < GRAZED) & (steps <= EDGE_M)
    rows, columns = np.mgrid[:height, :width]
    for _ in range(PATCHES):
        v, u, radius = rng.uniform(0, height), rng.uniform(0, width), rng.uniform(2, 7)
        lost |= (rows - v) ** 2 + (columns - u) ** 2 < radius**2
    noisy[lost | ~seen | (noisy > FAR_M)] = 0
    return np.clip(np.round(noisy / DEPTH_UNIT_M), 0, 65535).astype("<u2")


def _cosines(depth):
    """The cosine between each reading's surface and its line of sight; 1 where there is none to tell."""
    u = (np.arange(depth.shape[1]) - CENTER_PX[0]) / FOCAL_PX
    v = (np.arange(depth.shape[0]) - CENTER_PX[1]) / FOCAL_PX
    points = np.dstack([depth * u, depth * v[:, None], depth])
    along, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
    normal = np.cross(along, down)
    lengths = np.linalg.norm(normal, axis=2) * np.linalg.norm(points, axis=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        cosines = np.abs(np.einsum("ijk,ijk->ij", normal, points)) / lengths
    return np.where(lengths > 0, cosines, 1.0)
