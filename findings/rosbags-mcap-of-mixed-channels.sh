#!/usr/bin/env bash
# rosbags 0.11.9 (PyPI), and evo through it, on MCAP files that hold ROS 2 messages.
# Without the profile "ros2" in the header it refuses the file, whatever its channels are. With the profile, one
# JSON channel beside them ends it with KeyError 'jsonschema' before a message of the ROS channel was read. So
# a recording for it must be of CDR channels alone; chunks, for once, it does not need.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet rosbags==0.11.9 mcap==1.6.0
venv/bin/python - <<'PY'
import pathlib, struct
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader

def outcome(profile, has_json, use_chunking):
    path = pathlib.Path("points.mcap")
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=use_chunking, compression=CompressionType.NONE)
        writer.start(profile=profile)
        schema = writer.register_schema("geometry_msgs/msg/Point", "ros2msg", b"float64 x\nfloat64 y\nfloat64 z\n")
        point = writer.register_channel("/point", "cdr", schema)
        if has_json:
            status = writer.register_channel("/status", "json", writer.register_schema("status", "jsonschema", b"{}"))
        for i in range(100):
            writer.add_message(point, i, b"\0\1\0\0" + struct.pack("<3d", i, 0, 0), i)
            if has_json:
                writer.add_message(status, i, b"{}", i)
        writer.finish()
    try:
        with AnyReader([path]) as reader:
            return sum(1 for _ in reader.messages())
    except Exception as error:
        return f"{type(error).__name__}: {error}"

for case, expected in [
    (("", False, True), "AnyReaderError: Profile is not ros2."),
    (("ros2", False, True), 100),
    (("ros2", False, False), 100),
    (("ros2", True, True), "KeyError: 'jsonschema'"),
]:
    found = outcome(*case)
    print("profile %r, a JSON channel %s, chunks %s:" % case, found)
    assert found == expected, (found, expected)
PY
