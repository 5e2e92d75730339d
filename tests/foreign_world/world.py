"""The physics of the cell: furniture, objects, the Panda, and what touches what. No network."""

import math
from collections import defaultdict

import numpy as np
import pybullet
from pybullet_utils.bullet_client import BulletClient

from . import scenes
from .control import READY_RAD, TICK_S, ArmControl
from .panda import HAND_LINK, Panda

STEP_S = 0.002
TICKS = round(STEP_S / TICK_S)
# Contacts are looked at every so many steps.
WATCH_STEPS = 3
# Objects within this of where they were have not been moved.
STIRRED_M = 0.005
PHASES = ("ready", "standoff", "approach", "grasp", "lift", "transfer", "lower", "release", "retreat")
# Which streams and gripper actions make a pick and place, as a robot's side sees it.
EVENTS = ("gripper", "stream", "stream", "gripper", "stream", "stream", "stream", "gripper", "stream")
AFTER_EVENTS = ("standoff", "standoff", "approach", "grasp", "lift", "transfer", "lower", "release", "retreat")


class World:
    """A cell of a kind and seed, stepped in robot time."""

    def __init__(self, meshes):
        self.client = BulletClient(connection_mode=pybullet.DIRECT)
        self.meshes = meshes
        self.control = ArmControl()
        self.robot_s = 0.0

    def clear(self):
        """An empty world; owner and latched stop stay with the robot."""
        client = self.client
        client.resetSimulation()
        client.setTimeStep(STEP_S)
        client.setGravity(0, 0, -9.81)
        client.setPhysicsEngineParameter(numSolverIterations=100, enableConeFriction=1, contactERP=0.2, frictionERP=0.2)
        self.objects, self.placed, self.fixed, self.peaks = [], [], [], defaultdict(float)
        self.stirred, self.steps = {}, 0
        # The task that runs or ran last, and where things were when it began: what its plan was made of.
        self.task, self.observed = None, []

    def furnish(self, kind, shapes, rng):
        """Draws a scene, lets it settle, and puts the robot in; whether all stands as it was put."""
        self.clear()
        self.furniture = scenes.Furniture(kind, rng)
        wood = rng.uniform(0.35, 0.75, 3)
        self.fixed = [scenes.add_box(self.client, low, high, wood * rng.uniform(0.8, 1.1)) for low, high in self.furniture.boxes]
        floor = ((-3, -3, scenes.FLOOR_M - 0.05), (3, 3, scenes.FLOOR_M))
        self.fixed.append(scenes.add_box(self.client, *floor, (0.3, 0.3, 0.32)))
        self.placed = scenes.drawn(kind, shapes, self.furniture, rng)
        for p in self.placed:
            place = (p.x, p.y, p.surface.height_m + 0.002 - p.shape.low_m[2])
            self.objects.append(scenes.add_object(self.client, self.meshes, p.shape, place, p.yaw_rad, p.friction, p.color))
        rests = scenes.settle(self.client, self.objects, 4.0, STEP_S)
        self.start = [self.pose(k) for k in range(len(self.objects))]
        self.control.rehome()
        self.robot = Panda(self.client, READY_RAD, STEP_S)
        return rests and all(self._stands(p, pose) for p, pose in zip(self.placed, self.start))

    def _stands(self, placed, pose):
        moved = math.hypot(pose[0, 3] - placed.x, pose[1, 3] - placed.y)
        return moved < scenes.STOOD_M and scenes.tilt_rad(pose) < scenes.STOOD_RAD

    def pose(self, index):
        return scenes.pose_of(self.client, self.objects[index])

    def step(self, now_s):
        """One step of physics; `now_s` is the clock that commands expire by."""
        control, robot = self.control, self.robot
        control.grips = robot.grips
        for _ in range(TICKS):
            control.tick(now_s)
        self.robot_s += STEP_S
        if control.task not in (None, self.task):
            self.task, self.observed = control.task, [self.pose(k) for k in range(len(self.objects))]
        if control.gripper:
            robot.grip(control.gripper)
            control.gripper = None
        robot.before_step(control.position_rad, control.velocity_rad_s)
        self.client.stepSimulation()
        robot.after_step()
        control.measured_rad = robot.measured_rad
        self.steps += 1
        if self.steps % WATCH_STEPS == 0:
            self._watch()

    @property
    def phase(self):
        """Which part of a pick and place the robot is in, told by what it was commanded."""
        return AFTER_EVENTS[min(len(self.control.events), len(AFTER_EVENTS)) - 1] if self.control.events else PHASES[0]

    def _watch(self):
        """Keeps the largest force between each part of the robot and each thing, by phase, and when each object first moved."""
        phase = self.phase
        index = {body: k + 1 for k, body in enumerate(self.objects)}
        forces = defaultdict(float)
        for contact in self.client.getContactPoints(bodyA=self.robot.body):
            if contact[2] == self.robot.body:
                continue
            part = "finger" if contact[3] in (9, 10) else "hand" if contact[3] == HAND_LINK else "arm"
            thing = index.get(contact[2], 0)
            forces[(phase, part, thing)] += contact[9]
        for key, force in forces.items():
            self.peaks[key] = max(self.peaks[key], force)
        for k in range(len(self.objects)):
            if k not in self.stirred:
                place, _ = self.client.getBasePositionAndOrientation(self.objects[k])
                if math.dist(place, self.start[k][:3, 3]) > STIRRED_M:
                    self.stirred[k] = phase

    def at_rest(self):
        return self.control.at_rest() and all(scenes._rests(self.client, body) for body in self.objects)

    def on_floor(self, index):
        return self.pose(index)[2, 3] < self.furniture.table_m - 0.1

    def picture(self, scale=1):
        """Colour, true depth and object numbers (from 1; 0 for everything else)."""
        color, depth_m, bodies = self.furniture.camera.picture(self.client, scale)
        labels = np.zeros(bodies.shape, "<u2")
        for k, body in enumerate(self.objects):
            labels[bodies == body] = k + 1
        return color, depth_m, labels

    def state(self, seq, stamp_ns):
        """The contract's robot state."""
        control, robot = self.control, self.robot
        state = {
            "v": 1,
            "seq": seq,
            "stamp_ns": stamp_ns,
            "robot_ms": self.robot_s * 1e3,
            "q_rad": robot.measured_rad,
            "dq_rad_s": robot.measured_rad_s,
            "gripper_width_m": robot.width_m,
            "gripper_settled": robot.settled,
            "gripper_holding": robot.settled and robot.grips,
            "mode": control.mode,
            "stop": control.stop,
            "owner": control.owner,
            "last_command": control.last_command,
            "stream_ms": control.stream_ms,
            "task": {"id": control.task} if control.task else {},
            "model": "panda",
            "world_from_base": np.eye(4).ravel().tolist(),
        }
        if control.grasps and robot.grips:
            state["held"] = control.grasps
        return state
