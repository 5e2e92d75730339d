"""The foreign world itself: its robot keeps the contract's rules, its grasps hold by friction, its pictures are true."""

import json
import math
import os
import sys
import time

import numpy as np
import pytest

from foreign_world import camera, deployment, grasps, objects, scenes, trial
from foreign_world.cell import Cell
from foreign_world.control import READY_RAD, ArmControl
from foreign_world.world import STEP_S, World

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
sys.path.insert(0, os.path.join(ROOT, "scripts"))
import graspnet  # noqa: E402


def swing(delta_rad, span_ms, period_ms=10):
    """Set-points that carry the first joint from the ready pose over an angle and back to rest, smoothly."""
    points = []
    for k in range(round(span_ms / period_ms) + 1):
        s = k * period_ms / span_ms
        q, dq = list(READY_RAD), [0.0] * 7
        q[0] += delta_rad * s**3 * (10 - 15 * s + 6 * s * s)
        dq[0] = delta_rad * 30 * s * s * (1 - s) ** 2 / (span_ms * 1e-3)
        points.append({"t_ms": k * period_ms, "q_rad": q, "dq_rad_s": dq})
    return points


def command(seq, epoch=1, **fields):
    return {"v": 1, "seq": seq, "owner": {"id": "motion-1", "epoch": epoch}, "ttl_ms": 500, **fields}


def stream(points, ends=True):
    return {"starts_stream": True, "ends_stream": ends, "set_points": points}


def run(arm, ticks, now_s=0.0):
    for _ in range(ticks):
        arm.tick(now_s)


def test_a_stream_within_the_limits_is_followed_to_its_end():
    arm = ArmControl()
    assert arm.command(command(1, **stream(swing(0.5, 1000))), 0, 0) is None
    assert arm.mode == "moving"
    run(arm, 1100)
    assert (arm.mode, arm.stop, arm.stream_ms) == ("idle", None, 1000)
    assert abs(arm.position_rad[0] - 0.5) < 1e-6


@pytest.mark.parametrize(
    ("points", "kind"),
    [
        (swing(2.5, 1000), "joint_velocity_limit"),
        (swing(0.3, 120), "joint_acceleration_limit"),
        (swing(2.95, 4000), "joint_position_limit"),
        ([{**p, "q_rad": [v + 0.1 for v in p["q_rad"]]} for p in swing(0.5, 1000)], "start_pose_mismatch"),
        ([], "invalid_command"),
    ],
)
def test_each_broken_rule_stops_with_its_name_and_comes_to_rest(points, kind):
    arm = ArmControl()
    arm.command(command(1, **stream(points)), 0, 0)
    run(arm, 5000)
    assert arm.stop["kind"] == kind
    assert arm.at_rest()
    assert arm.command(command(2, **stream(swing(0.1, 500))), 0, 0) == "stopped"


def test_a_commander_that_falls_silent_latches_moving_or_within_a_task():
    arm = ArmControl()
    arm.command(command(1, **stream(swing(0.8, 1000), ends=False)), 0, 0)
    run(arm, 300)
    run(arm, 600, now_s=0.6)
    assert arm.stop["kind"] == "commander_silent"
    arm = ArmControl()
    arm.command(command(1, task={"id": "t", "open": True}), 0, 0)
    run(arm, 10, now_s=0.4)
    assert arm.command(command(1), 0.4, 0.4) == "sequence number passed"
    run(arm, 10, now_s=0.8)
    assert arm.stop is None, "a repeat keeps its sender from being silent"
    run(arm, 1, now_s=1.0)
    assert arm.stop["kind"] == "commander_silent"
    assert arm.command(command(1, epoch=2, clear_stop=True, clears=arm.stop), 1, 1) is None
    assert (arm.mode, arm.task) == ("idle", None)


def test_only_the_newest_owner_commands_and_no_task_is_left_with_something_in_the_hand():
    arm = ArmControl()
    arm.command(command(5, epoch=2, task={"id": "t", "open": True}), 0, 0)
    other = {**command(6, epoch=2), "owner": {"id": "motion-2", "epoch": 2}}
    assert arm.command(other, 0, 0) == "not the owner"
    assert arm.command(command(1, epoch=3), 0, 0) == "another task is open"
    arm.grips = True
    arm.command(command(6, epoch=2, task={"id": "t", "open": False}), 0, 0)
    assert arm.stop["kind"] == "task_unfinished"


def test_whatever_is_put_on_the_stop_key_stops():
    for payload in (b"", b"{", b"[1]", b'{"id": 3}', b'{"id": "e", "source": "me", "reason": "now"}'):
        arm = ArmControl()
        arm.emergency_stop(payload)
        assert arm.stop["kind"] == "estop"


def test_a_second_stop_is_not_cleared_with_the_first():
    arm = ArmControl()
    arm.emergency_stop(b'{"id": "a", "source": "a", "reason": "now"}')
    first = arm.stop
    for again in (b'{"id": "b", "source": "b", "reason": "now"}', b'{"id": "a", "source": "a", "reason": "now"}'):
        arm.emergency_stop(again)
        assert arm.stop["estop_id"] == json.loads(again)["id"]
        assert arm.command(command(1, clear_stop=True, clears=first), 0, 0) == "another stop is latched"
    assert arm.command(command(1, clear_stop=True, clears=arm.stop), 0, 0) is None
    assert arm.mode == "idle"


def test_a_new_robot_is_stopped_for_reasons_of_its_own():
    arm = ArmControl()
    arm.emergency_stop(b'{"id": "a", "source": "a", "reason": "the last trial"}')
    arm.forget()
    assert (arm.mode, arm.task) == ("idle", None)
    arm.emergency_stop(b'{"id": "b", "source": "b", "reason": "now"}')
    assert arm.stop["reason"] == "b: now"


def test_a_program_that_prints_much_is_not_held_up_and_none_outlives_its_trial():
    much = "import sys; print('x' * 300_000); print('y' * 300_000, file=sys.stderr)"
    with trial.Asked([sys.executable, "-c", much]) as program:
        give_up = time.monotonic() + 60
        while not program.ended():
            assert time.monotonic() < give_up, "it waits for somebody to read"
            time.sleep(0.01)
        assert [len(text) for text in program.printed()] == [300_001, 300_001]
    with trial.Asked([sys.executable, "-c", "import time; time.sleep(600)"]) as program:
        assert not program.ended()
    assert program.ended()


def test_a_deployment_that_does_not_come_about_leaves_no_process(tmp_path, monkeypatch):
    monkeypatch.setattr(deployment, "LISTENS_WITHIN_S", 2.0)
    program, pid = tmp_path / "program", tmp_path / "pid"

    def started(does):
        program.write_text(f"#!/bin/sh\necho $$ > {pid}\n{does}\n", encoding="utf-8")
        program.chmod(0o755)
        return deployment.Deployment(str(program), str(tmp_path))

    with pytest.raises(TimeoutError, match="does not listen"):
        started("exec sleep 600")
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid.read_text(encoding="utf-8")), 0)
    with pytest.raises(RuntimeError, match=r"router \(3\)"):
        started("exit 3")


def test_a_world_that_cannot_keep_up_with_its_clock_listens_after_a_few_steps(monkeypatch):
    taken = []
    monkeypatch.setattr(Cell, "_step", lambda _, now: taken.append(now))
    cell = Cell.__new__(Cell)
    # Some thirty million steps are due.
    cell.time_scale, cell.behind_s, cell.stepped_to = 1e6, 0.0, time.monotonic() - 1.0
    cell._catch_up(time.monotonic())
    assert 1 <= len(taken) < 1_000_000
    assert cell.behind_s > 0.9


@pytest.fixture
def world(tmp_path):
    return World(objects.Meshes(str(tmp_path)))


def boxes(*sizes):
    made = []
    for size in sizes:
        vertices, triangles = objects._box(size)
        made.append(objects.Shape("box", 0.3, [vertices], vertices, triangles))
    return made


def furnished(world, shape, seed=0):
    """A table with one object in front of the robot."""
    rng = np.random.default_rng(seed)
    assert world.furnish("table", [shape], rng)
    assert len(world.objects) == 1


def joints_over(world, height_m):
    """The arm's joints with the hand straight down over the object, its fingers across the narrow side."""
    pose, client, robot = world.pose(0), world.client, world.robot
    x, y = pose[:2, 3]
    yaw = math.atan2(pose[1, 0], pose[0, 0])
    yaw = (yaw + math.pi / 4) % (math.pi / 2) - math.pi / 4
    down = client.getQuaternionFromEuler([math.pi, 0, yaw])
    hand, _ = client.multiplyTransforms([x, y, pose[2, 3] + height_m], down, [0, 0, -0.1034], [0, 0, 0, 1])
    for _ in range(20):
        q = client.calculateInverseKinematics(robot.body, 8, hand, down, maxNumIterations=500, residualThreshold=1e-6)
        for joint, angle in enumerate(q[:7]):
            client.resetJointState(robot.body, joint, angle)
    return list(q[:7])


def test_what_is_gripped_is_held_by_friction_and_does_not_drift(world):
    """A square box of 0.3 kg is lifted 10 cm and held for two seconds: it stays in the hand within 2 mm and a degree."""
    furnished(world, boxes((0.05, 0.05, 0.10))[0])
    arm = world.control
    at, above = joints_over(world, 0.02), joints_over(world, 0.12)
    for joint, angle in enumerate(at):
        world.client.resetJointState(world.robot.body, joint, angle)
    arm.rehome(at)
    world.robot.grip({"width_m": 0.0, "force_n": 30.0})
    for _ in range(round(1.5 / STEP_S)):
        world.step(0.0)
    assert world.robot.settled
    assert world.robot.grips
    assert abs(world.robot.width_m - 0.05) < 0.004

    def in_hand():
        place, turn = world.robot.tcp()
        inverse = world.client.invertTransform(place, turn)
        return world.client.multiplyTransforms(*inverse, *world.client.getBasePositionAndOrientation(world.objects[0]))

    before = in_hand()
    for k in range(round(4.0 / STEP_S)):
        share = min(1.0, k * STEP_S / 2.0)
        s = share**3 * (10 - 15 * share + 6 * share * share)
        arm.position_rad = [a + s * (b - a) for a, b in zip(at, above)]
        world.step(0.0)
    after = in_hand()
    assert world.pose(0)[2, 3] - world.start[0][2, 3] > 0.08
    assert math.dist(before[0], after[0]) < 0.002
    turned = world.client.getDifferenceQuaternion(before[1], after[1])
    assert 2 * math.acos(min(1.0, abs(turned[3]))) < math.radians(1)


def test_fingers_move_together_and_no_faster_than_they_may(world):
    furnished(world, boxes((0.05, 0.05, 0.10))[0])
    world.robot.grip({"width_m": 0.02, "force_n": 30.0})
    before = world.robot.width_m
    for _ in range(round(1.0 / STEP_S)):
        world.step(0.0)
        left, right = (world.client.getJointState(world.robot.body, j)[0] for j in (9, 10))
        assert abs(left - right) < 0.001
        assert before - world.robot.width_m <= 2 * 0.055 * STEP_S + 1e-6
        before = world.robot.width_m
    assert abs(world.robot.width_m - 0.02) < 0.002
    assert not world.robot.grips


def test_the_picture_shows_things_where_they_are(world):
    """True depth, unprojected by the camera that frames name, lies on the table and within a millimetre of the objects' boxes."""
    made = boxes((0.05, 0.06, 0.10), (0.04, 0.09, 0.06), (0.06, 0.06, 0.15), (0.04, 0.04, 0.08))
    assert world.furnish("table", made, np.random.default_rng(5))
    _, depth_m, labels = world.picture()
    model = world.furniture.camera.model()
    v, u = np.mgrid[: model["height"], : model["width"]]
    depth = np.where(np.isfinite(depth_m), depth_m, 0)
    points = np.dstack([(u - model["cx"]) / model["fx"] * depth, (v - model["cy"]) / model["fy"] * depth, depth])
    pose = np.reshape(model["world_from_camera"], (4, 4))
    points = points @ pose[:3, :3].T + pose[:3, 3]
    for k, placed in enumerate(world.placed):
        of = points[labels == k + 1]
        inside = (of - world.pose(k)[:3, 3]) @ world.pose(k)[:3, :3]
        assert len(of) > 100
        assert np.all(inside > placed.shape.low_m - 0.0015)
        assert np.all(inside < placed.shape.high_m + 0.0015)
    counts = camera.sensed(depth_m, np.random.default_rng(1))
    seen = (counts > 0) & (labels > 0)
    assert np.abs(counts[seen] * camera.DEPTH_UNIT_M - depth_m[seen]).mean() < 0.004
    assert (counts[labels > 0] == 0).mean() > 0.005, "edges lose readings"


def test_what_cannot_stand_falls_in_the_drop_and_what_can_does_not(world):
    world.clear()
    leaning = objects._box((0.03, 0.03, 0.2))
    foot = np.array([[x, y, -0.1] for x in (-0.002, 0.002) for y in (-0.002, 0.002)])
    spike = objects.Shape("spike", 0.2, [np.vstack([leaning[0], foot - [0, 0, 0.03]])], *leaning)
    assert scenes.stands_after_a_drop(world.client, world.meshes, boxes((0.05, 0.05, 0.1))[0], STEP_S)
    assert not scenes.stands_after_a_drop(world.client, world.meshes, spike, STEP_S)


def test_grasps_from_elsewhere_are_those_of_the_hand_and_of_the_fingers_whatever_they_are_called(world, tmp_path):
    """Poses of a hand in the camera's frame become poses between the fingertips on the object; other conventions say the same place."""
    assert world.furnish("table", boxes((0.05, 0.07, 0.10)), np.random.default_rng(2))
    document = grasps.offered(world, 0, np.random.default_rng(1))
    camera_pose = world.furniture.camera.world_from_camera
    offered = graspnet.converted(document, camera_pose)
    assert offered
    pose = world.pose(0)
    for grasp in offered:
        tcp = np.reshape(grasp["world_from_tcp"], (4, 4))
        at = (tcp[:3, 3] - pose[:3, 3]) @ pose[:3, :3]
        assert np.all(np.abs(at) < np.array([0.025, 0.035, 0.05]) + 0.002), "between the fingers is the box"
        assert tcp[2, 2] < -0.49, "from above"
    first = np.reshape(offered[0]["world_from_tcp"], (4, 4))
    # The same place as GraspNet-1Billion says it: x the approach, the fingers' ends 2 cm ahead.
    turned = np.eye(4)
    turned[:3, :3] = np.column_stack([first[:3, 2], first[:3, 1], -first[:3, 0]])
    turned[:3, 3] = first[:3, 3] - (0.02 - graspnet.TCP_TO_TIP_M) * first[:3, 2]
    told = {"frame": "world", "convention": "graspnet", "grasps": [{"pose": turned.tolist(), "score": 1, "depth_m": 0.02}]}
    assert np.allclose(np.reshape(graspnet.converted(told)[0]["world_from_tcp"], (4, 4)), first, atol=1e-9)


def test_the_example_in_the_readme_is_taken():
    with open(os.path.join(ROOT, "services", "motion", "README.md"), encoding="utf-8") as file:
        examples = [json.loads(block.split("```")[0]) for block in file.read().split("```json")[1:]]
    document = next(example for example in examples if isinstance(example, dict))
    assert len(graspnet.converted(document, np.eye(4))) == 1


def test_bad_grasps_are_refused_by_the_name_of_their_field():
    grasp = {"pose": np.eye(4).tolist(), "score": 1.0}
    good = {"frame": "world", "convention": "hand", "grasps": [grasp]}
    assert len(graspnet.converted(good)) == 1
    for change, field in [
        ({"frame": "base"}, "frame"),
        ({"frame": "camera"}, "frame"),
        ({"convention": "gripper"}, "convention"),
        ({"grasps": []}, "grasps"),
        ({"grasps": [{**grasp, "pose": (2 * np.eye(4)).tolist()}]}, r"grasps\[0\].pose"),
        ({"grasps": [{**grasp, "score": "high"}]}, r"grasps\[0\].score"),
        ({"grasps": [{**grasp, "width_m": -0.1}]}, r"grasps\[0\].width_m"),
        ({"convention": "graspnet"}, r"grasps\[0\].depth_m"),
    ]:
        with pytest.raises(graspnet.BadGrasps, match=field):
            graspnet.converted({**good, **change})
    with pytest.raises(graspnet.BadGrasps, match="expected an object"):
        graspnet.converted([grasp])
