"""Emergency stops, and resets of them, with a robot that tells whatever it likes."""

import json
from types import SimpleNamespace

import pytest

import repose
from repose import _cell


class ToldRobot:
    """A connection to a robot that tells these states, the last of them for ever, and to a motion that clears whatever is latched.

    ``{stop}`` in a state is the emergency stop that was put. A wait for a state takes as long as it may, by ``clock``.
    """

    def __init__(self, *states):
        self.states, self.puts, self.asked = list(states), [], []
        self.clock = SimpleNamespace(now=100.0)
        self.time = SimpleNamespace(monotonic=lambda: self.clock.now, time_ns=lambda: 0)

    def put(self, kind, name, schema, body):
        self.puts.append((kind, name, json.loads(body)["id"]))

    def subscribe(self, kind, name, newest_only):
        def recv(timeout_s):
            self.clock.now += timeout_s
            state = self.states.pop(0) if len(self.states) > 1 else self.states[0]
            return "key", "RobotState.v1", state.replace(b"{stop}", self.puts[-1][2].encode() if self.puts else b"")

        return SimpleNamespace(recv=recv, close=lambda: None)

    def call(self, service, method, schema, request, **options):
        self.asked.append((service, method, json.loads(request)))
        return SimpleNamespace(wait=lambda timeout_s: ("RobotResetReply.v1", False, b'{"was_stopped": true}', "one", 1, {}))


def told(mode, stop=None):
    """A state as it travels."""
    still = [0.0] * 7
    return json.dumps({"q_rad": still, "dq_rad_s": still, "gripper_width_m": 0.08, "mode": mode, "stop": stop}).encode()


UNREADABLE = {
    "no joints": b'{"mode": "stopped", "stop": {"kind": "estop", "reason": "", "estop_id": "{stop}"}}',
    "a stop in words": told("stopped", "pressed"),
    "a mode that there is not": told("dancing"),
    "a list": b"[]",
    "no text": b"\xff",
    "too deep": b"[" * 100_000,
}


def test_a_reset_clears_the_stop_that_was_shown_and_none_where_none_was():
    seen, newer = ({"kind": "estop", "reason": "a hand", "estop_id": id} for id in ("e1", "e2"))
    for mode in ("idle", "moving"):
        going_on = ToldRobot(told(mode), told("stopped", newer))
        client = repose.Client(going_on, "front", "panda")
        assert client.reset() is False
        assert going_on.asked == [], "a stop that has latched since stays"
        stood = ToldRobot(told(mode), told("stopped", newer))
        client = repose.Client(stood, "front", "panda")
        assert client.reset(shown=client.robot_state()) is False
        assert stood.asked == []
    stopped = ToldRobot(told("stopped", seen), told("stopped", newer))
    client = repose.Client(stopped, "front", "panda")
    state = client.robot_state()
    assert client.reset(shown=state) is True
    assert client.reset("other") is True
    assert [(robot["robot"], robot["stop"]) for _, _, robot in stopped.asked] == [("panda", seen), ("other", newer)]
    # One that does not say why it is stopped is set going, too.
    wordless = ToldRobot(told("stopped"))
    assert repose.Client(wordless, "front", "panda").reset() is True
    assert wordless.asked == [("motion", "reset", {"robot": "panda"})]


def test_a_stop_is_put_again_beside_states_that_cannot_be_read(monkeypatch):
    stopped = told("stopped", {"kind": "estop", "reason": "a test", "estop_id": "{stop}"})
    robot = ToldRobot(*UNREADABLE.values(), stopped)
    monkeypatch.setattr(_cell, "time", robot.time)
    state = repose.Client(robot, "front", "panda").stop()
    assert state.stop is not None
    assert robot.puts == [("robot_estop", "panda", state.stop["estop_id"])] * (1 + len(UNREADABLE))


@pytest.mark.parametrize("unreadable", UNREADABLE.values(), ids=UNREADABLE)
def test_a_robot_whose_states_cannot_be_read_is_stopped_all_the_same_and_tells_none(monkeypatch, unreadable):
    robot = ToldRobot(unreadable)
    monkeypatch.setattr(_cell, "time", robot.time)
    client = repose.Client(robot, "front", "panda")
    with pytest.raises(repose.DeadlineExceeded) as raised:
        client.stop(timeout_s=1.95)
    assert raised.value.field == "robot"
    assert len(robot.puts) == 21, "at first, and after each of 20 waits"
    for ask in (client.robot_state, client.reset):
        with pytest.raises(repose.Unavailable, match="no state that can be read") as raised:
            ask()
        assert raised.value.field == "robot"
    assert robot.asked == []
