"""A segmented scene: objects, surfaces and points of one RGB-D view."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from .errors import NotFound
from .frame import Frame

__all__ = ["Scene", "SceneObject", "Surface"]


@dataclass(frozen=True, eq=False)
class SceneObject:
    """An object of a scene.

    Attributes:
        id: Its number, its label in ``Scene.labels``.
        points: How many points it has.
        centroid_m: Mean of its observed points, world frame, metres, ``[3]``.
        extent_m: Edges of the axis-aligned box of its observed points, world frame, metres, ``[3]``.
        completeness: Estimated share of its visible surface that was observed, 0 to 1.

    """

    id: int
    points: int
    centroid_m: NDArray[np.float64]
    extent_m: NDArray[np.float64]
    completeness: float


@dataclass(frozen=True, eq=False)
class Surface:
    """A horizontal surface on which things can stand.

    Attributes:
        height_m: Height, world z, metres.
        outline_m: Convex outline of what was seen of it, world x and y, counter-clockwise, metres, ``[n, 2]``.
        area_m2: Area of that outline, square metres.
        object: The object whose top it is; ``None`` for tables, shelves and other furniture.

    """

    height_m: float
    outline_m: NDArray[np.float64]
    area_m2: float
    object: int | None


class Scene:
    """A segmented point cloud in the world frame (z up), with objects and support surfaces. It cannot be changed, and can be pickled.

    Without a calibrated camera pose the world is the gravity-aligned frame of the main support plane, its origin below the camera, the
    viewer looking along y. Make one with `Scene.from_rgbd` or `Scene.from_folder`, or get it from a running system.
    """

    def __init__(self, native: _native.Scene) -> None:
        """Wrap the native scene; private."""
        self._native = native
        self._meta: dict[str, Any] = json.loads(native.meta())
        self._points = np.frombuffer(native.points(), dtype=np.float32).reshape(-1, 3)
        self._labels = np.frombuffer(native.labels(), dtype=np.uint16)
        colors = native.colors()
        self._colors = None if colors is None else np.frombuffer(colors, dtype=np.uint8).reshape(-1, 3)

    @classmethod
    def from_rgbd(
        cls,
        depth: Any,
        K: Any,  # noqa: N803
        color: Any = None,
        labels: Any = None,
        world_from_camera: Any = None,
        *,
        depth_unit_m: float | None = None,
        camera: str = "camera",
        stamp_ns: int = 0,
    ) -> Scene:
        """Segment one RGB-D view. The interpreter lock is released.

        Args:
            depth: Depth along the optical axis, ``[h, w]``: uint16 counts of ``depth_unit_m``, or floating-point metres. 0, negative and
                non-finite values are no reading. Floats are rounded to 0.1 mm (to 1 mm where something is farther than 6.5 m).
            K: The camera matrix ``[3, 3]``, or ``(fx, fy, cx, cy)``, pixels. Images are rectified: no distortion.
            color: 8-bit RGB, ``[h, w, 3]``.
            labels: Instance ids, ``[h, w]``, 0 is the background. Without them the objects are found.
            world_from_camera: Pose of the camera in the world, ``[4, 4]``; camera frame x right, y down, z forward (OpenCV).
            depth_unit_m: Metres per depth count; 0.001 for uint16 depth where it is not given.
            camera: The camera's name.
            stamp_ns: When it was taken, nanoseconds since the Unix epoch.

        Raises:
            InvalidArgument: An argument cannot be used, or the picture shows nothing to plan on; ``field`` names it.

        """
        taken = Frame(depth, K, color, labels, world_from_camera, depth_unit_m=depth_unit_m, camera=camera, stamp_ns=stamp_ns)
        return cls.from_frame(taken)

    @classmethod
    def from_frame(cls, frame: Frame) -> Scene:
        """Segment a frame, by its labels where it has any."""
        return cls(_native.Scene.of_frame(frame._native))

    @classmethod
    def from_folder(cls, folder: str | PathLike[str], *, ignore_labels: bool = False) -> Scene:
        """Segment a frame folder: ``depth.png``, ``camera.json``, optionally ``color.png``, ``labels.png`` and ``robot.json``."""
        return cls.from_frame(Frame.from_folder(folder, ignore_labels=ignore_labels))

    @classmethod
    def from_bytes(cls, data: bytes) -> Scene:
        """Read a scene from its wire form (safetensors, see `to_bytes`)."""
        return cls(_native.Scene.from_bytes(data))

    def to_bytes(self) -> bytes:
        """Return the wire form, safetensors: ``points`` f32 [n, 3], ``labels`` u16 [n], ``colors`` u8 [n, 3]; metadata as JSON."""
        return self._native.to_bytes()

    def __reduce__(self) -> tuple[Callable[[bytes], Scene], tuple[bytes]]:
        # Another process makes it of its wire form, with the same id: the native scene is of this one.
        return type(self).from_bytes, (self.to_bytes(),)

    @property
    def id(self) -> str:
        """The scene's id, the BLAKE3 hash of its content: 64 hexadecimal digits."""
        return self._native.id

    @property
    def camera(self) -> str:
        """The name of the camera that saw it."""
        return self._native.camera

    @property
    def stamp_ns(self) -> int:
        """When it was seen, nanoseconds since the Unix epoch."""
        return self._native.stamp_ns

    @property
    def meta(self) -> dict[str, Any]:
        """Everything but the points, as it travels: objects, surfaces, camera, what is unseen. Each reader has a copy of its own."""
        # Plans are made on the native scene: one dictionary for all would let one reader show another what no plan is made on.
        return copy.deepcopy(self._meta)

    @property
    def objects(self) -> list[SceneObject]:
        """The objects, by id."""
        return [
            SceneObject(o["id"], o["points"], np.array(o["centroid_m"]), np.array(o["extent_m"]), o["completeness"])
            for o in self._meta["objects"]
        ]

    @property
    def surfaces(self) -> list[Surface]:
        """The support surfaces, largest first."""
        return [
            Surface(s["height_m"], np.array(s["outline_m"]).reshape(-1, 2), s["area_m2"], s.get("object")) for s in self._meta["surfaces"]
        ]

    @property
    def points(self) -> NDArray[np.float32]:
        """All points, world frame, metres, ``[n, 3]``, read-only."""
        return self._points

    @property
    def labels(self) -> NDArray[np.uint16]:
        """The object of each point, ``[n]``, 0 is no object; read-only."""
        return self._labels

    @property
    def colors(self) -> NDArray[np.uint8] | None:
        """The color of each point, RGB, ``[n, 3]``, read-only; ``None`` where the camera saw none."""
        return self._colors

    @property
    def world_from_camera(self) -> NDArray[np.float64]:
        """Pose of the camera, calibrated or estimated, ``[4, 4]``."""
        return np.array(self._meta["camera"]["world_from_camera"]).reshape(4, 4)

    def points_of(self, object_id: int) -> NDArray[np.float32]:
        """Return the points of one object, world frame, metres, ``[n, 3]``.

        Raises:
            NotFound: The scene has no such object.

        """
        found: NDArray[np.float32] = self._points[self._labels == object_id]
        if object_id == 0 or not len(found):
            raise NotFound(f"the scene has no object {object_id}; it has {[o['id'] for o in self._meta['objects']]}", "object_id")
        return found

    def __repr__(self) -> str:
        return f"<Scene {self.id[:12]}…: objects {[o['id'] for o in self._meta['objects']]}, {len(self._points)} points>"
