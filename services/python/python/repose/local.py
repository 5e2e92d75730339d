"""Planning and judging in this process, without a running system."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._arrays import joint_positions, rigid_transforms
from ._json import as_json, object_id
from .errors import InvalidArgument, Unclear
from .placements import RELATIONS, Goal, MotionPlan, Placement, Plan, Taken, goal_terms
from .scene import Scene

__all__ = ["Models", "PairRelations", "Scores", "picture", "plan", "plan_motion", "relations", "score", "understand"]


class Models:
    """The learned models. Loading takes a moment: keep it. Without one, functions use a shared one, loaded at its first use.

    Args:
        weights: A weights file in place of the weights of the package; without it, what ``REPOSE_INFERENCE__WEIGHTS`` names.

    """

    def __init__(self, weights: str | PathLike[str] | None = None) -> None:
        self._native = _native.Models(weights)


def place_request(scene_id: str, move: int, goal: Goal | list[dict[str, Any]], options: dict[str, Any]) -> dict[str, Any]:
    """Return a ``PlaceRequest`` as it travels: only what is given, so that defaults are the service's."""
    terms = goal if goal and isinstance(goal[0], dict) else goal_terms(goal)  # type: ignore[arg-type]
    given = {key: value for key, value in options.items() if value is not None}
    return {"scene": {"scene_id": scene_id}, "query": object_id(move, "move"), "goal": terms, **given}


def understand(scene: Scene, say: str, view_yaw_rad: float | None = None) -> tuple[int, list[str], list[Taken]]:
    """Read a goal in words, by what the scene's objects look like.

    Returns:
        The object to move, the goal's terms, and which object each phrase was taken to be.

    Raises:
        Unclear: The sentence has no meaning that can be planned, or more than one; ``candidates`` are the objects in question.

    """
    said = json.loads(_native.understand(scene._native, say, view_yaw_rad))
    if "refused" in said:
        raise Unclear(said["refused"], said["candidates"])
    goal = [f"{'' if t['holds'] else 'not:'}{t['relation']}:{t['anchor']}" for t in said["goal"]]
    return said["query"], goal, [Taken(t["phrase"], t["object"]) for t in said["taken"]]


def plan(
    scene: Scene,
    move: int | None = None,
    goal: Goal | None = None,
    *,
    say: str | None = None,
    count: int = 1,
    seed: int = 0,
    variant: str = "best",
    rotation: str = "fixed",
    view_yaw_rad: float | None = None,
    min_separation_m: float | None = None,
    min_clearance_m: float | None = None,
    region: Sequence[dict[str, Any]] | None = None,
    budget: dict[str, Any] | None = None,
    cost_weights: dict[str, float] | None = None,
    thresholds: dict[str, float] | None = None,
    models: Models | None = None,
    **more: Any,
) -> Plan:
    """Find where an object can be set down so that the goal holds and it stays.

    The answer is that of ``repose plan`` for the same frame, byte for byte. The interpreter lock is released.

    Args:
        scene: The scene.
        move: The object to move, by id.
        goal: Terms that must all hold: ``[("left_of", 3), ("not", "near", 4)]``; at least one must not be a negation.
        say: Both in words instead: ``"put the red mug to the left of the box, not near the bowl"``.
        count: How many distinct placements are wanted.
        seed: The source of every random number: the same seed gives the same bytes.
        variant: ``best``, ``full``, ``full_lambda_1``, ``no_discriminator``, ``mean_only``, ``mdn_prior`` or ``geometric`` (no networks).
        rotation: Whether the object may be turned: ``fixed``, ``yaw``, or ``stable``, which may also set it on another side.
        view_yaw_rad: The viewer's direction about world z, 0 looks along y, radians; the camera's where it is not given (as its picture
            shows left and right where it looks steeply down).
        min_separation_m: How far apart the centroids of two placements must be, metres.
        min_clearance_m: Least distance from everything but the support, metres.
        region: Boxes to stay inside or out of: ``{"min_m": [x, y, z], "max_m": [x, y, z], "inside": True}``, world frame, metres.
        budget: Search effort: ``iterations``, ``batch``, ``elites``, ``draws_per_batch``, ``time_ms``.
        cost_weights: ``realism``, ``relations``.
        thresholds: ``realism``, ``relations``.
        models: The models to use.
        more: Other fields of a ``PlaceRequest``.

    Returns:
        Ranked placements; empty where there is none, with what rejected the candidates.

    Raises:
        InvalidArgument: A value cannot be used; ``field`` names it.
        NotFound: The scene has no such object.
        Unclear: ``say`` has no meaning that can be planned, or more than one.

    """
    move, terms, taken = wanted(scene, move, goal, say, view_yaw_rad)
    options = {
        "count": count,
        "seed": seed,
        "variant": variant,
        "rotation": rotation,
        "view_yaw_rad": view_yaw_rad,
        "min_separation_m": min_separation_m,
        "min_clearance_m": min_clearance_m,
        "region": None if region is None else list(region),
        "budget": budget,
        "cost_weights": cost_weights,
        "thresholds": thresholds,
        **more,
    }
    request = as_json(place_request(scene.id, move, terms, options), "request")
    return Plan(_native.plan(scene._native, request, _of(models)), taken)


def wanted(scene: Scene, move: int | None, goal: Goal | None, say: str | None, view_yaw_rad: float | None) -> tuple[int, Goal, list[Taken]]:
    """Return the object and the goal, given by numbers or in words."""
    if say is not None:
        if move is not None or goal is not None:
            raise InvalidArgument("give either move and goal, or say", "say")
        return understand(scene, say, view_yaw_rad)
    if move is None or goal is None:
        raise InvalidArgument("give move and goal, or say", "move" if move is None else "goal")
    return move, goal, []


@dataclass(frozen=True, eq=False)
class PairRelations:
    """What is said of one ordered pair; vectors are in the order of `RELATIONS`.

    Attributes:
        query: The object that stands in the relation.
        anchor: The object that it stands in the relation to.
        learned: Probabilities by the relation predictor, ``[10]``.
        rule: Whether each holds by rule on the observed clouds, ``[10]``.

    """

    query: int
    anchor: int
    learned: NDArray[np.float64]
    rule: NDArray[np.bool_]


def relations(scene: Scene, *, models: Models | None = None) -> list[PairRelations]:
    """Judge every ordered pair of objects, for the camera as viewer: the numbers of ``repose relations``."""
    pairs = json.loads(_native.relations(scene._native, _of(models)))["pairs"]
    return [PairRelations(p["query"], p["anchor"], np.array(p["learned"]), np.array(p["rule"], dtype=np.bool_)) for p in pairs]


@dataclass(frozen=True, eq=False)
class Scores:
    """What the networks say of n placements.

    Attributes:
        realism: Probability of realism, ``[n]``.
        relations: Probability of each relation to each anchor, ``[n, anchors, 10]``, in the order of `RELATIONS`.

    """

    realism: NDArray[np.float32]
    relations: NDArray[np.float32]


def score(
    scene: Scene,
    move: int,
    transforms: Any,
    *,
    anchors: Sequence[int] | None = None,
    realism_by: str = "discriminator",
    models: Models | None = None,
) -> Scores:
    """Ask the networks about placements of your own: the numbers of ``repose score``.

    Args:
        scene: The scene.
        move: The object that is moved.
        transforms: ``placed_from_observed`` of each placement, ``[n, 4, 4]`` or ``[4, 4]``, world frame; turns about z only.
        anchors: The objects that relations are judged to; all others where they are not given.
        realism_by: ``discriminator`` (the paper's) or ``outcome`` (learned from simulated releases).
        models: The models to use.

    """
    others = [o.id for o in scene.objects if o.id != move] if anchors is None else [object_id(a, "anchors") for a in anchors]
    matrices = rigid_transforms(transforms, "transforms")
    realism, related = _native.score(scene._native, object_id(move, "move"), others, matrices.tobytes(), realism_by, _of(models))
    of_relations = np.frombuffer(related, np.float32).reshape(len(matrices), len(others), len(RELATIONS))
    return Scores(np.frombuffer(realism, np.float32).copy(), of_relations.copy())


def motion_request(
    scene_id: str, placements: Any, start_joints_rad: Any, move: int | None, robot: str, grasps: Any, seed: int
) -> dict[str, Any]:
    """Return a ``MotionPlanRequest`` as it travels."""
    if isinstance(placements, Placement):
        placements = [placements]
    if isinstance(placements, Plan):
        move = placements.query if move is None else move
    if isinstance(placements, Sequence) and placements and all(isinstance(p, Placement) for p in placements):
        matrices = np.array([p.placed_from_observed for p in placements])
    else:
        matrices = rigid_transforms(placements, "placements") if len(placements) else np.empty((0, 4, 4))
    if move is None:
        raise InvalidArgument("which object is moved is known of a Plan only: say it", "move")
    request: dict[str, Any] = {
        "scene": {"scene_id": scene_id},
        "robot": robot,
        "query": object_id(move, "move"),
        "placements": [m.ravel().tolist() for m in matrices],
        "start_joints_rad": joint_positions(start_joints_rad, "start_joints_rad"),
        "seed": seed,
    }
    if grasps is not None:
        request["grasps"] = grasps
    return request


def plan_motion(
    scene: Scene,
    placements: Plan | Sequence[Placement] | Any,
    start_joints_rad: Any,
    *,
    move: int | None = None,
    robot: str = "panda",
    grasps: list[dict[str, Any]] | None = None,
    seed: int = 0,
) -> MotionPlan:
    """Plan the pick and place of the first placement that the arm can carry out (a Franka Panda).

    Where the robot stands and how fast it moves are configured as for the motion service, by ``REPOSE_MOTION__…`` variables.

    Args:
        scene: The scene; its camera must be calibrated (``world_from_camera`` given).
        placements: A `Plan`, some of its placements, or transforms ``[n, 4, 4]``; best first.
        start_joints_rad: Where the arm starts, radians, ``[7]``.
        move: The object that is moved; needed only where ``placements`` is no `Plan`.
        robot: The robot's name.
        grasps: Grasps of your own, best first: ``{"world_from_tcp": [16 numbers], "width_m": 0.06, "score": 1.0}``.
        seed: The source of every random number.

    Raises:
        FailedPrecondition: Nothing can be grasped, or no placement served; the message says why.

    """
    request = motion_request(scene.id, placements, start_joints_rad, move, robot, grasps, seed)
    return MotionPlan(_native.plan_motion(scene._native, as_json(request, "request")))


def picture(
    scene: Scene, plan: Plan | None = None, *, placement: Placement | None = None, move: int | None = None, by_object: bool = False
) -> NDArray[np.uint8]:
    """Draw a scene as its camera saw it, 8-bit RGB, ``[h, w, 3]``.

    Args:
        scene: The scene.
        plan: Draws before and after beside each other, as ``repose plan --out`` does.
        placement: Draws object ``move`` where this placement puts it, in green.
        move: See ``placement``.
        by_object: Colors by object, without which the colors are the camera's; with ids either way.

    """
    if plan is not None:
        return _image(_native.before_and_after(scene._native, plan.json))
    moved = None
    if placement is not None:
        if move is None:
            raise InvalidArgument("say which object the placement moves", "move")
        moved = (object_id(move, "move"), placement.placed_from_observed.ravel().tolist())
    return _image(_native.picture(scene._native, by_object, placement is None, moved))


def _image(drawn: tuple[int, int, bytes]) -> NDArray[np.uint8]:
    width, height, data = drawn
    # A copy can be drawn on.
    return np.frombuffer(data, np.uint8).reshape(height, width, 3).copy()


def _of(models: Models | None) -> _native.Models | None:
    return None if models is None else models._native
