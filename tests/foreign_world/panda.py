"""PyBullet's Panda: motors that hold joint positions, and a hand whose fingers are geared to each other.

The description is the one that comes with PyBullet (`pybullet_data/franka_panda`), with its own masses, collision shapes and finger pads.
"""

import math
import os

import pybullet
import pybullet_data

from .control import LOWER_RAD, READY_RAD, UPPER_RAD

ARM_JOINTS = tuple(range(7))
FINGER_JOINTS = (9, 10)
HAND_LINK = 8
# Franka's torques, N m.
TORQUES = (87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0)
FINGER_SPEED_M_S = 0.05
WIDTH_MAX_M = 0.08
FORCE_MAX_N = 70.0
# A closed gripper and one on a sheet of paper are the same.
HOLDING_M = 0.002
STANDS_M_S = 0.002
STANDS_FOR_S = 0.05


class Panda:
    """The arm on its base at the world's origin, the hand open."""

    def __init__(self, client, q_rad, step_s):
        self.client, self.step_s = client, step_s
        path = os.path.join(pybullet_data.getDataPath(), "franka_panda", "panda.urdf")
        self.body = client.loadURDF(path, useFixedBase=True)
        for joint, q in zip(ARM_JOINTS, q_rad):
            client.resetJointState(self.body, joint, q)
        for joint in FINGER_JOINTS:
            client.resetJointState(self.body, joint, WIDTH_MAX_M / 2)
        left, right = FINGER_JOINTS
        gear = client.createConstraint(self.body, left, self.body, right, pybullet.JOINT_GEAR, [1, 0, 0], [0, 0, 0], [0, 0, 0])
        client.changeConstraint(gear, gearRatio=-1, erp=0.1, maxForce=50)
        self.goal_m = self.target_m = WIDTH_MAX_M / 2
        self.force_n = FORCE_MAX_N
        self.stood_s = 0.0
        self.width_m = WIDTH_MAX_M
        self.measured_rad = list(q_rad)
        self.measured_rad_s = [0.0] * 7

    def grip(self, command):
        """Starts a gripper action, from where the fingers are."""
        self.target_m = self.width_m / 2
        self.goal_m = min(max(command["width_m"], 0.0), WIDTH_MAX_M) / 2
        self.force_n = min(max(command["force_n"], 1.0), FORCE_MAX_N)
        self.stood_s = 0.0

    def before_step(self, position_rad, velocity_rad_s):
        """Sets the motors for the next step."""
        client = self.client
        client.setJointMotorControlArray(
            self.body,
            ARM_JOINTS,
            pybullet.POSITION_CONTROL,
            targetPositions=position_rad,
            targetVelocities=velocity_rad_s,
            forces=TORQUES,
            positionGains=[1.0] * 7,
            velocityGains=[1.0] * 7,
        )
        reach = FINGER_SPEED_M_S * self.step_s
        self.target_m += min(max(self.goal_m - self.target_m, -reach), reach)
        for joint in FINGER_JOINTS:
            client.setJointMotorControl2(
                self.body, joint, pybullet.POSITION_CONTROL, self.target_m, force=self.force_n, maxVelocity=FINGER_SPEED_M_S
            )

    def after_step(self):
        """Reads the joints."""
        states = self.client.getJointStates(self.body, ARM_JOINTS + FINGER_JOINTS)
        self.measured_rad = [s[0] for s in states[:7]]
        self.measured_rad_s = [s[1] for s in states[:7]]
        width_m = states[7][0] + states[8][0]
        still = abs(width_m - self.width_m) < 2 * STANDS_M_S * self.step_s
        self.stood_s = self.stood_s + self.step_s if still else 0.0
        self.width_m = width_m

    @property
    def settled(self):
        return self.target_m == self.goal_m and self.stood_s >= STANDS_FOR_S

    @property
    def grips(self):
        """Whether the fingers press on something; they may still tremble."""
        return self.target_m == self.goal_m and self.width_m > 2 * self.goal_m + HOLDING_M

    def tcp(self):
        """Position (metres) and orientation (xyzw) of the point between the fingertips."""
        state = self.client.getLinkState(self.body, HAND_LINK, computeForwardKinematics=True)
        return self.client.multiplyTransforms(state[4], state[5], [0, 0, 0.1034], [0, 0, 0, 1])

    def reaches(self, place_m, yaw_rad, tolerance_m=0.005):
        """Whether the hand, pointing straight down and turned by a yaw, gets to a place: by PyBullet's own inverse kinematics."""
        client = self.client
        down = client.getQuaternionFromEuler([math.pi, 0, yaw_rad])
        hand, _ = client.multiplyTransforms(place_m, down, [0, 0, -0.1034], [0, 0, 0, 1])
        saved = [client.getJointState(self.body, j)[0] for j in ARM_JOINTS]
        for joint, q in zip(ARM_JOINTS, READY_RAD):
            client.resetJointState(self.body, joint, q)
        low, high = [*LOWER_RAD, 0, 0], [*UPPER_RAD, 0.04, 0.04]
        limits = {"lowerLimits": low, "upperLimits": high, "jointRanges": [b - a for a, b in zip(low, high)]}
        rest = {"restPoses": [*READY_RAD, 0.04, 0.04], "maxNumIterations": 200, "residualThreshold": 1e-4}
        q_rad = client.calculateInverseKinematics(self.body, HAND_LINK, hand, down, **limits, **rest)[:7]
        inside = all(low <= q <= high for low, q, high in zip(LOWER_RAD, q_rad, UPPER_RAD))
        for joint, q in zip(ARM_JOINTS, q_rad):
            client.resetJointState(self.body, joint, q)
        there = client.getLinkState(self.body, HAND_LINK, computeForwardKinematics=True)[4]
        for joint, q in zip(ARM_JOINTS, saved):
            client.resetJointState(self.body, joint, q)
        return inside and math.dist(there, hand) <= tolerance_m
