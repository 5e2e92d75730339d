#!/usr/bin/env python3
"""A robot that is a text file of joint positions: the smallest driver.

`text_robot.py joints.txt` keeps seven numbers (radians) in the file, on a running system (`repose up --no-simulator`). Look into it to see
the arm move, or write other numbers to move it "by hand".
"""

import argparse
from pathlib import Path

import numpy as np

import repose

READY_RAD = [0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398]


class TextRobot(repose.driver.Robot):
    """Joint positions in a file, one line of seven numbers."""

    def __init__(self, file: Path, name: str = "panda") -> None:
        self.file, self.name = file, name
        self._sent = ""
        if not file.exists():
            self.send_joints(np.array(READY_RAD), np.zeros(7))

    def read_joints(self):
        return np.array(self.file.read_text().split(), dtype=float)

    def send_joints(self, joints_rad, velocities_rad_s):
        line = " ".join(f"{q:.6f}" for q in joints_rad) + "\n"
        # Only what is new, so that what an editor writes while the arm stands is not lost; and whole, so that no reader sees half a line.
        if line != self._sent:
            self._sent = line
            new = self.file.with_suffix(".new")
            new.write_text(line)
            new.replace(self.file)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--connect", help="a router of the deployment (tcp/127.0.0.1:7447)")
    parser.add_argument("--name", default="panda", help="the robot's name in the cell")
    args = parser.parse_args()
    repose.driver.run(TextRobot(args.file, args.name), endpoint=args.connect)
