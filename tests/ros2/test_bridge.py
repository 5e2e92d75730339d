"""`repose serve ros2` between Repose's services and a ROS 2 system of the tests' own."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time

import zenoh
from mocks import CANCELED, READY_RAD, Camera
from programs import REPOSE
from system import DOMAIN, Seen, counts, until


@contextlib.contextmanager
def delays(programs):
    """How long after its stamp each frame comes on the cell's key from now on, milliseconds."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([programs.cell]))
    session, found = zenoh.open(config), []

    def came(sample):
        bulk = sample.payload.to_bytes()
        header = json.loads(bulk[8 : 8 + int.from_bytes(bulk[:8], "little")])
        found.append((time.time_ns() - int(header["__metadata__"]["stamp_ns"])) / 1e6)

    # An open session's threads would keep the test's process from ending.
    with session, session.declare_subscriber("repose/v1/*/camera/front/frame", came):
        yield found


def test_others_see_its_topics_and_services_and_call_them(programs, system):
    """By a kit that shares no code with this one, in a process of its own."""
    port = programs.ros.rsplit(":", 1)[1]
    program = f"""
import json
from zenoh_ros2_sdk import ROS2ServiceClient, get_service_names_and_types, get_topic_names_and_types
where = {{"domain_id": {DOMAIN}, "router_ip": "127.0.0.1", "router_port": {port}}}
topics, services = get_topic_names_and_types(**where), get_service_names_and_types(**where)
client = ROS2ServiceClient("/repose/stop", "std_srvs/srv/Trigger", request_definition="# nothing", timeout=10.0,
    response_definition="bool success\\nstring message\\n", **where)
answer = client.call()
print(json.dumps([str(topics), str(services), answer.success, answer.message]))
"""
    until("the bridge is there", lambda: "joined the ROS 2 system" in programs.log("ros2"))
    time.sleep(2)
    environment = {**os.environ, "ZENOH_CONFIG_OVERRIDE": 'mode="client"'}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=90, env=environment)
    assert done.returncode == 0, done.stderr
    topics, services, success, message = json.loads(done.stdout.splitlines()[-1])
    for topic in ("/diagnostics", "/repose/front/detections", "/repose/front/markers", "/repose/front/points", "/repose/placements"):
        assert topic in topics
    for service in ("/repose/stop", "/repose/place", "/repose/plan"):
        assert service in services
    # There is no arm yet to show that it stopped.
    assert not success and "panda" in message


def test_pictures_of_a_wrong_type_are_told_and_right_ones_become_scenes_at_15_a_second(programs, system, scene, diagnostics):
    system.show("MP", "/cam/depth/image_rect", "sensor_msgs/msg/PointCloud2")
    until("a warning", lambda: "expected sensor_msgs/msg/Image" in programs.log("ros2"))
    # In every report for as long as it is so, and not only in the first.
    reports = len(diagnostics.messages) + 1
    told = diagnostics.after(reports + 2) and diagnostics.messages[reports:]
    assert all(any(s.hardware_id == "front" and "expected sensor_msgs" in s.message for s in m.status) for m in told)
    detections = Seen(system, "/repose/front/detections", "vision_msgs/msg/Detection3DArray")
    clouds = Seen(system, "/repose/front/points", "sensor_msgs/msg/PointCloud2")
    markers = Seen(system, "/repose/front/markers", "visualization_msgs/msg/MarkerArray")
    camera = Camera(system, scene, rate=15)
    found = detections.after(0)
    assert found.header.frame_id == "world" and len(found.detections) >= 3
    # Each true object's centre is within one of the boxes that were found.
    inside = [
        any(
            all(abs(getattr(d.bbox.center.position, a) - c) <= getattr(d.bbox.size, a) / 2 + 0.02 for a, c in zip("xyz", centre))
            for d in found.detections
        )
        for centre in scene.centroids_m
    ]
    assert sum(inside) >= len(inside) - 1, inside
    cloud = clouds.after(0)
    assert [f.name for f in cloud.fields] == ["x", "y", "z", "rgb", "label"] and cloud.width > 1000
    assert len(markers.after(0).markers) == 1 + 2 * len(found.detections)
    # A machine that others use may stand still for a while: the best of three.
    for _ in range(3):
        with delays(programs) as delays_ms:
            time.sleep(2)
            before, sent = counts(diagnostics, "front").get("frames", 0), camera.sent
            time.sleep(8)
        told = counts(diagnostics, "front")
        frames, sent = told["frames"] - before, camera.sent - sent
        ordered = sorted(delays_ms)
        middle, late = (ordered[int(len(ordered) * share)] for share in (0.5, 0.95))
        print(f"{sent} pictures sent in 8 s, {frames} frames; from stamp to frame {middle:.1f} ms (p95 {late:.1f} ms); {told}")
        # Reports come once a second.
        if keeps_up := frames >= 0.8 * sent - 15:
            break
    assert keeps_up, f"{frames} of {sent}"
    camera.close()


def test_a_bridge_that_begins_anew_hears_where_the_camera_stands_and_goes_on(programs, system, scene):
    detections = Seen(system, "/repose/front/detections", "vision_msgs/msg/Detection3DArray")
    camera = Camera(system, scene, rate=5, static=False)
    detections.after(0)
    programs.end("ros2", signal.SIGKILL)
    count = len(detections.messages)
    programs.service("ros2")
    detections.after(count + 1)
    camera.close()


def test_ten_pick_and_places_by_a_client_of_ros(programs, system, camera, arm, diagnostics):
    detections = Seen(system, "/repose/front/detections", "vision_msgs/msg/Detection3DArray")
    ids = [int(d.id) for d in detections.after(0).detections]
    until("the arm is known", lambda: "standing" in str(diagnostics.messages[-1:]) or None)
    done, tried, why, held_up = 0, 0, [], 0
    pairs = [(a, b, r) for r in ("left_of", "right_of", "behind", "in_front_of") for a in ids for b in ids if a != b]
    for seed, (moved, anchor, relation) in enumerate(pairs):
        goals = len(arm.arm.goals)
        wish = {"camera": "front", "object": moved, "goal": [f"{relation}:{anchor}"], "seed": seed, "execute": True}
        answer = system.call("/repose/plan", "repose_msgs/srv/Plan", timeout=120.0, **wish)
        assert answer is not None, "no answer"
        tried += 1
        if answer.success:
            done += 1
            assert answer.executed and answer.phases[0] == "standoff" and len(answer.trajectory.points) > 100
            # Every phase in which the arm moves is one trajectory.
            assert len(arm.arm.goals) - goals == 6 + answer.phases.count("home")
        else:
            why.append((wish["object"], wish["goal"], answer.code, answer.message))
            stop = (programs.robot_state() or {}).get("stop")
            # The arm and its controllers are this process: where that waits for a core they are silent, which stops the arm.
            # Three times is no chance.
            if stop and stop["kind"] in ("joint_states_silent", "controller_silent"):
                held_up += 1
                assert held_up <= 2, why
                for action in ("reset", "open", "home"):
                    programs.robot(action)
        if done == 10:
            break
    print(f"{done} of {tried} carried out; not: {why}")
    assert done == 10, why


def test_a_place_is_answered_and_a_bad_wish_is_refused_by_name(system, camera, arm):
    detections = Seen(system, "/repose/front/detections", "vision_msgs/msg/Detection3DArray")
    first, second = (int(d.id) for d in detections.after(0).detections[:2])
    placements = Seen(system, "/repose/placements", "geometry_msgs/msg/PoseArray")
    wish = {"object": first, "goal": [f"left_of:{second}"], "count": 2}
    answer = system.call("/repose/place", "repose_msgs/srv/Place", **wish)
    assert answer.success == bool(answer.poses) and answer.code in ("", "none")
    assert len(placements.after(0).poses) == len(answer.poses)
    for bad, field in ((["beside:1"], "relation"), ([f"left_of:{first}"], "goal")):
        refused = system.call("/repose/place", "repose_msgs/srv/Place", object=first, goal=bad)
        assert not refused.success and refused.code == "invalid_argument" and field in refused.message, refused


def stand_aside(programs, arm, by_rad=0.6):
    """An arm that has a way home to go."""
    arm.q_rad = [READY_RAD[0] + by_rad, *READY_RAD[1:]]

    def is_heard_of():
        # Where it stands a few milliradians from where it was set, the bridge holds on to that.
        state = programs.robot_state()
        return state and abs(state["q_rad"][0] - arm.q_rad[0]) < 0.01

    until("the bridge has heard of it", is_heard_of)


def test_a_stop_of_a_client_cancels_the_goal_and_latches(programs, system, camera, arm, diagnostics):
    until("the arm is known", lambda: "standing" in str(diagnostics.messages[-1:]) or None)
    stand_aside(programs, arm)
    goals = len(arm.arm.goals)
    command = [REPOSE, "robot", "home", "--connect", programs.cell]
    moving = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    until("the arm moves", lambda: len(arm.arm.goals) > goals or None)
    time.sleep(0.3)
    stopped = system.call("/repose/stop", "std_srvs/srv/Trigger")
    assert stopped.success, stopped.message
    assert moving.wait(30) != 0
    until("the goal ended", lambda: all(event.is_set() for event in arm.arm.ended.values()) or None)
    assert [event.outcome[0] for event in arm.arm.ended.values()][-1] == CANCELED
    until("a fault is shown", lambda: "client called the stop service" in str(diagnostics.messages[-1:]) or None)
    programs.robot("reset")
    until("it stands again", lambda: "standing" in str(diagnostics.messages[-1:]) or None)


def test_a_controller_that_aborts_or_refuses_latches_a_stop_with_its_words(programs, system, camera, arm, diagnostics):
    home = [REPOSE, "robot", "home", "--connect", programs.cell]
    for fault, word in (("refuse", "refused the goal"), ("stall", "a path tolerance was violated")):
        stand_aside(programs, arm)
        setattr(arm, fault, True)
        assert subprocess.run(home, capture_output=True, timeout=60).returncode != 0
        until(f"{word} is shown", lambda: word in str(diagnostics.messages[-1:]) or None)
        setattr(arm, fault, False)
        programs.robot("reset")
    programs.robot("home")


def test_a_bridge_that_ends_or_is_killed_leaves_no_arm_moving(programs, system, camera, arm, diagnostics):
    """The controller has the way whole: the bridge cancels it before it ends, and one that comes after a dead one before it does anything."""
    home, reset = ([REPOSE, "robot", what, "--connect", programs.cell] for what in ("home", "reset"))
    for how in (signal.SIGTERM, signal.SIGKILL):
        until("the arm is known", lambda: "standing" in str(diagnostics.messages[-1:]) or None)
        # A long way: the next bridge takes a while to come.
        stand_aside(programs, arm, by_rad=1.2)
        goals = len(arm.arm.goals)
        moving = subprocess.Popen(home, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        until("the arm moves", lambda: len(arm.arm.goals) > goals or None)
        time.sleep(0.3)
        programs.end("ros2", how)
        if how == signal.SIGTERM:
            assert all(event.is_set() for event in arm.arm.ended.values()), "it was canceled before the bridge had ended"
        programs.service("ros2")
        until("the goal ended", lambda: all(event.is_set() for event in arm.arm.ended.values()) or None)
        assert [event.outcome[0] for event in arm.arm.ended.values()][-1] == CANCELED, how
        assert moving.wait(60) != 0
        until("a reset", lambda: subprocess.run(reset, capture_output=True, timeout=30).returncode == 0)
        # For this bridge something may be between fingers that are half open.
        programs.robot("open")
        until("it stands again", lambda: "standing" in str(diagnostics.messages[-1:]) or None)
