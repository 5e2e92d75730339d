"""Pictures as cameras' drivers pack them, by Pillow and numpy: what image_transport publishes, and organized clouds."""

import io
import itertools
import struct

import numpy as np
from PIL import Image

# image_transport's own defaults.
DEPTH_QUANTIZATION, DEPTH_MAX = 100.0, 10.0


def jpeg(rgb, quality=95):
    """A JPEG as OpenCV and libjpeg write it, colors at half the resolution."""
    out = io.BytesIO()
    Image.fromarray(rgb).save(out, "JPEG", quality=quality, subsampling="4:2:0")
    return out.getvalue()


def png(pixels):
    """A PNG of 8-bit colors or 16-bit counts."""
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "PNG")
    return out.getvalue()


def rvl(counts):
    """Wilson's run length and variable length coding, after its size as image_transport has it."""
    nibbles = []

    def put(number):
        while number > 7:
            nibbles.append(number & 7 | 8)
            number >>= 3
        nibbles.append(number)

    previous = 0
    runs = [(empty, list(run)) for empty, run in itertools.groupby(counts.ravel().tolist(), lambda count: count == 0)]
    # A picture begins with a run of empty pixels, be it of none, and the runs go by turns.
    if runs and not runs[0][0]:
        put(0)
    for empty, run in runs:
        put(len(run))
        for count in [] if empty else run:
            difference = count - previous
            put(2 * difference if difference >= 0 else -2 * difference - 1)
            previous = count
    if runs and runs[-1][0]:
        put(0)
    nibbles += [0] * (-len(nibbles) % 8)
    words = np.reshape(nibbles, (-1, 8)) @ (16 ** np.arange(7, -1, -1))
    height, width = counts.shape
    return struct.pack("<II", width, height) + words.astype("<u4").tobytes()


def inverse(depth_m):
    """Depth in metres as image_transport quantizes it, and the numbers that it did it by; what is no number or too far is 0."""
    a = DEPTH_QUANTIZATION * (DEPTH_QUANTIZATION + 1)
    b = 1 - a / DEPTH_MAX
    is_there = np.isfinite(depth_m) & (depth_m > 0) & (depth_m < DEPTH_MAX)
    return np.where(is_there, a / np.where(is_there, depth_m, 1) + b, 0).astype("<u2"), a, b


def headed(packed, a=0.0, b=0.0):
    """What image_transport puts before packed depth."""
    return struct.pack("<iff", 0, a, b) + packed


def compressed(system, header, fmt, data):
    return system.make("sensor_msgs/msg/CompressedImage", header=header, format=fmt, data=np.frombuffer(data, np.uint8))


def cloud(system, header, depth_m, rgb, model, big_endian=True, padding=12):
    """An organized cloud with gaps within its points and after its rows, NaN where there is no reading."""
    height, width = depth_m.shape
    order, point_step = ">" if big_endian else "<", 28
    rows, columns = np.mgrid[:height, :width]
    z = np.where(depth_m > 0, depth_m, np.nan)
    x, y = (columns - model["cx"]) / model["fx"] * z, (rows - model["cy"]) / model["fy"] * z
    color = rgb.astype("u4") @ np.array([1 << 16, 1 << 8, 1], "u4")
    offsets = {"rgb": (0, "u4", color), "x": (8, "f4", x), "y": (12, "f4", y), "z": (20, "f4", z)}
    row_step = width * point_step + padding
    data = np.full((height, row_step), 99, np.uint8)
    points = data[:, : width * point_step].reshape(height, width, point_step)
    for at, kind, values in offsets.values():
        points[..., at : at + 4] = np.ascontiguousarray(values.astype(order + kind))[..., None].view(np.uint8).reshape(height, width, 4)
    fields = [system.make("sensor_msgs/msg/PointField", name=n, offset=o, datatype=7, count=1) for n, (o, _, _) in offsets.items()]
    return system.make(
        "sensor_msgs/msg/PointCloud2",
        header=header,
        height=height,
        width=width,
        fields=fields,
        is_bigendian=big_endian,
        point_step=point_step,
        row_step=row_step,
        data=data.ravel(),
    )
