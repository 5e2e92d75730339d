"""Where can an object be set down so that the goal holds and it stays? Placement planning for robots.

In this process, from a depth image, in three lines::

    scene = repose.Scene.from_rgbd(depth, K, color)
    plan = repose.plan(scene, move=2, goal=[("left_of", 3)])
    plan[0].placed_from_observed          # the motion of the object, [4, 4], world frame

On a running system (``repose up``), with the same arguments and answers::

    with repose.connect("tcp/127.0.0.1:7447") as client:
        plan = client.place(move=2, goal=[("left_of", 3)])

A robot or a camera of your own joins a running system with `repose.driver`.

Lengths are metres, angles radians. The world frame has z up; the camera's has x right, y down, z forward. ``left_of``, ``in_front_of`` and
so on are the viewer's: the camera's, unless a view direction is given.
"""

from . import driver
from .calls import Answer, Call, Execution, RobotState
from .client import AsyncClient, Client, connect, connect_async
from .errors import (
    Cancelled,
    DeadlineExceeded,
    FailedPrecondition,
    InternalError,
    InvalidArgument,
    NotFound,
    ReposeError,
    ResourceExhausted,
    Unavailable,
    Unclear,
)
from .frame import Frame
from .local import Models, PairRelations, Scores, picture, plan, plan_motion, relations, score, understand
from .placements import RELATIONS, MotionPlan, Phase, Placement, Plan, Taken
from .scene import Scene, SceneObject, Surface

__all__ = [
    "RELATIONS",
    "Answer",
    "AsyncClient",
    "Call",
    "Cancelled",
    "Client",
    "DeadlineExceeded",
    "Execution",
    "FailedPrecondition",
    "Frame",
    "InternalError",
    "InvalidArgument",
    "Models",
    "MotionPlan",
    "NotFound",
    "PairRelations",
    "Phase",
    "Placement",
    "Plan",
    "ReposeError",
    "ResourceExhausted",
    "RobotState",
    "Scene",
    "SceneObject",
    "Scores",
    "Surface",
    "Taken",
    "Unavailable",
    "Unclear",
    "connect",
    "connect_async",
    "driver",
    "picture",
    "plan",
    "plan_motion",
    "relations",
    "score",
    "understand",
]
