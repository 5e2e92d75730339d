"""One RGB-D picture, as a camera takes it."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import Any

import numpy as np

from . import _native
from ._arrays import depth_counts, image, intrinsics, rigid_transform
from ._json import as_json

__all__ = ["Frame"]


class Frame:
    """One RGB-D picture with its camera. Images are ``[h, w]``, row-major, the first pixel is the upper left one.

    Images may come from any library with NumPy's array protocols or DLPack (in the memory of the CPU).

    Args:
        depth: Depth along the optical axis, ``[h, w]``: uint16 counts of ``depth_unit_m``, or floating-point metres. 0, negative and
            non-finite values are no reading. Floats are rounded to 0.1 mm (to 1 mm where something is farther than 6.5 m).
        K: The camera matrix ``[3, 3]``, or ``(fx, fy, cx, cy)``, pixels. Images are rectified: no distortion.
        color: 8-bit RGB, ``[h, w, 3]``.
        labels: Instance ids, ``[h, w]``, 0 is the background.
        world_from_camera: Pose of the camera in the world, ``[4, 4]``; camera frame x right, y down, z forward (OpenCV).
        depth_unit_m: Metres per depth count; 0.001 for uint16 depth where it is not given.
        camera: The camera's name.
        stamp_ns: When it was taken, nanoseconds since the Unix epoch.
        robots: Robots in the picture, which are neither object nor obstacle: ``name``, ``joints_rad`` [7], ``gripper_width_m``,
            ``world_from_base`` (16 numbers). On a running system perception takes their newest states where this says nothing.

    Raises:
        InvalidArgument: An argument cannot be used; ``field`` names it.

    """

    def __init__(
        self,
        depth: Any,
        K: Any,  # noqa: N803
        color: Any = None,
        labels: Any = None,
        world_from_camera: Any = None,
        *,
        depth_unit_m: float | None = None,
        camera: str = "camera",
        stamp_ns: int = 0,
        robots: Sequence[dict[str, Any]] | None = None,
    ) -> None:
        counts, unit_m = depth_counts(depth, depth_unit_m)
        height, width = counts.shape
        rgb = None if color is None else image(color, "color", (height, width, 3), np.uint8).tobytes()
        ids = None if labels is None else image(labels, "labels", (height, width), np.uint16).tobytes()
        pose = None if world_from_camera is None else rigid_transform(world_from_camera, "world_from_camera").ravel().tolist()
        seen = None if robots is None else as_json(list(robots), "robots")
        size = (width, height)
        self._native = _native.Frame(counts.tobytes(), size, intrinsics(K), unit_m, rgb, ids, pose, camera, stamp_ns, seen)

    @classmethod
    def from_folder(cls, folder: str | PathLike[str], *, ignore_labels: bool = False) -> Frame:
        """Read a frame folder: ``depth.png``, ``camera.json``, optionally ``color.png``, ``labels.png`` and ``robot.json``."""
        return cls._of(_native.Frame.from_folder(folder, ignore_labels))

    @classmethod
    def _of(cls, native: _native.Frame) -> Frame:
        frame = cls.__new__(cls)
        frame._native = native
        return frame

    def named(self, camera: str, stamp_ns: int) -> Frame:
        """Return the same picture under a camera's name and with its time, nanoseconds since the Unix epoch."""
        return self._of(self._native.named(camera, stamp_ns))

    @property
    def camera(self) -> str:
        """The camera's name."""
        return self._native.camera

    @property
    def stamp_ns(self) -> int:
        """When it was taken, nanoseconds since the Unix epoch."""
        return self._native.stamp_ns

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, pixels."""
        width, height = self._native.size
        return height, width

    def __repr__(self) -> str:
        height, width = self.shape
        return f"<Frame of {self.camera}: {height} x {width}>"
