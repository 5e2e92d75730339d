"""What cameras publish other than plain images: packed by Pillow and numpy, it becomes the frames and scenes of the plain pictures."""

import contextlib
import json
import threading

import numpy as np
import packing
import pytest
import zenoh
from mocks import Camera
from system import Seen, counts, until

FORMS = ("packed", "floats", "cloud")


@contextlib.contextmanager
def frames(programs):
    """The newest frame of each camera from now on: metadata, depth and color."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([programs.cell]))
    found = {}

    def came(sample):
        bulk = sample.payload.to_bytes()
        start = 8 + int.from_bytes(bulk[:8], "little")
        header = json.loads(bulk[8:start])
        meta = header.pop("__metadata__")

        def array(name, dtype):
            begin, end = header[name]["data_offsets"]
            return np.frombuffer(bulk[start + begin : start + end], dtype).reshape(header[name]["shape"])

        found[str(sample.key_expr).split("/")[-2]] = (meta, array("depth", "<u2"), array("color", np.uint8).astype(int))

    with zenoh.open(config) as session, session.declare_subscriber("repose/v1/*/camera/*/frame", came):
        yield found


class Packed:
    """Publishes a scene in every form, twice a second, until it is closed."""

    def __init__(self, system, scene):
        self.over = threading.Event()
        made = "sensor_msgs/msg/CompressedImage"
        topics = {
            "/cam/depth/image_rect/compressedDepth": ("16UC1; compressedDepth rvl", packing.headed(packing.rvl(scene.depth))),
            "/cam/color/image_rect/compressed": ("rgb8; jpeg compressed bgr8", packing.jpeg(scene.color)),
            "/floats/color/image_rect/compressed": ("rgb8; png compressed bgr8", packing.png(scene.color)),
        }
        quantized, a, b = packing.inverse(scene.depth * 1e-3)
        topics["/floats/depth/image_rect/compressedDepth"] = (
            "32FC1; compressedDepth png",
            packing.headed(packing.png(quantized), a, b),
        )
        publishers = {topic: system.publisher(topic, made) for topic in topics}
        clouds = system.publisher("/cam/points", "sensor_msgs/msg/PointCloud2")
        cloud = packing.cloud(system, system.header("cam_optical"), scene.depth * 1e-3, scene.color, scene.model)

        def run():
            while not self.over.wait(0.5):
                header = system.header("cam_optical")
                for topic, publish in publishers.items():
                    publish(packing.compressed(system, header, *topics[topic]))
                cloud.header = header
                clouds(cloud)

        self.thread = threading.Thread(target=run, daemon=True)
        self.thread.start()

    def close(self):
        self.over.set()
        self.thread.join()


@pytest.fixture
def placed(system, scene):
    """A camera of plain pictures that tells where it stands."""
    made = Camera(system, scene, rate=2)
    yield made
    made.close()


def boxes(found):
    """Centre and size of each box, in a fixed order."""
    parts = [(d.bbox.center.position, d.bbox.size) for d in found.detections]
    return np.array(sorted([getattr(part, axis) for part in both for axis in "xyz"] for both in parts))


def test_packed_pictures_and_clouds_become_the_frames_and_scenes_of_plain_ones(programs, system, scene, placed):
    seen = {name: Seen(system, f"/repose/{name}/detections", "vision_msgs/msg/Detection3DArray") for name in ("front", *FORMS)}
    packed = Packed(system, scene)
    try:
        with frames(programs) as found:
            until("a frame of each form", lambda: set(found) >= {"front", *FORMS})
        # The fourth: what is seen a second time is surer.
        plain, *others = (boxes(seen[name].after(3)) for name in ("front", *FORMS))
    finally:
        packed.close()
    _, depth, color = found["front"]
    assert np.array_equal(depth, scene.depth) and np.array_equal(color, scene.color)
    cameras = {name: json.loads(meta["camera_json"]) for name, (meta, _, _) in found.items()}
    for name in FORMS:
        # The cloud's camera is told from its points.
        off = [abs(cameras[name][key] - cameras["front"][key]) for key in ("fx", "fy", "cx", "cy")]
        assert max(off) < 0.01 and cameras[name]["world_from_camera"] == cameras["front"]["world_from_camera"], (name, off)
    # RVL loses nothing, JPEG a little.
    assert np.array_equal(found["packed"][1], depth)
    off = np.abs(found["packed"][2] - color)
    assert off.mean() < 3 and np.percentile(off, 99) < 40, (off.mean(), off.max())
    # Floats as inverse depths: a step is the depth's square by the quantization.
    depth_m, floats_m = depth * 1e-3, found["floats"][1] * 1e-4
    step_m = depth_m**2 / (packing.DEPTH_QUANTIZATION * (packing.DEPTH_QUANTIZATION + 1))
    assert np.all(np.abs(floats_m - depth_m) <= step_m + 1e-4) and np.array_equal(found["floats"][2], color)
    assert np.all(np.abs(found["cloud"][1] * 1e-4 - depth_m) <= 1e-4) and np.array_equal(found["cloud"][2], color)
    for name, other in zip(FORMS, others):
        assert other.shape == plain.shape, f"{name}: {len(other)} objects, {len(plain)} of plain pictures"
        off_mm = np.abs(other - plain).max() * 1e3
        print(f"{name}: {len(other)} objects, boxes within {off_mm:.2f} mm of those of plain pictures")
        assert off_mm < 5, (name, off_mm)


def test_what_cannot_be_read_is_counted_and_told(programs, system, scene, placed, diagnostics):
    def told(part, words, publish):
        """Publishes until the diagnostics of a part have the words, and a count that rose."""
        before = counts(diagnostics, part).get("unreadable", 0)

        def holds():
            publish()
            statuses = [s for m in diagnostics.messages[-3:] for s in m.status if s.hardware_id == part]
            return any(words in s.message for s in statuses) and counts(diagnostics, part).get("unreadable", 0) > before

        until(f"{part} tells of {words!r}", holds, 30)

    header = lambda: system.header("cam_optical")  # noqa: E731
    color = system.publisher("/cam/color/image_rect/compressed", "sensor_msgs/msg/CompressedImage")
    broken = packing.jpeg(scene.color)[:-2000]
    told("packed", "JPEG", lambda: color(packing.compressed(system, header(), "rgb8; jpeg compressed bgr8", broken)))
    told("packed", "h264", lambda: color(packing.compressed(system, header(), "h264", b"\0\0\0\1")))
    depth = system.publisher("/cam/depth/image_rect/compressedDepth", "sensor_msgs/msg/CompressedImage")
    cut = packing.headed(packing.rvl(scene.depth)[:5000])
    told("packed", "RVL", lambda: depth(packing.compressed(system, header(), "16UC1; compressedDepth rvl", cut)))
    clouds = system.publisher("/cam/points", "sensor_msgs/msg/PointCloud2")
    cloud = packing.cloud(system, header(), scene.depth * 1e-3, scene.color, scene.model, padding=0)
    cloud.width, cloud.height, cloud.row_step = cloud.width * cloud.height, 1, cloud.row_step * cloud.height
    told("cloud", "organized", lambda: clouds(cloud))
    plain = system.publisher("/cam/color/image_rect", "sensor_msgs/msg/Image")
    image = placed.image(scene.color, "rgb8", 0)
    image.header, image.encoding = header(), "yuv422"
    told("front", "yuv422", lambda: plain(image))
    image.encoding, image.step = "rgb8", 100
    told("front", "bytes of data expected", lambda: plain(image))
