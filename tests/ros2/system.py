"""A ROS 2 system of the tests' own on plain Zenoh: nodes with topics, services and action servers, as `rmw_zenoh` has them."""

import itertools
import json
import os
import struct
import threading
import time

import numpy as np
import zenoh
from zenoh.ext import CacheConfig, declare_advanced_publisher

DOMAIN = 42


def until(what, holds, seconds=60.0):
    """Waits until something holds, and returns it."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found := holds():
            return found
        time.sleep(0.05)
    raise AssertionError(f"not within {seconds} s: {what}")


class System:
    """One session and one node, whose endpoints others see."""

    def __init__(self, store, endpoint, name="mock"):
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("timestamping/enabled", "true")
        self.session, self.store, self.name = zenoh.open(config), store, name
        self.ids, self.kept = itertools.count(1), []
        self.hashes = {}
        self._token(f"@ros2_lv/{DOMAIN}/{self.session.zid()}/0/0/NN/%/%/{name}")

    def _token(self, key):
        self.kept.append(self.session.liveliness().declare_token(key))

    def hash(self, type_name):
        """The hash, by `rosbags`."""
        if type_name not in self.hashes:
            self.hashes[type_name] = self.store.hash_rihs01(type_name)
        return self.hashes[type_name]

    def key(self, topic, type_name):
        package, kind, name = type_name.split("/")
        return f"{DOMAIN}/{topic.strip('/')}/{package}::{kind}::dds_::{name}_/{self.hash(type_name)}"

    def show(self, kind, topic, type_name, qos="::,10:,:,:,,"):
        dds = "/".join(self.key(topic, type_name).split("/")[-2:])
        start = f"@ros2_lv/{DOMAIN}/{self.session.zid()}/0/{next(self.ids)}/{kind}/%/%/{self.name}"
        self._token(f"{start}/{topic.replace('/', '%')}/{dds}/{qos}")

    def publisher(self, topic, type_name, kept=False):
        """A function that publishes; `kept` is for those who come late too."""
        self.show("MP", topic, type_name, ":1:,1:,:,:,," if kept else "::,10:,:,:,,")
        key = self.key(topic, type_name)
        if kept:
            publisher = declare_advanced_publisher(self.session, key, cache=CacheConfig(max_samples=1), publisher_detection=True)
        else:
            publisher = self.session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
        self.kept.append(publisher)
        numbers, gid = itertools.count(1), os.urandom(16)

        def publish(message):
            attachment = struct.pack("<qqB", next(numbers), time.time_ns(), 16) + gid
            publisher.put(bytes(self.store.serialize_cdr(message, type_name)), attachment=attachment)

        return publish

    def subscribe(self, topic, type_name, callback):
        self.show("MS", topic, type_name)

        def came(sample):
            assert len(sample.attachment.to_bytes()) == 33
            callback(self.store.deserialize_cdr(sample.payload.to_bytes(), type_name))

        self.kept.append(self.session.declare_subscriber(self.key(topic, type_name), came))

    def serve(self, service, type_name, answer):
        """Answers each request on a thread of its own."""
        self.show("SS", service, type_name)

        def asked(query):
            attachment = query.attachment.to_bytes()
            assert len(attachment) == 33
            request = self.store.deserialize_cdr(query.payload.to_bytes(), f"{type_name}_Request")

            def work():
                response = answer(request)
                payload = bytes(self.store.serialize_cdr(response, f"{type_name}_Response"))
                query.reply(query.key_expr, payload, attachment=attachment)
                query.drop()

            threading.Thread(target=work, daemon=True).start()

        self.kept.append(self.session.declare_queryable(self.key(service, type_name), asked, complete=True))

    def call(self, service, type_name, timeout=60.0, **fields):
        """Calls a service; its response, or none."""
        request = self.make(f"{type_name}_Request", **fields)
        attachment = struct.pack("<qqB", 1, time.time_ns(), 16) + os.urandom(16)
        payload = bytes(self.store.serialize_cdr(request, f"{type_name}_Request"))
        replies = self.session.get(
            self.key(service, type_name),
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            payload=payload,
            attachment=attachment,
            timeout=timeout,
        )
        for reply in replies:
            if reply.ok:
                assert reply.ok.attachment.to_bytes()[17:] == attachment[17:], "the response is for this client"
                return self.store.deserialize_cdr(reply.ok.payload.to_bytes(), f"{type_name}_Response")
        return None

    def make(self, type_name, **fields):
        """A message, what is not given being zero or empty."""
        return self.store.types[type_name](**{**self._defaults(type_name), **fields})

    def _defaults(self, type_name):
        _, fields = self.store.fielddefs[type_name]
        made = {}
        for name, (kind, of) in fields:
            kind = int(kind)
            if kind == 1:  # a primitive
                base = of[0]
                made[name] = "" if base == "string" else False if base == "bool" else 0.0 if base.startswith("float") else 0
            elif kind == 2:  # another type
                made[name] = self.make(of)
            else:
                (inner, what), size = of
                if int(inner) == 1 and what[0] != "string":
                    made[name] = np.zeros(size if kind == 3 else 0, {"byte": "uint8", "char": "uint8"}.get(what[0], what[0]))
                else:
                    made[name] = [self.make(what) for _ in range(size if kind == 3 else 0)]
        return made

    def stamp(self, ns=None):
        ns = time.time_ns() if ns is None else ns
        return self.make("builtin_interfaces/msg/Time", sec=ns // 10**9, nanosec=ns % 10**9)

    def header(self, frame, ns=None):
        return self.make("std_msgs/msg/Header", stamp=self.stamp(ns), frame_id=frame)

    def close(self):
        self.session.close()


class Seen:
    """Keeps what comes on a topic."""

    def __init__(self, system, topic, type_name):
        self.messages = []
        system.subscribe(topic, type_name, self.messages.append)

    def after(self, count, seconds=60.0):
        return until("a message", lambda: self.messages[count:] or None, seconds)[0]


def counts(diagnostics, part):
    for status in diagnostics.messages[-1].status if diagnostics.messages else []:
        if status.hardware_id == part:
            return {value.key: int(value.value) for value in status.values}
    return {}


class ActionServer:
    """An action's services and topics; `work(goal, feedback, canceled)` carries a goal out and returns state and result."""

    def __init__(self, system, name, type_name, work, accept=lambda goal: True):
        self.system, self.type_name, self.work, self.accept = system, type_name, work, accept
        self.ended, self.canceled, self.goals = {}, {}, []
        part = f"{name}/_action/"
        self.feedback = system.publisher(part + "feedback", f"{type_name}_FeedbackMessage")
        system.publisher(part + "status", "action_msgs/msg/GoalStatusArray", kept=True)
        system.serve(part + "send_goal", f"{type_name}_SendGoal", self._send)
        system.serve(part + "get_result", f"{type_name}_GetResult", self._result)
        system.serve(part + "cancel_goal", "action_msgs/srv/CancelGoal", self._cancel)

    def _send(self, request):
        make, goal_id = self.system.make, bytes(request.goal_id.uuid)
        accepted = self.accept(request.goal)
        if accepted:
            self.goals.append(request.goal)
            # A new goal takes the place of the one before.
            for event in self.canceled.values():
                event.set()
            self.ended[goal_id], self.canceled[goal_id] = threading.Event(), threading.Event()
            threading.Thread(target=self._run, args=(goal_id, request), daemon=True).start()
        return make(f"{self.type_name}_SendGoal_Response", accepted=accepted, stamp=self.system.stamp())

    def _run(self, goal_id, request):
        def feedback(**fields):
            told = self.system.make(f"{self.type_name}_Feedback", **fields)
            self.feedback(self.system.make(f"{self.type_name}_FeedbackMessage", goal_id=request.goal_id, feedback=told))

        state, result = self.work(request.goal, feedback, self.canceled[goal_id])
        self.ended[goal_id].outcome = (state, result)
        self.ended[goal_id].set()

    def _result(self, request):
        event = self.ended[bytes(request.goal_id.uuid)]
        event.wait()
        state, result = event.outcome
        return self.system.make(f"{self.type_name}_GetResult_Response", status=state, result=result)

    def _cancel(self, request):
        make, goal_id = self.system.make, bytes(request.goal_info.goal_id.uuid)
        if not any(goal_id):
            # All of them; no fault where there is none.
            canceling, code = [goal for goal, event in list(self.ended.items()) if not event.is_set()], 0
        else:
            # As action servers have it: 2 is an unknown goal, 3 one that has ended.
            code = 2 if goal_id not in self.canceled else 3 if self.ended[goal_id].is_set() else 0
            canceling = [goal_id] if code == 0 else []
        for goal in canceling:
            self.canceled[goal].set()
        ids = [make("unique_identifier_msgs/msg/UUID", uuid=np.frombuffer(goal, np.uint8)) for goal in canceling]
        infos = [make("action_msgs/msg/GoalInfo", goal_id=goal) for goal in ids]
        return make("action_msgs/srv/CancelGoal_Response", return_code=code, goals_canceling=infos)
