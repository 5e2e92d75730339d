"""The types of the repository's `interfaces`, read by `rosbags`: its own parser, its own CDR, its own hashes."""

from pathlib import Path

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

INTERFACES = Path(__file__).resolve().parents[2] / "services/ros2/interfaces"
PUBLISHED = Path(__file__).resolve().parents[2] / "services/ros2/src/wire/published_hashes.txt"


def published():
    """Type names and hashes as the Rust side is tested against."""
    lines = PUBLISHED.read_text(encoding="utf-8").splitlines()
    return dict(line.split() for line in lines if line and not line.startswith("#"))


def _of_service(name, request, response):
    """A service's messages, what is derived from them included."""
    event = f"service_msgs/ServiceEventInfo info\n{name}_Request[<=1] request\n{name}_Response[<=1] response\n"
    whole = f"{name}_Request request_message\n{name}_Response response_message\n{name}_Event event_message\n"
    return {f"{name}_Request": request, f"{name}_Response": response, f"{name}_Event": event, name: whole}


def _of_action(name, goal, result, feedback):
    uuid = "unique_identifier_msgs/UUID goal_id\n"
    types = {f"{name}_Goal": goal, f"{name}_Result": result, f"{name}_Feedback": feedback}
    types |= _of_service(f"{name}_SendGoal", f"{uuid}{name}_Goal goal\n", "bool accepted\nbuiltin_interfaces/Time stamp\n")
    types |= _of_service(f"{name}_GetResult", uuid, f"int8 status\n{name}_Result result\n")
    return types | {f"{name}_FeedbackMessage": f"{uuid}{name}_Feedback feedback\n"}


def texts():
    """Every type's definition, by its name."""
    types = {}
    for path in sorted(INTERFACES.glob("*/*/*.*")):
        name = "/".join([*path.parts[-3:-1], path.stem])
        parts = path.read_text(encoding="utf-8")
        parts = ["\n".join(p) for p in _split(parts.splitlines())]
        make = {".msg": lambda n, t: {n: t}, ".srv": _of_service, ".action": _of_action}[path.suffix]
        types |= make(name, *parts)
    return types


def _split(lines):
    parts = [[]]
    for line in lines:
        if line.strip() == "---":
            parts.append([])
        else:
            parts[-1].append(line)
    return parts


def _alias(name):
    """The parser knows messages only: services and actions are read under another name."""
    package, kind, last = name.split("/")
    return name if kind == "msg" else f"{package}/msg/of_{kind}_{last}"


def store():
    """All types, ready to be made, read and written."""
    definitions = texts()
    names = {_alias(name): name for name in definitions}
    types = {}
    for name, text in definitions.items():
        for other in sorted(definitions, key=len, reverse=True):
            if "/msg/" not in other:
                text = text.replace(f"{other}[", f"{_alias(other)}[").replace(f"{other} ", f"{_alias(other)} ")
        # `char` of a message file is an unsigned byte in ROS 2 (rosidl_adapter); `rosbags` keeps the name, and with it another hash.
        types |= get_types_from_msg(text.replace("\nchar", "\nuint8"), _alias(name))

    def renamed(field):
        kind, of = field
        if kind == Nodetype.NAME:
            return kind, names[of]
        return (kind, (renamed(of[0]), of[1])) if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else field

    made = get_typestore(Stores.EMPTY)
    made.register({names[n]: (constants, [(f, renamed(d)) for f, d in fields]) for n, (constants, fields) in types.items()})
    return made
