"""Frame folders: what the camera reports and where the robot stands, on disk."""

import json
import os

import numpy as np
from PIL import Image

from .camera import sensed


def save(world, rng, folder):
    """Writes the picture of a world as it is; its noise is of `rng`."""
    os.makedirs(folder, exist_ok=True)
    color, depth_m, labels = world.picture()
    for name, pixels in (("color", color), ("depth", sensed(depth_m, rng)), ("labels", labels)):
        Image.fromarray(pixels).save(os.path.join(folder, f"{name}.png"))
    robot = {
        "name": "panda",
        "joints_rad": world.robot.measured_rad,
        "gripper_width_m": world.robot.width_m,
        "world_from_base": np.eye(4).ravel().tolist(),
    }
    for name, content in (("camera", world.furniture.camera.model()), ("robot", [robot])):
        with open(os.path.join(folder, f"{name}.json"), "w", encoding="utf-8") as out:
            json.dump(content, out)
