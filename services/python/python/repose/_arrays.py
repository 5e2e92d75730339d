"""Arrays of any library as NumPy arrays, checked, with errors that name the argument."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import InvalidArgument

#: The finest unit of depth counts that whole millimetres and 16 bits allow, metres, and the unit for scenes too deep for it.
FINE_UNIT_M = 0.0001
COARSE_UNIT_M = 0.001
MAX_COUNT = 65535


def as_array(value: Any, name: str) -> NDArray[Any]:
    """Take an array through NumPy's protocols, or else through DLPack."""
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        raise InvalidArgument(
            "expected an array without a mask, whose hidden values would count: fill it, a depth with 0 for no reading", name
        )
    if isinstance(value, np.ndarray):
        # A plain one: those of a class of their own, such as matrices, have shapes of their own.
        return np.asarray(value)
    if not hasattr(value, "__array__") and not hasattr(value, "__array_interface__") and hasattr(value, "__dlpack__"):
        try:
            return np.from_dlpack(value)
        except (BufferError, TypeError, ValueError, RuntimeError) as error:
            raise InvalidArgument(f"expected an array in the memory of the CPU: {error}", name) from error
    try:
        return np.asarray(value)
    # Tensors that gradients are asked of raise a RuntimeError.
    except (TypeError, ValueError, RuntimeError) as error:
        raise InvalidArgument(f"expected an array, got {type(value).__name__}: {error}", name) from error


def depth_counts(depth: Any, depth_unit_m: float | None) -> tuple[NDArray[np.uint16], float]:
    """Depth as 16-bit counts [h, w] and their unit in metres. Floats are metres; what is no reading becomes 0."""
    array = as_array(depth, "depth")
    if array.ndim != 2:
        raise InvalidArgument(f"expected an image [height, width], got shape {list(array.shape)}", "depth")
    if depth_unit_m is not None and not depth_unit_m > 0:
        raise InvalidArgument(f"expected metres per count, got {depth_unit_m}", "depth_unit_m")
    # In either order of bytes: some readers of PNG leave the file's.
    if array.dtype.kind == "u" and array.dtype.itemsize == 2:
        return np.ascontiguousarray(array, dtype=np.uint16), COARSE_UNIT_M if depth_unit_m is None else float(depth_unit_m)
    if array.dtype.kind != "f":
        raise InvalidArgument(f"expected uint16 counts or float metres, got {array.dtype}", "depth")
    metres = np.where(np.isfinite(array) & (array > 0), array, 0).astype(np.float64)
    unit_m = depth_unit_m
    if unit_m is None:
        unit_m = FINE_UNIT_M if metres.max(initial=0.0) <= MAX_COUNT * FINE_UNIT_M else COARSE_UNIT_M
    counts = np.rint(metres / unit_m)
    return np.where(counts <= MAX_COUNT, counts, 0).astype(np.uint16), float(unit_m)


def intrinsics(camera_matrix: Any) -> tuple[float, float, float, float]:
    """Focal lengths and principal point (fx, fy, cx, cy), pixels, of a 3x3 matrix or of those four numbers."""
    array = as_array(camera_matrix, "K")
    if array.dtype.kind not in "fiu":
        raise InvalidArgument(f"expected numbers, got {array.dtype}", "K")
    array = array.astype(np.float64)
    if array.shape == (4,):
        fx, fy, cx, cy = (float(v) for v in array)
        return fx, fy, cx, cy
    if array.shape != (3, 3):
        raise InvalidArgument(f"expected a 3x3 camera matrix or (fx, fy, cx, cy), got shape {list(array.shape)}", "K")
    if array[0, 1] != 0 or array[1, 0] != 0 or not np.array_equal(array[2], [0, 0, 1]):
        raise InvalidArgument("expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]", "K")
    return float(array[0, 0]), float(array[1, 1]), float(array[0, 2]), float(array[1, 2])


def image(value: Any, name: str, shape: tuple[int, ...], dtype: type[np.generic]) -> NDArray[Any]:
    """Take an image of a shape. Whole numbers of other types are taken where they fit."""
    array = as_array(value, name)
    if array.shape != shape:
        raise InvalidArgument(f"expected shape {list(shape)}, got {list(array.shape)}", name)
    if array.dtype != dtype:
        limits = np.iinfo(dtype)  # type: ignore[type-var]
        if array.dtype.kind not in "iub" or (array.size and (array.min() < limits.min or array.max() > limits.max)):
            raise InvalidArgument(f"expected {np.dtype(dtype).name}, got {array.dtype}", name)
        array = array.astype(dtype)
    return np.ascontiguousarray(array)


def joint_positions(value: Any, name: str) -> list[float]:
    """Seven joint positions, radians; whether they are finite and within the arm's limits is checked by who uses them."""
    array = as_array(value, name)
    if array.shape != (7,) or array.dtype.kind not in "fiu":
        raise InvalidArgument(f"expected 7 joint positions, radians, got {array.dtype} {list(array.shape)}", name)
    return [float(q) for q in array]


def rigid_transform(value: Any, name: str) -> NDArray[np.float64]:
    """One rigid transform [4, 4]; whether it is rigid is checked by who uses it."""
    array = as_array(value, name)
    if array.shape != (4, 4):
        raise InvalidArgument(f"expected a transform [4, 4], got shape {list(array.shape)}", name)
    checked: NDArray[np.float64] = rigid_transforms(array, name)[0]
    return checked


def rigid_transforms(value: Any, name: str) -> NDArray[np.float64]:
    """Rigid transforms [n, 4, 4] of one [4, 4] or several [n, 4, 4]; whether they are rigid is checked by who uses them."""
    array = as_array(value, name)
    if array.shape == (4, 4):
        array = array[np.newaxis]
    if array.ndim != 3 or array.shape[1:] != (4, 4) or array.dtype.kind not in "fiu":
        raise InvalidArgument(f"expected transforms [4, 4] or [n, 4, 4], got {array.dtype} {list(array.shape)}", name)
    return np.ascontiguousarray(array, dtype=np.float64)
