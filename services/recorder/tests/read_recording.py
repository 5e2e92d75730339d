"""Reads a recording with PyPI's `mcap` and `mcap-protobuf-support` and checks it: `read_recording.py RUN.mcap`. Prints what it holds as JSON."""

import json
import struct
import sys
from collections import Counter

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

LOOKS = {
    "/camera/front/image": "foxglove.CompressedImage",
    "/camera/front/calibration": "foxglove.CameraCalibration",
    "/scene/front/cloud": "foxglove.PointCloud",
    "/scene/front/objects": "foxglove.SceneUpdate",
    "/placements": "foxglove.SceneUpdate",
    "/tf": "foxglove.FrameTransforms",
    "/robot/panda/joints": "foxglove.JointStates",
    "/robot/panda/body": "foxglove.SceneUpdate",
}
WIRE = ["Frame.v1", "Scene.v1", "SceneSummary.v1", "RobotState.v1", "JournalEntry.v1"]


def check_image(message):
    assert message.format == "jpeg" and message.data[:3] == b"\xff\xd8\xff", message.format


def check_calibration(message):
    assert message.width > 0 and len(message.K) == 9 and len(message.P) == 12, message


def check_cloud(message):
    data, stride = message.data, message.point_stride
    assert data and len(data) % stride == 0, (len(data), stride)
    fields = {field.name: field.offset for field in message.fields}
    assert set(fields) == {"x", "y", "z", "red", "green", "blue", "alpha"}, fields
    points = [struct.unpack_from("<fff", data, at) for at in range(0, len(data), stride)]
    assert all(abs(v) < 100 for point in points for v in point), "points are metres in the world"


def check_joints(message):
    assert len(message.joints) == 9 and all(j.HasField("position") for j in message.joints), message


DECODERS = DecoderFactory()
CHECKS = {
    "foxglove.CompressedImage": check_image,
    "foxglove.CameraCalibration": check_calibration,
    "foxglove.PointCloud": check_cloud,
    "foxglove.JointStates": check_joints,
}


def check_wire(channel, message):
    form, wire = channel.metadata["encoding"].split(";repose.")
    if form == "application/json":
        json.loads(message.data)
    else:
        (length,) = struct.unpack_from("<Q", message.data)
        json.loads(message.data[8 : 8 + length])
    return wire


def check_look(schema, message):
    decode = DECODERS.decoder_for("protobuf", schema)
    assert schema.encoding == "protobuf" and decode, schema.name
    decoded = decode(message.data)
    assert decoded.ListFields() and decoded.DESCRIPTOR.full_name == schema.name, schema.name
    CHECKS.get(schema.name, lambda _: None)(decoded)


def main(path):
    counts, schemas, wires, last = Counter(), {}, Counter(), 0
    with open(path, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert reader.get_header().profile == "repose" and summary is not None and summary.chunk_indexes, "an indexed file of ours"
        assert all(chunk.compression == "zstd" for chunk in summary.chunk_indexes)
        about = {record.name: record.metadata for record in reader.iter_metadata()}
        assert about["repose"]["cell"] == "cell" and about["repose.end"]["lost"] == "0", about
        for schema, channel, message in reader.iter_messages():
            counts[channel.topic] += 1
            assert message.log_time >= last, "in the order of time"
            last = message.log_time
            if schema is None:
                wires[check_wire(channel, message)] += 1
            else:
                check_look(schema, message)
                schemas[channel.topic] = schema.name
    missing = {topic: name for topic, name in LOOKS.items() if schemas.get(topic) != name}
    assert not missing, f"not there to look at: {missing}"
    assert all(wires[wire] for wire in WIRE), f"not all of the wire: {dict(wires)}"
    print(json.dumps({"topics": dict(counts), "wire": dict(wires)}, indent=2))


if __name__ == "__main__":
    main(sys.argv[1])
