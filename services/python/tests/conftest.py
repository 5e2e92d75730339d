"""A table with boxes as a depth camera sees it, made with NumPy; the command to compare with; a system of processes to call."""

from __future__ import annotations

import json
import os
import signal
import socket
import struct
import subprocess
import sys
import time
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import repose


@dataclass(frozen=True)
class View:
    """What `Scene.from_rgbd` takes; depth in millimetres."""

    depth: np.ndarray
    camera_matrix: np.ndarray
    color: np.ndarray
    labels: np.ndarray
    world_from_camera: np.ndarray

    def scene(self, **changes) -> repose.Scene:
        given = {"color": self.color, "labels": self.labels, "world_from_camera": self.world_from_camera, **changes}
        return repose.Scene.from_rgbd(given.pop("depth", self.depth), given.pop("K", self.camera_matrix), **given)


#: Boxes: label, colour, lowest and highest corner, world frame, metres. The table is z = 0, 1.2 m wide and 0.9 m deep.
BOXES = [
    (1, (190, 40, 40), (0.30, -0.25, 0.0), (0.36, -0.19, 0.10)),
    (2, (40, 70, 180), (0.45, 0.00, 0.0), (0.57, 0.14, 0.12)),
    (3, (220, 190, 50), (0.42, 0.25, 0.0), (0.48, 0.31, 0.06)),
]
TABLE = ((0.15, -0.6, -0.02), (1.05, 0.6, 0.0))


def look_at(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(forward, right), forward, eye
    return pose


def entry_depth(origin, directions, low, high) -> np.ndarray:
    """Depth along the optical axis at which rays enter a box; infinite where they miss."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (np.array(low) - origin) / directions, (np.array(high) - origin) / directions
    near, far = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
    return np.where((near <= far) & (near > 0), near, np.inf)


@pytest.fixture(scope="session")
def view() -> View:
    width, height, focal = 320, 240, 280.0
    camera_matrix = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    world_from_camera = look_at(np.array([-0.25, 0.0, 0.65]), np.array([0.5, 0.0, 0.0]))
    v, u = np.mgrid[0:height, 0:width]
    in_camera = np.stack([(u - camera_matrix[0, 2]) / focal, (v - camera_matrix[1, 2]) / focal, np.ones_like(u)], axis=-1)
    directions = in_camera @ world_from_camera[:3, :3].T
    nearest = entry_depth(world_from_camera[:3, 3], directions, *TABLE)
    labels = np.zeros((height, width), np.uint16)
    color = np.full((height, width, 3), 150, np.uint8)
    for label, rgb, low, high in BOXES:
        depth = entry_depth(world_from_camera[:3, 3], directions, low, high)
        mask = depth < nearest
        nearest, labels[mask], color[mask] = np.minimum(nearest, depth), label, rgb
    noise = np.random.default_rng(7).normal(0, 0.0007, nearest.shape)
    millimetres = np.where(np.isfinite(nearest), np.rint((nearest + noise) * 1000), 0).astype(np.uint16)
    return View(millimetres, camera_matrix, color, labels, world_from_camera)


@pytest.fixture(scope="session")
def scene(view: View) -> repose.Scene:
    return view.scene()


@pytest.fixture(scope="session")
def repose_program() -> str:
    """The `repose` program that REPOSE_COMMAND names."""
    program = os.environ.get("REPOSE_COMMAND")
    if not program:
        pytest.skip("REPOSE_COMMAND does not name the repose program")
    return program


@pytest.fixture(scope="session")
def command(repose_program):
    """Run the `repose` command; its exit code and standard output."""

    def run(*args: str) -> tuple[int, str]:
        done = subprocess.run([repose_program, *args], capture_output=True, text=True, timeout=300, check=False)
        return done.returncode, done.stdout

    return run


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class System:
    """`repose up`, until the end of the block."""

    READY_WITHIN_S = 120.0

    def __init__(self, program: str, *args: str) -> None:
        if sys.platform != "linux":
            pytest.skip("processes are found as Linux shows them")
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.log = Path(os.environ.get("REPOSE_TEST_LOG", os.devnull)).open("ab")  # noqa: SIM115
        command = [program, "up", "--listen", self.endpoint, *args]
        # A motion process that waits half a second for a core is not lost, nor one that waits longer where the environment has it so;
        # and a picture a second is enough.
        environment = {"REPOSE_MOTION__COMMAND_TTL_MS": "2000", **os.environ, "REPOSE_SIMULATOR__FRAME_PERIOD_MS": "1000"}
        self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=self.log, env=environment)

    def __enter__(self) -> System:
        # One line, once anything can be asked.
        assert self.process.stdout is not None
        if not self.process.stdout.readline():
            raise RuntimeError(f"repose up ended with status {self.process.wait()}")
        return self

    def __exit__(self, *_: object) -> None:
        self.process.send_signal(signal.SIGINT)
        self.process.wait(60)
        self.log.close()

    def wait_for(self, client: repose.Client, *services: str) -> None:
        """Wait until the services have workers."""
        ends = time.monotonic() + self.READY_WITHIN_S
        while not all(client.workers(service) for service in services):
            assert time.monotonic() < ends, "the services have not come up"
            time.sleep(0.05)

    def children(self, service: str) -> list[int]:
        """Process ids of a service's workers."""
        found = []
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit():
                try:
                    words = (entry / "cmdline").read_text().split("\0")
                    parent = (entry / "stat").read_text().rsplit(")", 1)[1].split()[1]
                except OSError:
                    continue
                if int(parent) == self.process.pid and words[1:3] == ["serve", service]:
                    found.append(int(entry.name))
        return found


def readme_blocks() -> list[str]:
    """The Python code in the package's README, in its order."""
    text = (Path(__file__).parents[1] / "README.md").read_text()
    return [part.split("```")[0] for part in text.split("```python\n")[1:]]


def write_png(path: Path, pixels: np.ndarray) -> None:
    """Write 8-bit RGB or 16-bit grey pixels."""
    height, width = pixels.shape[:2]
    depth, kind = (16, 0) if pixels.dtype == np.uint16 else (8, 2)
    rows = pixels.astype(">u2" if depth == 16 else np.uint8).reshape(height, -1).view(np.uint8).reshape(height, -1)
    raw = np.hstack([np.zeros((height, 1), np.uint8), rows]).tobytes()

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    header = struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, 0)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b""))


@pytest.fixture(scope="session")
def frame_folder(view: View, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("frame")
    height, width = view.depth.shape
    k = view.camera_matrix
    camera = {"width": width, "height": height, "fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2], "depth_unit_m": 0.001}
    camera["world_from_camera"] = view.world_from_camera.ravel().tolist()
    (folder / "camera.json").write_text(json.dumps(camera))
    for name, pixels in (("depth", view.depth), ("color", view.color), ("labels", view.labels)):
        write_png(folder / f"{name}.png", pixels)
    return folder
