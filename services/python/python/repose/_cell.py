"""What both clients do, in steps that wait by blocking or within asyncio."""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Sequence
from typing import Any, TypeVar

from . import _native
from ._json import as_json
from ._steps import pause, threaded
from .calls import Answer, Call, Execution, RobotState
from .errors import DeadlineExceeded, InvalidArgument, NotFound, Unavailable
from .frame import Frame
from .local import motion_request, place_request, wanted
from .placements import Goal, MotionPlan, Placement, Plan, Taken
from .scene import Scene

T = TypeVar("T")

#: How long a motion may take, seconds; the longest that a call may.
LONGEST_S = 600.0
#: How long a robot may take to tell its state, seconds.
STATE_S = 5.0
#: Between two questions for what nobody has yet, and between two puts of an emergency stop, seconds.
AGAIN_S = 0.1
#: After so long, seconds, another's emergency stop that a state shows will do: a robot's side may keep showing the first.
ANOTHERS_S = 1.0


class Cell:
    """A robot cell of a running system."""

    def __init__(self, connection: _native.Connection, camera: str, robot: str) -> None:
        self.connection = connection
        self.camera = camera
        self.robot = robot

    def call(
        self,
        service: str,
        method: str,
        schema: str,
        request: dict[str, Any],
        *,
        deadline_s: float = 10.0,
        priority: str = "interactive",
        idempotent: bool = True,
        scene: Scene | None = None,
        worker: str | None = None,
        id: str | None = None,
        everyone: bool = False,
        missed: bool = False,
    ) -> Call[Answer]:
        pending = self.connection.call(
            service,
            method,
            schema,
            as_json(request, "request").encode(),
            deadline_s=deadline_s,
            priority=priority,
            idempotent=idempotent,
            scene=None if scene is None else scene._native,
            worker=worker,
            id=str(uuid.uuid4()) if missed and id is None else id,
            everyone=everyone,
            missed=missed,
        )
        return Call(pending, lambda answer: answer)

    async def workers(self, service: str) -> list[str]:
        """Return the names of a service's workers that are alive."""
        return await threaded(lambda: self.connection.workers(service))

    async def latest(self, camera: str | None = None, *, deadline_s: float = 10.0) -> dict[str, Any]:
        """Return the summary of a camera's newest scene: ``scene_id``, ``objects``, ``surfaces``, ``stamp_ns``.

        A camera that has no scene yet, and a service that is still starting, are waited for until the deadline.

        Raises:
            NotFound: The camera has no scene; ``field`` is ``camera``.
            Unavailable: No perception worker is alive in this cell.

        """
        ends = time.monotonic() + deadline_s
        request = {"camera": self.camera if camera is None else camera}
        while True:
            left_s = max(ends - time.monotonic(), 0.001)
            call = self.call("perception", "latest", "LatestRequest.v1", request, deadline_s=left_s, everyone=True)
            try:
                return dict((await call._step()).data)
            except (NotFound, Unavailable):
                if time.monotonic() + AGAIN_S >= ends:
                    raise
            await pause(AGAIN_S)

    async def scene(self, scene_id: str | None = None, *, camera: str | None = None, deadline_s: float = 10.0) -> Scene:
        """Return a scene, whole: by its id, or a camera's newest."""
        ends = time.monotonic() + deadline_s
        found = scene_id or str((await self.latest(camera, deadline_s=deadline_s))["scene_id"])
        left_s = max(ends - time.monotonic(), 0.001)
        call = Call(self.connection.scene(found, left_s), lambda answer: answer.content)
        return Scene.from_bytes(await call._step())

    async def segment(self, frame: Frame, *, deadline_s: float = 10.0) -> Scene:
        """Have perception segment a picture. The scene is then held there under its id."""
        call = Call(self.connection.segment(frame._native, deadline_s), lambda answer: answer.content)
        return Scene.from_bytes(await call._step())

    async def place_call(
        self,
        /,
        scene: Scene | str | None = None,
        move: int | None = None,
        goal: Goal | None = None,
        *,
        say: str | None = None,
        deadline_s: float = 60.0,
        priority: str = "interactive",
        camera: str | None = None,
        **options: Any,
    ) -> Call[Plan]:
        """Start `place`, to follow its progress or cancel it: returns a `repose.Call`."""
        ends = time.monotonic() + deadline_s
        if say is not None and not isinstance(scene, Scene):
            scene = await self.scene(scene, camera=camera, deadline_s=deadline_s)
        elif scene is None:
            scene = str((await self.latest(camera, deadline_s=deadline_s))["scene_id"])
        whole: Scene | None = None
        taken: list[Taken] = []
        if isinstance(scene, Scene):
            whole, scene_id = scene, scene.id
            move, goal, taken = wanted(scene, move, goal, say, options.get("view_yaw_rad"))
        elif move is None or goal is None:
            raise InvalidArgument("give move and goal, or say", "move" if move is None else "goal")
        else:
            scene_id = scene
        request = place_request(scene_id, move, goal, options)
        left_s = _left_s(deadline_s, ends)
        call = self.call("planner", "place", "PlaceRequest.v1", request, deadline_s=left_s, priority=priority, scene=whole)
        return call._read_as(lambda answer: Plan(answer.content.decode(), taken))

    async def place(
        self,
        /,
        scene: Scene | str | None = None,
        move: int | None = None,
        goal: Goal | None = None,
        *,
        say: str | None = None,
        deadline_s: float = 60.0,
        priority: str = "interactive",
        camera: str | None = None,
        **options: Any,
    ) -> Plan:
        """Ask a planner for placements.

        Args:
            scene: A scene (sent whole to a planner that lacks it), its id, or nothing for the newest of ``camera``.
            move: The object to move, by id.
            goal: Terms that must all hold, as for `repose.plan`.
            say: Both in words instead, as for `repose.plan`.
            deadline_s: When the answer must be there, seconds from now.
            priority: ``interactive``, or ``batch`` for what may wait.
            camera: The camera whose newest scene is meant where ``scene`` is not given.
            options: The options of `repose.plan`.

        Raises:
            ReposeError: The typed error that the call ended in. No placement is no error: the plan is empty then.

        """
        call = await self.place_call(scene, move, goal, say=say, deadline_s=deadline_s, priority=priority, camera=camera, **options)
        return await call._step()

    async def plan_motion(
        self,
        scene: Scene,
        placements: Plan | Sequence[Placement] | Any,
        start_joints_rad: Any = None,
        *,
        move: int | None = None,
        robot: str | None = None,
        grasps: list[dict[str, Any]] | None = None,
        seed: int = 0,
        deadline_s: float = 60.0,
    ) -> MotionPlan:
        """Plan the pick and place, from where the robot is unless ``start_joints_rad`` says otherwise; see `repose.plan_motion`."""
        ends = time.monotonic() + deadline_s
        robot = self.robot if robot is None else robot
        if start_joints_rad is None:
            start_joints_rad = (await self.robot_state(robot, timeout_s=min(deadline_s, STATE_S))).joints_rad
        request = motion_request(scene.id, placements, start_joints_rad, move, robot, grasps, seed)
        left_s = _left_s(deadline_s, ends)
        call = self.call("motion", "plan", "MotionPlanRequest.v1", request, deadline_s=left_s, scene=scene)
        return MotionPlan((await call._step()).content.decode())

    async def execute_call(self, plan: MotionPlan) -> Call[Execution]:
        """Start `execute`, to follow its progress; cancelling it brings the robot to rest on its path: returns a `repose.Call`."""
        call = self.call("motion", "execute", "MotionPlan.v1", plan.data, deadline_s=LONGEST_S, idempotent=False, missed=True)
        return call._read_as(_execution)

    async def execute(self, plan: MotionPlan) -> Execution:
        """Have the robot carry a plan out. It moves.

        Where this process dies meanwhile the robot comes to rest on its path (unless ``[motion] on_client_loss`` says otherwise).

        Raises:
            FailedPrecondition: The robot is stopped, moves, or is not where the plan starts; the scene is too old.

        """
        return await (await self.execute_call(plan))._step()

    async def recover(self, move: str, *, robot: str | None = None, scene: Scene | None = None) -> Execution:
        """Bring an arm back after a stop, slowly. It moves.

        Args:
            move: ``open`` the fingers, ``retreat`` along them, or go ``home``.
            robot: The robot.
            scene: What the way is checked against; without it the arm alone is.

        """
        request: dict[str, Any] = {"robot": self.robot if robot is None else robot, "move": move}
        if scene is not None:
            request["scene"] = {"scene_id": scene.id}
        call = self.call(
            "motion", "recover", "RecoverRequest.v1", request, deadline_s=LONGEST_S, idempotent=False, scene=scene, missed=True
        )
        return _execution(await call._step())

    async def robot_state(self, robot: str | None = None, *, timeout_s: float = STATE_S) -> RobotState:
        """Return what a robot says of itself next that can be read.

        Raises:
            Unavailable: It says no such thing within ``timeout_s``; ``field`` is ``robot``.

        """
        name = self.robot if robot is None else robot
        states = await threaded(lambda: self.connection.subscribe("robot_state", name, True))
        ends = time.monotonic() + timeout_s
        says = "does not tell its state"
        try:
            while time.monotonic() < ends:
                heard = await threaded(lambda: states.recv(max(ends - time.monotonic(), 0.0)))
                if heard is None:
                    break
                state = RobotState._if_readable(heard[2])
                if state is not None:
                    return state
                says = "tells no state that can be read"
        finally:
            states.close()
        raise Unavailable(f"robot {name} {says}", "robot")

    async def stop(self, robot: str | None = None, reason: str = "asked for", *, timeout_s: float = 5.0) -> RobotState:
        """Stop a robot in an emergency. The stop latches until `reset`. It is repeated until the robot shows it.

        Raises:
            DeadlineExceeded: The robot has not shown the stop within ``timeout_s``. It was sent all the same.

        """
        name = self.robot if robot is None else robot
        stop = {"v": 1, "id": str(uuid.uuid4()), "source": "python", "reason": reason, "stamp_ns": time.time_ns()}
        body = json.dumps(stop).encode()
        began = time.monotonic()
        ends = began + timeout_s
        # Within asyncio, too, not by a thread: there may be none free.
        self.connection.put("robot_estop", name, "EmergencyStop.v1", body)
        states = await threaded(lambda: self.connection.subscribe("robot_state", name, True))
        try:
            while time.monotonic() < ends:
                heard = await threaded(lambda: states.recv(AGAIN_S))
                # What cannot be read shows nothing.
                state = None if heard is None else RobotState._if_readable(heard[2])
                shown = None if state is None or state.stop is None else state.stop.get("estop_id")
                # Another's stop does not do at first: whoever clears that does not know of this one.
                holds = shown == stop["id"] or (shown is not None and time.monotonic() - began > ANOTHERS_S)
                if state is not None and holds:
                    return state
                self.connection.put("robot_estop", name, "EmergencyStop.v1", body)
        finally:
            states.close()
        raise DeadlineExceeded(f"robot {name} has not shown the stop within {timeout_s} s; it was sent", "robot")

    async def reset(self, robot: str | None = None, *, shown: RobotState | None = None) -> bool:
        """Clear the stop that a robot shows, and none that latches meanwhile; whether it showed one.

        Args:
            robot: The robot.
            shown: The state whose stop is cleared, for whoever has looked at it before. Without it, what the robot says of itself next.

        Raises:
            FailedPrecondition: Another stop has latched, or the stop does not clear in time.
            Unavailable: The robot does not tell its state, or no motion worker is alive.

        """
        name = self.robot if robot is None else robot
        state = await self.robot_state(name) if shown is None else shown
        # Asked without a stop, motion clears whichever is latched by then: one that this state does not show.
        if state.mode != "stopped":
            return False
        request: dict[str, Any] = {"robot": name} if state.stop is None else {"robot": name, "stop": state.stop}
        call = self.call("motion", "reset", "RobotResetRequest.v1", request, idempotent=False)
        return bool((await call._step()).data["was_stopped"])


def _execution(answer: Answer) -> Execution:
    return Execution(answer.data["outcome"], answer.data.get("reason"), answer.data)


def _left_s(deadline_s: float, ends: float) -> float:
    """Return what is left of a deadline, seconds; one that is not positive is left for the call to refuse."""
    return max(ends - time.monotonic(), 0.001) if deadline_s > 0 else deadline_s
