"""The client against a running system: processes of their own, one of them killed in between."""

import asyncio
import contextlib
import dataclasses
import json
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import System, free_port, readme_blocks

import repose
from repose import _cell
from repose.calls import Call


@pytest.fixture(scope="module")
def system(repose_program):
    with System(repose_program, "--planners", "2", "--seed", "3") as system:
        yield system


@pytest.fixture(scope="module")
def client(system):
    with repose.connect(system.endpoint) as client:
        yield client


@pytest.fixture(scope="module")
def scene(client):
    return client.scene()


@pytest.fixture(scope="module")
def wish(scene):
    """An object and a goal that geometry alone plans quickly."""
    ids = [o.id for o in scene.objects]
    assert len(ids) >= 2
    return {"move": ids[0], "goal": [("near", ids[1])], "variant": "geometric", "seed": 3}


def test_a_scene_is_the_same_as_arrays_and_on_the_wire(client, scene):
    assert scene.id == client.scene(scene.id).id
    assert scene.points.shape[1] == 3
    assert np.isfinite(scene.points).all()


def test_a_placement_over_the_network_is_the_one_of_this_process(client, scene, wish):
    over_network = client.place(scene, **wish)
    here = repose.plan(scene, **wish)
    assert over_network.data == here.data


def test_a_deadline_is_of_everything_that_is_asked(monkeypatch):
    clock, waits = SimpleNamespace(now=100.0), []
    monkeypatch.setattr(_cell, "time", SimpleNamespace(monotonic=lambda: clock.now))

    def took_two_seconds(what, within_s):
        waits.append((what, within_s))
        clock.now += 2.0

    class Connection:
        def call(self, service, method, schema, request, *, deadline_s, **options):
            took_two_seconds(method, deadline_s)
            return SimpleNamespace(wait=lambda timeout_s: ("Any.v1", False, b'{"scene_id": "ab"}', "one", 1, {}))

        def subscribe(self, kind, name, newest_only):
            state = b'{"q_rad": [0, 0, 0, 0, 0, 0, 0], "dq_rad_s": [0, 0, 0, 0, 0, 0, 0], "gripper_width_m": 0.0, "mode": "idle"}'

            def recv(timeout_s):
                took_two_seconds("state", timeout_s)
                return "key", "RobotState.v1", state

            return SimpleNamespace(recv=recv, close=lambda: None)

    client = repose.Client(Connection(), "front", "panda")
    client.place_call(move=1, goal=[("near", 2)], deadline_s=3.5)
    client.plan_motion(SimpleNamespace(id="ab", _native=None), np.eye(4), move=1, deadline_s=3.5)
    client.plan_motion(SimpleNamespace(id="ab", _native=None), np.eye(4), [0.0] * 7, move=1, deadline_s=-1.0)
    assert waits == [("latest", 3.5), ("place", 1.5), ("state", 3.5), ("plan", 1.5), ("plan", -1.0)]


def test_a_scene_is_fetched_as_those_of_the_services_are_and_not_in_one_message(view):
    whole, asked = view.scene(), []

    class Connection:
        def scene(self, scene_id, deadline_s):
            asked.append((scene_id, deadline_s))
            return SimpleNamespace(wait=lambda timeout_s: ("Scene.v1", True, whole._native.to_bytes(), "", 1, {}))

    client = repose.Client(Connection(), "front", "panda")
    assert client.scene(whole.id, deadline_s=3.5).id == whole.id
    [(scene_id, deadline_s)] = asked
    assert scene_id == whole.id
    assert 0 < deadline_s <= 3.5


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_process_that_was_forked_is_told_to_connect_anew(client, scene, wish):
    call = client.place_call(scene, **wish)
    child = os.fork()
    if child == 0:
        # Where it waits for ever, this ends it.
        signal.alarm(60)
        told = 0
        try:
            asks = (lambda: client.workers("planner"), client.latest, call.progress().__next__, lambda: client.place_call(scene, **wish))
            for ask in asks:
                try:
                    ask()
                except repose.FailedPrecondition as error:
                    told += "forked" in error.message
            client.close()
        finally:
            os._exit(told)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 4
    assert call.result().data["scene_id"] == scene.id
    assert client.workers("planner"), "the session goes on where it was made"


def test_every_call_is_answered_while_a_planner_is_killed(client, system, scene, wish):
    planners = system.children("planner")
    assert len(planners) == 2
    expected = client.place(scene, **wish).data
    calls = []
    for i in range(24):
        calls.append(client.place_call(scene, **wish, deadline_s=60))
        if i == 8:
            os.kill(planners[0], signal.SIGKILL)
    answers = [call.answer(60) for call in calls]
    assert all(answer.data == expected for answer in answers)
    assert {answer.worker for answer in answers} <= set(client.workers("planner")) | {a.worker for a in answers}


def test_progress_is_seen_before_the_result(client, scene, wish):
    options = {**wish, "variant": "best", "budget": {"iterations": 4}}
    call = client.place_call(scene, **options)
    progress = list(call.progress())
    assert progress
    assert progress[-1]["iterations"] >= 1
    assert call.result().outcome in ("found", "none")
    assert call.done()


def test_a_cancelled_call_ends_as_cancelled(client, scene, wish):
    call = client.place_call(scene, **{**wish, "variant": "full", "budget": {"iterations": 100, "batch": 20, "elites": 5}}, deadline_s=120)
    steps = call.progress()
    next(steps)
    started = time.monotonic()
    call.cancel()
    with pytest.raises(repose.Cancelled):
        call.result(30)
    assert time.monotonic() - started < 10


def test_a_deadline_that_passes_is_its_error(client, scene, wish):
    # Not even one iteration is done in time: after one there would be a partial answer.
    long = {**wish, "variant": "full", "budget": {"iterations": 100, "batch": 1000, "elites": 5}}
    # A planner that knows how long it takes refuses at once what cannot be done in time.
    with pytest.raises((repose.DeadlineExceeded, repose.ResourceExhausted)):
        client.place(scene, **long, deadline_s=0.3)
    with pytest.raises(repose.InvalidArgument) as raised:
        client.place(scene, **wish, deadline_s=601)
    assert raised.value.field == "remaining_ms"


def test_errors_of_services_have_code_and_field(client, scene, wish):
    with pytest.raises(repose.NotFound) as raised:
        client.place("0" * 64, 1, [("near", 2)])
    assert raised.value.field is not None
    assert raised.value.field.endswith("scene_id")
    with pytest.raises(repose.InvalidArgument) as raised:
        client.place(scene, **{**wish, "count": 0})
    assert raised.value.field == "count"
    with pytest.raises(repose.InvalidArgument) as raised:
        client.call("planner", "dance", "PlaceRequest.v1", {}).result()
    assert raised.value.field == "method"
    with pytest.raises(repose.NotFound):
        client.latest("nobody", deadline_s=1)


def test_nobody_there_is_unavailable():
    with pytest.raises(repose.Unavailable):
        repose.connect(f"tcp/127.0.0.1:{free_port()}")


def test_a_motion_is_planned_from_where_the_robot_is(client, scene, wish):
    plan = client.place(scene, **wish, count=5)
    motion = client.plan_motion(scene, plan)
    np.testing.assert_allclose(motion.phases[0].joints_rad[0], client.robot_state().joints_rad, atol=1e-3)


def test_a_motion_on_what_is_seen_again_just_so_is_as_young_as_that(client, view):
    for seen_s in (1_000, 2_000):
        scene = view.scene(stamp_ns=seen_s * 10**9)
        plan = client.place(scene, 1, [("left_of", 2)], variant="geometric", count=5, seed=5)
        assert client.plan_motion(scene, plan).data["scene_stamp_ns"] == scene.stamp_ns


def test_a_stop_latches_until_reset(client):
    state = client.stop(reason="test")
    assert state.mode == "stopped"
    assert state.stop is not None
    assert state.stop["kind"] == "estop"
    another = dataclasses.replace(state, stop={**state.stop, "estop_id": "another"})
    with pytest.raises(repose.FailedPrecondition) as raised:
        client.reset(shown=another)
    assert raised.value.field == "robot"
    assert client.reset(shown=state)
    ends = time.monotonic() + 10
    while client.robot_state().mode == "stopped":
        assert time.monotonic() < ends
    assert not client.reset()


def test_scenes_are_watched_as_they_come(client, scene):
    summary = next(client.watch_scene(timeout_s=30))
    assert {"scene_id", "objects", "surfaces"} <= set(summary)
    assert next(client.watch_robot(timeout_s=5)).joints_rad.shape == (7,)
    assert list(client.watch_scene("nobody", timeout_s=0.2)) == []


def test_asyncio_waits_for_several_calls_at_once(system, client, scene, wish):
    async def main():
        async with await repose.connect_async(system.endpoint) as aclient:
            plans = await asyncio.gather(*(aclient.place(scene, **{**wish, "seed": seed}) for seed in range(6)))
            assert [p.data["seed"] for p in plans] == list(range(6))
            assert (await aclient.latest())["scene_id"]
            call = await aclient.place_call(scene, **{**wish, "variant": "full", "budget": {"iterations": 100, "batch": 20, "elites": 5}})
            task = asyncio.ensure_future(call._ended())
            async for _ in call.aprogress():
                break
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            with pytest.raises(repose.Cancelled):
                await call
            async for state in aclient.watch_robot():
                assert state.joints_rad.shape == (7,)
                break

            async def watch():
                return [state async for state in aclient.watch_robot()]

            assert [scene async for scene in aclient.watch_scene("nobody", timeout_s=0.2)] == []
            watching = asyncio.ensure_future(watch())
            await asyncio.sleep(0.5)
        # Its client is closed: a watch ends with that.
        assert await asyncio.wait_for(watching, 10)

    asyncio.run(main())


def test_a_client_of_asyncio_that_is_closed_holds_nothing_else_up():
    gone_on = threading.Event()

    class Slow:
        def close(self):
            assert gone_on.wait(10), "the loop stood still"

    async def main():
        closing = asyncio.ensure_future(repose.AsyncClient(Slow(), "front", "panda").close())
        await asyncio.sleep(0)
        gone_on.set()
        await closing

    asyncio.run(main())


def test_a_call_is_given_up_and_listened_to_within_asyncio_while_no_thread_is_free():
    class Pending:
        """A call that ends when it is cancelled and tells nothing before."""

        def __init__(self):
            self.ended, self.callbacks = threading.Event(), []

        def next_progress(self):
            return None

        def on_done(self, callback):
            self.callbacks.append(callback)
            if self.ended.is_set():
                callback()

        def cancel(self):
            self.ended.set()

        give_up = cancel

    async def main():
        loop, left, gone_on = asyncio.get_running_loop(), Pending(), threading.Event()
        loop.set_default_executor(ThreadPoolExecutor(1))
        busy = loop.run_in_executor(None, gone_on.wait, 10)
        async with Call(left, lambda answer: answer):
            pass
        assert left.ended.is_set()
        assert [step async for step in Call(Pending(), lambda answer: answer).aprogress()] == []
        gone_on.set()
        assert await busy, "both waited for the thread"

    asyncio.run(main())


def test_threads_share_a_client(client, scene, wish):
    answers: list[int] = []
    threads = [
        threading.Thread(target=lambda s=s: answers.append(client.place(scene, **{**wish, "seed": s}).data["seed"])) for s in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(answers) == list(range(8))


def executed(client, scene):
    """A motion that the arm can carry out, of whichever object it can."""
    ids = [o.id for o in scene.objects]
    for move in ids:
        for anchor in (i for i in ids if i != move):
            plan = client.place(scene, move, [("near", anchor)], variant="geometric", count=5, seed=1)
            try:
                return client.plan_motion(scene, plan) if plan else None
            except repose.FailedPrecondition:
                continue
    pytest.fail("no object of the scene can be moved")


def test_the_lines_of_the_readme_reach_the_robot(system, scene, wish):
    lines = readme_blocks()[1].replace("tcp/127.0.0.1:7447", system.endpoint)
    # Everything but the motion itself, and with an object and a goal of this scene.
    lines = lines.replace('move=2, goal=[("left_of", 3)]', f"move={wish['move']}, goal={wish['goal']!r}")
    names = {"repose": repose}
    # Not every object can be taken by the arm.
    with contextlib.suppress(repose.FailedPrecondition):
        exec(lines.replace("client.execute(motion)", "motion.phases"), names)
    assert names["plan"].query == wish["move"]


def test_a_robot_whose_client_dies_comes_to_rest(system, client):
    client.recover("home")
    script = textwrap.dedent(f"""
        import json, sys
        import repose
        client = repose.connect({system.endpoint!r})
        motion = repose.MotionPlan(sys.stdin.read())
        call = client.execute_call(motion)
        for step in call.progress():
            print(step["phase"], flush=True)
    """)
    motion = executed(client, client.scene())
    with subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as dying:
        dying.stdin.write(motion.json)
        dying.stdin.close()
        assert dying.stdout.readline().strip() == "standoff"
        task = None
        for state in client.watch_robot(timeout_s=5):
            task = state.data["task"].get("id")
            if state.mode == "moving":
                break
            assert dying.poll() is None
        dying.kill()
    ends = time.monotonic() + 15
    for state in client.watch_robot(timeout_s=5):
        if state.data["task"].get("id") is None and state.mode != "moving":
            break
        assert time.monotonic() < ends, state.data
    assert task is not None
    assert np.abs(state.joints_rad - motion.phases[-1].joints_rad[-1]).max() > 0.01, "it has not gone on to the end"
    client.reset()
    assert client.recover("home").outcome == "done"


def test_a_motion_is_carried_out_with_its_phases(client):
    motion = executed(client, client.scene())
    call = client.execute_call(motion)
    phases = [step["phase"] for step in call.progress()]
    ended = call.result()
    # The simulated grasp may slip: that is an outcome, too.
    assert ended.outcome in ("done", "grasp_lost"), ended
    assert phases[:3] == ["standoff", "approach", "grasp"]
    with pytest.raises(repose.FailedPrecondition) as raised:
        client.execute(motion)
    assert raised.value.field in ("start_joints_rad", "robot", "scene_stamp_ns")
    client.recover("open")
    client.recover("retreat")
    assert client.recover("home").outcome == "done"


def test_an_arm_comes_home_beside_a_scene_that_nobody_else_holds(client):
    data = bytearray(client.scene().to_bytes())
    begin = 8 + int.from_bytes(data[:8], "little")
    data[begin + json.loads(data[8:begin])["colors"]["data_offsets"][0]] ^= 1
    unknown = repose.Scene.from_bytes(bytes(data))
    with pytest.raises(repose.NotFound):
        client.scene(unknown.id)
    assert client.recover("home", scene=unknown).outcome == "done"


def test_the_script_prints_a_result(system, scene, wish):
    script = Path(__file__).parents[3] / "scripts" / "place.py"
    goal = [f"{wish['goal'][0][0]}:{wish['goal'][0][1]}"]
    command = [sys.executable, str(script), "--connect", system.endpoint, "--move", str(wish["move"]), "--goal", *goal]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode in (0, 3), done.stderr
    assert done.stdout.startswith("{")
    elsewhere = [*command[:2], "--connect", "tcp/127.0.0.1:9", *command[4:]]
    nobody = subprocess.run(elsewhere, capture_output=True, text=True, timeout=60, check=False)
    assert nobody.returncode == 1
    assert nobody.stderr.startswith("unavailable")
