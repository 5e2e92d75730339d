"""`repose serve ros2` between Repose's services and a ROS 2 system of the tests' own."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time

import pytest
import zenoh
from definitions import store
from mocks import CANCELED, READY_RAD, Arm, Camera, Scene
from system import DOMAIN, System

REPOSE = os.environ["REPOSE"]


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def until(what, holds, seconds=60.0):
    """Waits until something holds, and returns it."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found := holds():
            return found
        time.sleep(0.05)
    raise AssertionError(f"not within {seconds} s: {what}")


class Programs:
    """Processes of Repose, with their logs."""

    def __init__(self, folder):
        self.folder, self.running = folder, {}
        self.cell, self.ros = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
        self.config = os.path.join(folder, "repose.toml")

    def start(self, name, *arguments):
        with open(self.log_path(name), "ab") as log:
            self.running[name] = subprocess.Popen([REPOSE, *arguments], stdout=log, stderr=log)

    def router(self, name, endpoint):
        self.start(name, "serve", "router", "--connect", endpoint)
        host, port = endpoint.removeprefix("tcp/").split(":")

        def listens():
            with socket.socket() as trial:
                return trial.connect_ex((host, int(port))) == 0

        until(f"{name} listens", listens)

    def service(self, name):
        self.start(name, "serve", name, "--connect", self.cell, "--config", self.config)

    def end(self, name, how=signal.SIGTERM):
        process = self.running.pop(name)
        process.send_signal(how)
        process.wait(20)

    def log_path(self, name):
        return os.path.join(self.folder, f"{name}.log")

    def log(self, name):
        with open(self.log_path(name), encoding="utf-8") as log:
            return log.read()

    def close(self):
        for name in reversed(list(self.running)):
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.end(name)


CONFIG = """
[session]
mode = "client"
# Geometry alone, so that the figures are those of the bridge and not of a network for masks on a shared machine.
[perception.segmentation.learned]
enabled = false
[ros2]
domain = {domain}
allow_execute = true
[ros2.session]
mode = "client"
connect = ["{ros}"]
[[ros2.cameras]]
name = "front"
depth = "/cam/depth/image_rect"
color = "/cam/color/image_rect"
info = "/cam/depth/camera_info"
[[ros2.robots]]
name = "panda"
trajectory_action = "/arm/follow_joint_trajectory"
gripper_action = "/hand/gripper_cmd"
world_from_base = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
"""


@pytest.fixture(scope="module")
def types():
    return store()


@pytest.fixture(scope="module")
def scene():
    return Scene()


@pytest.fixture(scope="module")
def programs(tmp_path_factory):
    folder = os.environ.get("ROS2_LOGS") or str(tmp_path_factory.mktemp("logs"))
    os.makedirs(folder, exist_ok=True)
    made = Programs(folder)
    with open(made.config, "w", encoding="utf-8") as out:
        out.write(CONFIG.format(domain=DOMAIN, ros=made.ros))
    try:
        made.router("cell-router", made.cell)
        made.router("ros-router", made.ros)
        for name in ("perception", "inference", "planner", "motion", "ros2"):
            made.service(name)
        yield made
    finally:
        made.close()


@pytest.fixture(scope="module")
def system(types, programs):
    made = System(types, programs.ros)
    yield made
    made.close()


@pytest.fixture(scope="module")
def arm(system):
    made = Arm(system, held_m=0.015)
    yield made
    made.close()


@pytest.fixture
def camera(system, scene):
    """Five pictures a second; where it stands was told when the first camera came."""
    made = Camera(system, scene, rate=5, static=False)
    yield made
    made.close()


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


class Seen:
    """Keeps what comes on a topic."""

    def __init__(self, system, topic, type_name):
        self.messages = []
        system.subscribe(topic, type_name, self.messages.append)

    def after(self, count, seconds=60.0):
        return until("a message", lambda: self.messages[count:] or None, seconds)[0]


@pytest.fixture(scope="module")
def diagnostics(system):
    return Seen(system, "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")


def counts(diagnostics, part):
    for status in diagnostics.messages[-1].status if diagnostics.messages else []:
        if status.hardware_id == part:
            return {value.key: int(value.value) for value in status.values}
    return {}


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
    assert frames >= 0.8 * sent - 15
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
    done, tried, why = 0, 0, []
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


def stand_aside(arm):
    """An arm that has a way home to go."""
    arm.q_rad = [READY_RAD[0] + 0.6, *READY_RAD[1:]]
    # Until the bridge has heard of it.
    time.sleep(0.5)


def test_a_stop_of_a_client_cancels_the_goal_and_latches(programs, system, camera, arm, diagnostics):
    until("the arm is known", lambda: "standing" in str(diagnostics.messages[-1:]) or None)
    stand_aside(arm)
    command = [REPOSE, "robot", "home", "--connect", programs.cell]
    moving = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    goals = len(arm.arm.goals)
    until("the arm moves", lambda: len(arm.arm.goals) > goals or None)
    time.sleep(0.3)
    stopped = system.call("/repose/stop", "std_srvs/srv/Trigger")
    assert stopped.success, stopped.message
    assert moving.wait(30) != 0
    until("the goal ended", lambda: all(event.is_set() for event in arm.arm.ended.values()) or None)
    assert [event.outcome[0] for event in arm.arm.ended.values()][-1] == CANCELED
    until("a fault is shown", lambda: "client called the stop service" in str(diagnostics.messages[-1:]) or None)
    command = [REPOSE, "robot", "reset", "--connect", programs.cell]
    assert subprocess.run(command, capture_output=True, timeout=30).returncode == 0
    until("it stands again", lambda: "standing" in str(diagnostics.messages[-1:]) or None)


def test_a_controller_that_aborts_or_refuses_latches_a_stop_with_its_words(programs, system, camera, arm, diagnostics):
    home, reset = ([REPOSE, "robot", what, "--connect", programs.cell] for what in ("home", "reset"))
    for fault, word in (("refuse", "refused the goal"), ("stall", "a path tolerance was violated")):
        stand_aside(arm)
        setattr(arm, fault, True)
        assert subprocess.run(home, capture_output=True, timeout=60).returncode != 0
        until(f"{word} is shown", lambda: word in str(diagnostics.messages[-1:]) or None)
        setattr(arm, fault, False)
        assert subprocess.run(reset, capture_output=True, timeout=30).returncode == 0
    assert subprocess.run(home, capture_output=True, timeout=60).returncode == 0
