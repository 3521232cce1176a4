#!/usr/bin/env bash
# rerun-sdk 0.41.0 (PyPI) on an MCAP file that was written without chunks, which the format allows.
# `rerun mcap info` counts its 100 messages (from the statistics), `rerun mcap check` finds nothing wrong, and
# `rerun mcap convert` ends with exit code 0 and not one message in the .rrd. The same messages in a chunk
# arrive whole. So a recorder that writes no chunks, to lose little at a kill, is unreadable there in silence.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export HOME="$folder"
python3 -m venv venv
venv/bin/pip install --quiet rerun-sdk==0.41.0 mcap==1.6.0
venv/bin/rerun analytics disable >/dev/null 2>&1
venv/bin/python - <<'PY'
import re, struct, subprocess
from mcap.writer import CompressionType, Writer

def rows(use_chunking):
    with open("points.mcap", "wb") as file:
        writer = Writer(file, use_chunking=use_chunking, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        schema = writer.register_schema("geometry_msgs/msg/Point", "ros2msg", b"float64 x\nfloat64 y\nfloat64 z\n")
        channel = writer.register_channel("/point", "cdr", schema)
        for i in range(100):
            at = 10**18 + i * 10**7
            writer.add_message(channel, at, b"\0\1\0\0" + struct.pack("<3d", i, 0, 0), at)
        writer.finish()
    def rerun(*arguments):
        run = subprocess.run(["venv/bin/rerun", *arguments], capture_output=True, text=True)
        assert run.returncode == 0, run
        return run.stdout + run.stderr
    told = int(re.search(r"Messages\s+(\d+)", rerun("mcap", "info", "points.mcap"))[1])
    checked = rerun("mcap", "check", "points.mcap")
    rerun("mcap", "convert", "points.mcap", "-o", "points.rrd")
    most = int(re.search(r"num_rows_max = (\d+)", rerun("rrd", "stats", "points.rrd"))[1])
    return told, most, "error" in checked.lower()

for use_chunking in (True, False):
    told, most, is_error = rows(use_chunking)
    print(f"chunks {use_chunking}: info tells {told} messages, check an error: {is_error}, most rows of an entity {most}")
    assert told == 100 and not is_error
    assert most == (100 if use_chunking else 1)
PY
