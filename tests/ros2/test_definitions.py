"""Hashes and bytes of three makings: `rosbags`, `zenoh-ros2-sdk`, and the table that the Rust side is tested against."""

import pytest
from definitions import INTERFACES, published, store, texts
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk.utils import compute_service_type_hash, compute_type_hash_from_msg


@pytest.fixture(scope="module")
def types():
    return store()


# `char` is an unsigned byte in ROS 2; both packages keep it a character, and only within services the kit knows better.
HAS_CHARACTERS = "service_msgs/msg/ServiceEventInfo"


def test_the_table_is_what_rosbags_computes_of_the_definitions_here_and_of_its_own(types):
    own, table = get_typestore(Stores.ROS2_JAZZY), published()
    assert len(table) >= 20
    for name, expected in table.items():
        assert types.hash_rihs01(name) == expected, name
        if name in own.fielddefs and name != HAS_CHARACTERS:
            assert own.hash_rihs01(name) == expected, name


def test_a_third_making_computes_the_same(types):
    definitions = texts()
    compared = 0
    for path in sorted(INTERFACES.glob("*/msg/*.msg")):
        name = "/".join([*path.parts[-3:-1], path.stem])
        others = {n: t for n, t in definitions.items() if "/msg/" in n}
        if name == HAS_CHARACTERS:
            continue
        # A definition names its header without a package; the kit asks for one.
        ours = {n: t.replace("\nHeader header", "\nstd_msgs/Header header") for n, t in others.items()}
        assert compute_type_hash_from_msg(name, ours[name], ours) == types.hash_rihs01(name), name
        compared += 1
    assert compared >= 40
    trigger = (INTERFACES / "std_srvs/srv/Trigger.srv").read_text(encoding="utf-8").split("---")[1]
    time = {"builtin_interfaces/msg/Time": definitions["builtin_interfaces/msg/Time"]}
    hash_of_trigger = compute_service_type_hash("std_srvs/srv/Trigger", "# nothing\n", trigger, time)
    assert hash_of_trigger == types.hash_rihs01("std_srvs/srv/Trigger")
