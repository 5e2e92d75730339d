"""Placements and motions, and what is known of them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, overload

import numpy as np
from numpy.typing import NDArray

from ._json import object_id
from .errors import InvalidArgument

__all__ = ["RELATIONS", "Goal", "GoalTerm", "MotionPlan", "Phase", "Placement", "Plan", "Taken"]

#: The relations, in the order of every relation vector.
RELATIONS = ("left_of", "right_of", "in_front_of", "behind", "above", "below", "near", "touching", "centered", "aligned")

#: A term: ``("left_of", 3)``, ``("not", "near", 4)``, ``"left_of:3"`` or ``"not:near:4"``.
GoalTerm: TypeAlias = str | tuple[str, int] | tuple[Literal["not"], str, int]
#: Terms that must all hold.
Goal: TypeAlias = Sequence[GoalTerm]


def goal_terms(goal: Goal) -> list[dict[str, Any]]:
    """Return the terms as they travel."""
    if isinstance(goal, str):
        raise InvalidArgument(f"expected a list of terms, got {goal!r}", "goal")
    return [_term(term, f"goal[{i}]") for i, term in enumerate(goal)]


def _term(term: GoalTerm, field: str) -> dict[str, Any]:
    parts: list[Any] = list(term.split(":")) if isinstance(term, str) else list(term)
    holds = not (len(parts) == 3 and parts[0] == "not")
    if not holds:
        parts = parts[1:]
    if len(parts) != 2:
        raise InvalidArgument(f'expected ("left_of", 3) or ("not", "near", 4), got {term!r}', field)
    relation, anchor = parts
    if relation not in RELATIONS:
        raise InvalidArgument(f"unknown relation {relation!r}; the relations are {', '.join(RELATIONS)}", field)
    return {"relation": relation, "anchor": object_id(anchor, f"{field}.anchor"), "holds": holds}


@dataclass(frozen=True)
class Taken:
    """A phrase of a sentence and the object that it was taken to mean."""

    phrase: str
    object: int


@dataclass(frozen=True, eq=False)
class Placement:
    """One place for the object, with its evidence.

    Attributes:
        placed_from_observed: The rigid motion of world space that carries the object's observed points to the placed ones, ``[4, 4]``.
        cost: What ranked it; lower is better.
        realism: Probability that it stays; ``None`` where no model was asked.
        relations: Probability of each goal term as asked, ``[terms]``.
        holds: Whether each term holds by rule on the completed shapes, ``[terms]``.
        margins_m: By how much it does, metres (radians for ``aligned``), positive where it holds, ``[terms]``.
        support_m: How far inside its support its centre of mass is, metres; negative beyond its edge; ``None`` where nobody looked.
        clearance_m: Least distance to other objects, metres; ``None`` where nobody looked.
        data: Everything, as it travels.

    """

    placed_from_observed: NDArray[np.float64]
    cost: float
    realism: float | None
    relations: NDArray[np.float64]
    holds: NDArray[np.bool_]
    margins_m: NDArray[np.float64]
    support_m: float | None
    clearance_m: float | None
    data: dict[str, Any]

    @classmethod
    def _of(cls, data: dict[str, Any]) -> Placement:
        checks = data["geometric"]
        return cls(
            placed_from_observed=np.array(data["placed_from_observed"]).reshape(4, 4),
            cost=data["cost"],
            realism=data.get("realism"),
            relations=np.array(data["relations"], dtype=np.float64),
            holds=np.array([c["holds"] for c in checks], dtype=np.bool_),
            margins_m=np.array([c["margin_m"] for c in checks], dtype=np.float64),
            support_m=data.get("support_m"),
            clearance_m=data.get("clearance_m"),
            data=data,
        )

    def apply(self, points: Any) -> NDArray[np.float64]:
        """Carry points of the object, world frame, metres, ``[n, 3]``, to where they are after the placement."""
        rotation, translation = self.placed_from_observed[:3, :3], self.placed_from_observed[:3, 3]
        return np.asarray(np.asarray(points, dtype=np.float64) @ rotation.T + translation)


class Plan(Sequence[Placement]):
    """Ranked placements, best first; empty when there is none, with what rejected the candidates."""

    def __init__(self, text: str, taken: Sequence[Taken] = ()) -> None:
        """Read a result from its JSON (see `json`)."""
        self.json = text
        self.data: dict[str, Any] = json.loads(text)
        self.taken = list(taken)
        self._placements = [Placement._of(p) for p in self.data["placements"]]

    json: str
    """The ``PlaceResult`` as ``repose plan --json`` prints it."""
    data: dict[str, Any]
    """The same, read."""
    taken: list[Taken]
    """How the words of ``say`` were taken."""

    @property
    def outcome(self) -> str:
        """``found``, ``none``, or ``partial`` when time ended early."""
        return str(self.data["outcome"])

    @property
    def query(self) -> int:
        """The object to move."""
        return int(self.data["query"])

    @property
    def goal(self) -> list[str]:
        """The terms, each as ``left_of:3`` or ``not:near:4``."""
        return [f"{'' if t['holds'] else 'not:'}{t['relation']}:{t['anchor']}" for t in self.data["goal"]]

    @property
    def rejections(self) -> dict[str, int]:
        """What rejected candidates, and how many."""
        return dict(self.data["rejections"])

    @property
    def relaxation(self) -> dict[str, Any] | None:
        """The term whose removal would have admitted most candidates, and how many; where nothing was found."""
        relaxation: dict[str, Any] | None = self.data.get("relaxation")
        return relaxation

    @property
    def transforms(self) -> NDArray[np.float64]:
        """``placed_from_observed`` of every placement, ``[n, 4, 4]``."""
        return np.array([p.placed_from_observed for p in self._placements]).reshape(-1, 4, 4)

    @overload
    def __getitem__(self, index: int) -> Placement: ...
    @overload
    def __getitem__(self, index: slice) -> list[Placement]: ...
    def __getitem__(self, index: int | slice) -> Placement | list[Placement]:
        return self._placements[index]

    def __len__(self) -> int:
        return len(self._placements)

    def __iter__(self) -> Iterator[Placement]:
        return iter(self._placements)

    def __repr__(self) -> str:
        return f"<Plan: object {self.query} to {', '.join(self.goal)}: {self.outcome}, {len(self)} placements>"


@dataclass(frozen=True, eq=False)
class Phase:
    """One stretch of a motion: the gripper acts first, then the arm follows the set-points.

    Attributes:
        name: ``standoff``, ``approach``, ``grasp``, ``lift``, ``transfer``, ``lower``, ``release`` or ``retreat``.
        gripper: What the gripper does before the arm moves, as it travels; ``None`` for nothing.
        times_s: Times of the set-points from the phase's start, seconds, ``[n]``.
        joints_rad: Joint positions, radians, ``[n, 7]``.
        velocities_rad_s: Joint velocities, radians a second, ``[n, 7]``.

    """

    name: str
    gripper: Any
    times_s: NDArray[np.float64]
    joints_rad: NDArray[np.float64]
    velocities_rad_s: NDArray[np.float64]


class MotionPlan:
    """A complete, timed pick and place."""

    def __init__(self, text: str) -> None:
        """Read a plan from its JSON (see `json`)."""
        self.json = text
        self.data: dict[str, Any] = json.loads(text)

    json: str
    """The plan as it travels; `Client.execute` sends it back unchanged."""
    data: dict[str, Any]
    """The same, read."""

    @property
    def placement(self) -> int:
        """Which of the placements it carries out, from 0."""
        return int(self.data["placement"])

    @property
    def not_chosen(self) -> list[dict[str, Any]]:
        """Why not the better ones: ``placement``, ``reason``, ``detail``."""
        return list(self.data["not_chosen"])

    @property
    def heeded(self) -> str | None:
        """How much it heeds of the hidden parts of things: ``"obstacles"`` or ``"held"``; none where that is everything, or not said."""
        return self.data.get("heeded")

    @property
    def duration_s(self) -> float:
        """Length of the whole motion, seconds."""
        return float(self.data["duration_ms"]) / 1e3

    @property
    def world_from_tcp(self) -> NDArray[np.float64]:
        """The grasp: pose of the point between the fingertips on the observed object, ``[4, 4]``; z is the approach, y the opening."""
        return np.array(self.data["grasp"]["world_from_tcp"]).reshape(4, 4)

    @property
    def phases(self) -> list[Phase]:
        """The phases, in order."""
        return [_phase(p) for p in self.data["phases"]]

    def __repr__(self) -> str:
        return f"<MotionPlan: object {self.data['query']}, placement {self.placement}, {self.duration_s:.1f} s>"


def _phase(data: dict[str, Any]) -> Phase:
    points = data["set_points"]
    return Phase(
        name=data["name"],
        gripper=data.get("gripper"),
        times_s=np.array([p["t_ms"] for p in points], dtype=np.float64) / 1e3,
        joints_rad=np.array([p["q_rad"] for p in points], dtype=np.float64).reshape(-1, 7),
        velocities_rad_s=np.array([p["dq_rad_s"] for p in points], dtype=np.float64).reshape(-1, 7),
    )
