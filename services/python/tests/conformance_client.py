#!/usr/bin/env python3
"""Makes the calls of tests/conformance/calls.json with this package, for tests/conformance.rs to compare with its own.

`conformance_client.py ENDPOINT CALLS FOLDER MOVE ANCHOR` reads the scene from FOLDER/scene, and writes for case k the bytes of its result
to FOLDER/k, or `{"code", "field"}` of its error to FOLDER/k.error.
"""

import json
import sys
from pathlib import Path

import repose

endpoint, table, folder, move, anchor = sys.argv[1:]
scene = repose.Scene.from_bytes((Path(folder) / "scene").read_bytes())
meant = {"$scene": scene.id, "$move": int(move), "$anchor": int(anchor)}


def filled(value):
    """Put what the table's names mean in their places."""
    if isinstance(value, dict):
        return {key: filled(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [filled(inner) for inner in value]
    return meant.get(value, value) if isinstance(value, str) else value


with repose.connect(endpoint) as client:
    for k, case in enumerate(json.loads(Path(table).read_text())["cases"]):
        try:
            answer = client.call(
                case["service"],
                case["method"],
                case["schema"],
                filled(case["request"]),
                deadline_s=case.get("deadline_ms", 60_000) / 1000,
                priority=case.get("priority", "interactive"),
                scene=scene if case.get("enclose") else None,
                everyone=case.get("everyone", False),
            ).answer()
            (Path(folder) / str(k)).write_bytes(answer.content)
        except repose.ReposeError as error:
            (Path(folder) / f"{k}.error").write_text(json.dumps({"code": error.code, "field": error.field}))
