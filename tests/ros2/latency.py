"""How long pictures take from a ROS 2 camera to frames and scenes, with the time that perception itself takes apart.

The camera is this process: messages are serialized beforehand and only stamped when they are sent, so that what is measured begins with the later
picture of a pair on its way. `to frame` is the bridge's own figure: from that picture's arrival to its frame on the wire. `to scene` is seen from
here, from the put of that picture to the summary of its scene; `perception` is what perception says of the same frame, from its arrival to its
scene; `beyond` is the difference, frame by frame.
"""

import argparse
import contextlib
import json
import os
import platform
import struct
import tempfile
import time

import numpy as np
import packing
import zenoh
from definitions import store
from mocks import Camera, Scene
from programs import Programs
from system import System, until

COMPRESSED, IMAGE = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image"


def forms(system, scene, camera):
    """By name: the bridge's camera, and its topics with their types and messages, the later one last."""
    header = system.header("cam_optical", 0)
    depth_m = scene.depth * 1e-3
    plain = camera.image(scene.depth.astype("<u2"), "16UC1", 0)
    color = camera.image(scene.color, "rgb8", 0)
    rvl = packing.compressed(system, header, "16UC1; compressedDepth rvl", packing.headed(packing.rvl(scene.depth)))
    jpeg = packing.compressed(system, header, "rgb8; jpeg compressed bgr8", packing.jpeg(scene.color))
    quantized, a, b = packing.inverse(depth_m)
    floats = packing.compressed(system, header, "32FC1; compressedDepth png", packing.headed(packing.png(quantized), a, b))
    png = packing.compressed(system, header, "rgb8; png compressed bgr8", packing.png(scene.color))
    cloud = packing.cloud(system, header, depth_m, scene.color, scene.model, big_endian=False, padding=0)
    packed = ("/cam/depth/image_rect/compressedDepth", "/cam/color/image_rect/compressed")
    return {
        "16UC1 and rgb8": ("front", [("/cam/depth/image_rect", IMAGE, plain), ("/cam/color/image_rect", IMAGE, color)]),
        "the same, rectified here": ("bent", [("/bent/depth/image", IMAGE, plain), ("/bent/color/image", IMAGE, color)]),
        "RVL and JPEG": ("packed", [(packed[0], COMPRESSED, rvl), (packed[1], COMPRESSED, jpeg)]),
        "PNG of 32FC1 and PNG": (
            "floats",
            [("/floats/depth/image_rect/compressedDepth", COMPRESSED, floats), ("/floats/color/image_rect/compressed", COMPRESSED, png)],
        ),
        "PointCloud2 with rgb": ("cloud", [("/cam/points", "sensor_msgs/msg/PointCloud2", cloud)]),
    }


class Sender:
    """Puts messages that are serialized already."""

    def __init__(self, system, topics):
        self.parts = []
        for topic, type_name, message in topics:
            system.show("MP", topic, type_name)
            publisher = system.session.declare_publisher(system.key(topic, type_name), congestion_control=zenoh.CongestionControl.BLOCK)
            self.parts.append((publisher, bytearray(system.store.serialize_cdr(message, type_name))))
        self.gid, self.sent = os.urandom(16), 0

    def send(self):
        """Sends one picture of each; its stamp, and when the last was on its way."""
        ns = time.time_ns()
        for publisher, payload in self.parts:
            self.sent += 1
            # The stamp is the first field of the first field.
            payload[4:12] = struct.pack("<iI", ns // 10**9, ns % 10**9)
            began = time.monotonic()
            publisher.put(bytes(payload), attachment=struct.pack("<qqB", self.sent, ns, 16) + self.gid)
        return ns, began


def logged(programs, name, message):
    """Fields of a program's log lines with a message, by stamp."""
    found = {}
    for line in programs.log(name).splitlines():
        with contextlib.suppress(json.JSONDecodeError):
            fields = json.loads(line).get("fields", {})
            if fields.get("message") == message:
                found[fields["stamp_ns"]] = fields
    return found


def shares(values):
    return f"{np.percentile(values, 50):6.1f} {np.percentile(values, 95):6.1f}"


def measure(programs, system, scenes, name, camera, topics, seconds, rate):
    sender, sent = Sender(system, topics), {}
    warm = time.monotonic() + 3
    due = time.monotonic()
    while time.monotonic() < warm + seconds:
        ns, began = sender.send()
        if due > warm:
            sent[ns] = began
        due = max(due + 1 / rate, time.monotonic())
        time.sleep(max(due - time.monotonic(), 0))
    time.sleep(1)
    frames, own = logged(programs, "ros2", "frame put"), logged(programs, "perception", "scene published")
    to_frame = [frames[ns]["took_ms"] for ns in sent if ns in frames]
    whole = [ns for ns in sent if ns in scenes[camera] and ns in own]
    to_scene = [(scenes[camera][ns] - sent[ns]) * 1e3 for ns in whole]
    perception = [own[ns]["age_ms"] for ns in whole]
    beyond = [scene - age for scene, age in zip(to_scene, perception)]
    row = f"{len(sent):4} {len(to_frame):6} {len(whole):6}"
    print(f"| {name:25} | {row} | {shares(to_frame)} | {shares(to_scene)} | {shares(perception)} | {shares(beyond)} |", flush=True)
    return np.percentile(beyond, 95)


BENT = """
[[ros2.cameras]]
name = "bent"
depth = "/bent/depth/image"
color = "/bent/color/image"
info = "/bent/camera_info"
"""


def main():
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seconds", type=float, default=20.0, help="for each form")
    options.add_argument("--rate", type=float, default=15.0, help="pictures a second")
    options.add_argument("--form", action="append", help="only the forms with these words in their names")
    given = options.parse_args()
    os.environ["REPOSE_LOG"], os.environ["REPOSE_LOG_FORMAT"] = "info,repose_ros2=debug,repose_perception=debug", "json"
    scene, folder = Scene(), os.environ.get("ROS2_LOGS") or tempfile.mkdtemp()
    os.makedirs(folder, exist_ok=True)
    programs = Programs(folder)
    with open(programs.config, "a", encoding="utf-8") as out:
        out.write(BENT)
    try:
        programs.start_all(("perception", "ros2"))
        system = System(store(), programs.ros)
        camera = Camera(system, scene, rate=0.001)
        camera.close()
        k = np.array([scene.model["fx"], 0, scene.model["cx"], 0, scene.model["fy"], scene.model["cy"], 0, 0, 1.0])
        size = {"height": scene.model["height"], "width": scene.model["width"], "distortion_model": "plumb_bob", "k": k}
        bent = system.make("sensor_msgs/msg/CameraInfo", d=np.array([-0.05, 0.05, 0.0003, -0.0005, -0.02]), **size)
        straight = system.make("sensor_msgs/msg/CameraInfo", d=np.zeros(5), **size)
        infos = [system.publisher(t, "sensor_msgs/msg/CameraInfo") for t in ("/cam/depth/camera_info", "/bent/camera_info")]
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([programs.cell]))
        scenes = {name: {} for name in ("front", "packed", "floats", "cloud", "bent")}

        def came(sample):
            now, summary = time.monotonic(), json.loads(sample.payload.to_bytes())
            scenes[str(sample.key_expr).split("/")[-1]][summary["stamp_ns"]] = now

        with zenoh.open(config) as session, session.declare_subscriber("repose/v1/*/scene/*", came):
            until("the bridge is there", lambda: "joined the ROS 2 system" in programs.log("ros2"))
            time.sleep(2)
            infos[0](straight), infos[1](bent)
            cores = os.cpu_count()
            print(f"{scene.model['width']} x {scene.model['height']} at {given.rate:g}/s for {given.seconds:g} s each, {cores} cores of {cpu()}")
            print("milliseconds, median and 95th percentile")
            print("| form | sent frames scenes | to frame | to scene | perception | beyond |")
            print("|---|---|---|---|---|---|")
            for name, (of, topics) in forms(system, scene, camera).items():
                if not given.form or any(words in name for words in given.form):
                    measure(programs, system, scenes, name, of, topics, given.seconds, given.rate)
        system.close()
    finally:
        programs.close()


def cpu():
    with contextlib.suppress(OSError), open("/proc/cpuinfo", encoding="utf-8") as info:
        return next((line.split(":")[1].strip() for line in info if line.startswith("model name")), platform.machine())
    return platform.machine()


if __name__ == "__main__":
    main()
