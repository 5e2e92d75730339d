#!/usr/bin/env python3
"""A folder as a camera: every frame folder that is put into it is published.

`folder_camera.py FRAMES --name desk` waits for frame folders below FRAMES (`depth.png`, `camera.json`, optionally `color.png` and
`labels.png`) and publishes each once, the newest by name; write `camera.json` last. With `--again` the newest is published over and over,
as a camera that looks at a scene in which nothing moves.
"""

import argparse
from pathlib import Path

import repose


class FolderCamera(repose.driver.Camera):
    """The newest frame folder below a folder."""

    def __init__(self, folder: Path, name: str = "front", again: bool = False) -> None:
        self.folder, self.name, self.again = folder, name, again
        self._last: Path | None = None

    def read(self):
        newest = max((camera.parent for camera in self.folder.glob("*/camera.json")), default=None)
        if newest is None or (newest == self._last and not self.again):
            return None
        self._last = newest
        return repose.Frame.from_folder(newest)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--connect", help="a router of the deployment (tcp/127.0.0.1:7447)")
    parser.add_argument("--name", default="front", help="the camera's name in the cell")
    parser.add_argument("--again", action="store_true", help="publish the newest over and over")
    args = parser.parse_args()
    repose.driver.run(FolderCamera(args.folder, args.name, args.again), endpoint=args.connect)
