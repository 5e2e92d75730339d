"""Calls and waits that are left before their end: by Ctrl-C, an exception, the end of a block."""

import json
import signal
import socket
import subprocess
import sys
import textwrap
import time
import uuid

import pytest
from conftest import System

import repose

#: How long Ctrl-C, or a cancel on its way to a planner, may take on a machine that has other things to do, seconds.
SOON_S = 15.0


@pytest.fixture(scope="module")
def system(repose_program):
    with System(repose_program, "--seed", "3") as system:
        yield system


@pytest.fixture(scope="module")
def client(system):
    with repose.connect(system.endpoint) as client:
        system.wait_for(client, "planner", "perception", "inference", "motion")
        yield client


class Search:
    """A search that takes a planner minutes, under an id by which another client can tell whether the planner is still at it."""

    def __init__(self, client: repose.Client) -> None:
        newest = client.latest()
        query, anchor = [o["id"] for o in newest["objects"]][:2]
        goal = [{"relation": "near", "anchor": anchor, "holds": True}]
        self.quick = {"scene": {"scene_id": newest["scene_id"]}, "query": query, "goal": goal, "variant": "geometric", "seed": 3}
        self.long = {**self.quick, "variant": "full", "budget": {"iterations": 100, "batch": 1000, "elites": 5}}
        self.client, self.id, self.worker = client, str(uuid.uuid4()), client.workers("planner")[0]

    def start(self, client: repose.Client) -> repose.Call[repose.Answer]:
        return client.call("planner", "place", "PlaceRequest.v1", self.long, id=self.id, worker=self.worker, deadline_s=600)

    def is_open(self) -> bool:
        try:
            # Another request under the id of one that is open is refused.
            self.client.call("planner", "place", "PlaceRequest.v1", self.quick, id=self.id, worker=self.worker, deadline_s=60).result()
        except repose.FailedPrecondition as error:
            return error.field == "id"
        except repose.Cancelled:
            return False
        return False

    def ends_soon(self) -> bool:
        give_up = time.monotonic() + SOON_S
        while self.is_open():
            if time.monotonic() > give_up:
                return False
        return True


def by_break(call, client):
    for _ in call.progress():
        break


def by_an_exception(call, client):
    def fails():
        for _ in call.progress():
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fails()


def by_closing_its_progress(call, client):
    steps = call.progress()
    next(steps)
    steps.close()


def by_the_end_of_its_block(call, client):
    with call:
        pass


def by_the_end_of_its_client(call, client):
    client.close()
    with pytest.raises(repose.FailedPrecondition):
        client.call("planner", "place", "PlaceRequest.v1", {})


@pytest.mark.parametrize("left", [by_break, by_an_exception, by_closing_its_progress, by_the_end_of_its_block, by_the_end_of_its_client])
def test_a_call_that_is_left_is_cancelled_at_its_worker(system, client, left):
    search = Search(client)
    with repose.connect(system.endpoint) as other:
        call = search.start(other)
        steps = call.progress()
        next(steps)
        assert search.is_open(), "to look at some of the progress is not to leave it"
        left(call, other)
        assert search.ends_soon()
        with pytest.raises(repose.Cancelled):
            call.result(SOON_S)


def test_a_call_whose_result_does_not_come_in_time_goes_on(client):
    search = Search(client)
    with search.start(client) as call:
        steps = call.progress()
        next(steps)
        with pytest.raises(TimeoutError):
            call.result(0)
        assert search.is_open()


def script(body: str) -> str:
    # A shell may have started all this with the signal ignored.
    head = "import asyncio, json, signal, sys\nimport repose\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
    return head + textwrap.dedent(body)


def interrupted(program: str, *args: str) -> float:
    """Run a program until it says that it is under way, press Ctrl-C, and return how many seconds it went on, to end by that."""
    with subprocess.Popen([sys.executable, "-c", program, *args], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        if process.stdout.readline() != "under way\n":
            process.kill()
            raise RuntimeError(process.communicate()[1])
        # By now it waits outside of Python; where it does not yet, it has to end all the same.
        time.sleep(0.3)
        pressed = time.monotonic()
        process.send_signal(signal.SIGINT)
        try:
            _, said = process.communicate(timeout=60)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
        took_s = time.monotonic() - pressed
        assert process.returncode == -signal.SIGINT, said
        assert "KeyboardInterrupt" in said
    return took_s


CALL = 'call = client.call("planner", "place", "PlaceRequest.v1", json.loads(request), id=id, worker=worker, deadline_s=600)'
WAITS_FOR_A_CALL = {
    "progress": f"""
        client = repose.connect(endpoint)
        {CALL}
        for _ in call.progress():
            print("under way", flush=True)
    """,
    "progress_that_is_kept": f"""
        client = repose.connect(endpoint)
        {CALL}
        with call:
            steps = call.progress()
            for _ in steps:
                print("under way", flush=True)
    """,
    "result": f"""
        client = repose.connect(endpoint)
        {CALL}
        steps = call.progress()
        next(steps)
        print("under way", flush=True)
        call.result()
    """,
    "aprogress": f"""
        async def main():
            async with await repose.connect_async(endpoint) as client:
                {CALL}
                async for _ in call.aprogress():
                    print("under way", flush=True)
        asyncio.run(main())
    """,
}


@pytest.mark.parametrize("body", WAITS_FOR_A_CALL.values(), ids=WAITS_FOR_A_CALL)
def test_ctrl_c_cancels_the_call_at_its_worker(system, client, body):
    search = Search(client)
    program = script("endpoint, id, worker, request = sys.argv[1:]\n" + textwrap.dedent(body))
    took_s = interrupted(program, system.endpoint, search.id, search.worker, json.dumps(search.long))
    assert took_s < SOON_S
    assert search.ends_soon()


def test_an_exception_of_another_signals_handler_cancels_the_call_at_its_worker(system, client):
    search = Search(client)
    program = script(f"""
        def over_time(signum, frame):
            raise RuntimeError("over time")

        signal.signal(signal.SIGALRM, over_time)
        endpoint, id, worker, request = sys.argv[1:]
        client = repose.connect(endpoint)
        {CALL}
        steps = call.progress()
        next(steps)
        signal.alarm(1)
        try:
            call.result()
        except RuntimeError as error:
            print(error, flush=True)
        # The program goes on, and its client stays connected.
        sys.stdin.readline()
    """)
    words = [sys.executable, "-c", program, system.endpoint, search.id, search.worker, json.dumps(search.long)]
    pipe = subprocess.PIPE
    with subprocess.Popen(words, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        try:
            said = process.stdout.readline()
            assert said == "over time\n", said or process.communicate()[1]
            assert search.ends_soon()
            assert process.poll() is None, "it was not the end of the process that ended the call"
        finally:
            process.kill()


OTHER_WAITS = {
    "robot_state": 'client.robot_state("nobody", timeout_s=60)',
    "watch_robot": 'next(client.watch_robot("nobody"))',
    "latest": 'client.latest("nobody", deadline_s=60)',
    "plan": 'repose.plan(scene, ids[0], [("near", ids[1])], variant="full", budget={"iterations": 100, "batch": 1000, "elites": 5})',
}


@pytest.mark.parametrize("wait", OTHER_WAITS.values(), ids=OTHER_WAITS)
def test_ctrl_c_ends_every_wait(system, client, wait):
    program = script(f"""
        client = repose.connect(sys.argv[1])
        scene = client.scene()
        ids = [o.id for o in scene.objects]
        print("under way", flush=True)
        {wait}
    """)
    assert interrupted(program, system.endpoint) < SOON_S


def test_ctrl_c_ends_the_wait_for_a_router_that_does_not_answer():
    # Connections are taken, and nothing comes.
    with socket.create_server(("127.0.0.1", 0)) as silent:
        program = script(f"""
            print("under way", flush=True)
            repose.connect("tcp/127.0.0.1:{silent.getsockname()[1]}")
        """)
        # It would give up by itself after ten seconds.
        assert interrupted(program) < 8


def test_a_wait_whose_time_is_over_already_does_not_wait(client):
    began = time.monotonic()
    with pytest.raises(repose.Unavailable):
        client.robot_state("nobody", timeout_s=-1)
    assert list(client.watch_scene("nobody", timeout_s=-1)) == []
    assert time.monotonic() - began < SOON_S
