"""A table with a block on it, as a camera on the far side sees it."""

import json
import time

import numpy as np

BLOCK_M = (0.04, 0.04, 0.06)
AT_M = (0.5, 0.05)
TABLE_M = [[0.25, -0.45], [0.85, -0.45], [0.85, 0.45], [0.25, 0.45]]


def points():
    """Points and labels: the table's top, and the block's top and the two sides that face the camera."""
    x, y = np.meshgrid(np.arange(0.25, 0.85, 0.008), np.arange(-0.45, 0.45, 0.008))
    table = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    step = np.arange(0.0, 1.0001, 0.05)
    u, v = (a.ravel() for a in np.meshgrid(step, step))
    w, d, h = BLOCK_M
    sides = [(u * w - w / 2, v * d - d / 2, np.full(u.size, h)), (np.full(u.size, w / 2), u * d - d / 2, v * (h - 0.005) + 0.005)]
    block = np.concatenate([np.stack(side, axis=1) for side in sides]) + [*AT_M, 0.0]
    cloud = np.concatenate([table, block]).astype("<f4")
    return cloud, np.concatenate([np.zeros(len(table)), np.ones(len(block))]).astype("<u2"), block


def plan_request(start_rad, scene_id, robot="panda"):
    """What motion's `plan` is asked: the block 15 cm to the side. Tensors and metadata."""
    cloud, labels, block = points()
    moved = [1, 0, 0, 0.0, 0, 1, 0, -0.15, 0, 0, 1, 0, 0, 0, 0, 1]
    summary = {
        "id": 1,
        "points": len(block),
        "centroid_m": block.mean(axis=0).tolist(),
        "extent_m": (block.max(axis=0) - block.min(axis=0)).tolist(),
        "completeness": 1.0,
    }
    camera = {"width": 640, "height": 480, "fx": 525.0, "fy": 525.0, "cx": 319.5, "cy": 239.5, "depth_unit_m": 0.001}
    # It looks from the far side at the table's middle, 0.8 m ahead of it and 0.9 m below; its right is the world's y.
    ahead, down = (np.array([0.8, 0.9]) / np.hypot(0.8, 0.9)).tolist()
    camera["world_from_camera"] = [0, down, -ahead, 1.3, 1, 0, 0, 0, 0, -ahead, -down, 0.9, 0, 0, 0, 1]
    meta = {
        "objects": [summary],
        "surfaces": [{"height_m": 0.0, "outline_m": TABLE_M, "area_m2": 0.54}],
        "camera": camera,
        "world_frame": "extrinsics",
        "view_yaw_rad": 0.0,
        "unseen": {"pixels_without_reading": 0, "pixels_on_borders": 0, "share": 0.0},
    }
    tensors = {"points": ("F32", list(cloud.shape), cloud.tobytes()), "labels": ("U16", [len(labels)], labels.tobytes())}
    request = {"scene": {"scene_id": scene_id}, "robot": robot, "query": 1, "placements": [moved], "start_joints_rad": start_rad}
    metadata = {"scene": json.dumps(meta), "camera": "front", "stamp_ns": str(time.time_ns()), "request": json.dumps(request)}
    return tensors, metadata
