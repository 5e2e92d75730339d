#!/usr/bin/env python3
"""Asks a running Repose for a placement: `pip install eclipse-zenoh`, then
`scripts/place.py --move 2 --goal left_of:3 --goal not:near:4 [--connect tcp/127.0.0.1:7447] [--zenoh-config client.json5]`.

Finds a planner by its liveliness token and the newest scene of a camera, calls `place`, prints progress on standard
error and the result on standard output. Exits 0 with a placement, 3 without one, 2 on bad input, 1 on anything else.
"""

import argparse
import json
import sys
import uuid

import zenoh

EXIT = {"invalid_argument": 2, "not_found": 2, "failed_precondition": 2}


class CallFailed(Exception):
    """A call that ended in the contract's error, as the dictionary that came."""


def live_workers(session, prefix, service):
    replies = session.liveliness().get(f"{prefix}/live/{service}/*", timeout=2.0)
    return sorted(str(reply.ok.key_expr).rsplit("/", 1)[1] for reply in replies if reply.ok)


def call(session, prefix, service, worker, method, schema, request, timeout_s):
    """One call to one worker: any number of progress replies, then one result or one error."""
    attachment = {"v": 1, "id": str(uuid.uuid4()), "method": method, "remaining_ms": int(timeout_s * 1000)}
    replies = session.get(
        f"{prefix}/service/{service}/{worker}/call",
        payload=json.dumps(request),
        encoding=f"application/json;repose.{schema}",
        attachment=json.dumps(attachment),
        consolidation=zenoh.ConsolidationMode.NONE,
        timeout=timeout_s + 1.0,
    )
    for reply in replies:
        if not reply.ok:
            raise CallFailed({"code": "deadline_exceeded", "message": f"{worker} did not answer in time"})
        about, body = json.loads(reply.ok.attachment.to_string()), json.loads(reply.ok.payload.to_string())
        if about["kind"] == "progress":
            print(f"progress {about['n']}: {body['evaluated']} candidates", file=sys.stderr)
        elif about["kind"] == "result":
            return body
        else:
            raise CallFailed(body)
    raise CallFailed({"code": "unavailable", "message": f"{worker} went away"})


def goal_term(text):
    holds = not text.startswith("not:")
    relation, separator, anchor = text.removeprefix("not:").partition(":")
    if not separator or not anchor.isdigit():
        raise argparse.ArgumentTypeError(f"expected RELATION:ANCHOR or not:RELATION:ANCHOR, got {text!r}")
    return {"relation": relation, "anchor": int(anchor), "holds": holds}


def open_session(connect, config_file):
    """A client session, or the contract's error that says where no router answered."""
    try:
        config = zenoh.Config.from_file(config_file) if config_file else zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([connect]))
        config.insert_json5("scouting/multicast/enabled", "false")
        return zenoh.open(config)
    except zenoh.ZError as error:
        message = f"no session at {connect}; is a router running there (`repose up`), and does it know this user? {error}"
        raise CallFailed({"code": "unavailable", "message": message}) from None


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447", help="a router of the deployment")
    parser.add_argument("--zenoh-config", metavar="FILE", help="a Zenoh configuration: TLS, user and password")
    parser.add_argument("--cell", default="cell", help="the robot cell")
    parser.add_argument("--camera", default="front", help="the camera whose newest scene is used")
    parser.add_argument("--move", type=int, required=True, help="the object to move")
    parser.add_argument("--goal", type=goal_term, action="append", required=True, help="RELATION:ANCHOR or not:RELATION:ANCHOR")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--timeout", type=float, default=60.0, help="seconds")
    args = parser.parse_args()

    prefix = f"repose/v1/{args.cell}"
    with open_session(args.connect, args.zenoh_config) as session:
        planners = live_workers(session, prefix, "planner")
        if not planners:
            raise CallFailed({"code": "unavailable", "message": f"no planner is alive at {args.connect}"})
        scene = None
        for worker in live_workers(session, prefix, "perception"):
            try:
                scene = call(session, prefix, "perception", worker, "latest", "LatestRequest.v1", {"camera": args.camera}, 5.0)
                break
            except CallFailed as failed:
                print(f"{worker}: {failed.args[0]['message']}", file=sys.stderr)
        if scene is None:
            raise CallFailed({"code": "not_found", "message": f"no scene of camera {args.camera}"})
        request = {"scene": {"scene_id": scene["scene_id"]}, "query": args.move, "goal": args.goal, "seed": args.seed}
        result = call(session, prefix, "planner", planners[0], "place", "PlaceRequest.v1", request, args.timeout)
    print(json.dumps(result, indent=2))
    return 0 if result["placements"] else 3


if __name__ == "__main__":
    try:
        sys.exit(main())
    except CallFailed as failed:
        error = failed.args[0]
        print(f"{error['code']}: {error['message']}" + (f" (field {error['field']})" if error.get("field") else ""), file=sys.stderr)
        sys.exit(EXIT.get(error["code"], 1))
