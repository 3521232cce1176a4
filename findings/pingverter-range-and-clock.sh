#!/usr/bin/env bash
# pingverter 2.1.7 (PyPI), cerul2pingmapper, on an .svlog with profiles from 2 m over a length of 8 m (2 to 10 m).
# 1. It takes length_mm for the far end: max_range is 8 m, a bin is (8 − 2)/600 m wide instead of 8/600 m, and so
#    every echo but that in the first bin is drawn too near, by a quarter of its distance from there.
# 2. A first packet without process_uptime ends it with KeyError, though it then uses that number for MAVLink alone.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export HOME="$folder"
python3 -m venv venv
venv/bin/pip install --quiet pingverter==2.1.7
venv/bin/python - >log.txt 2>&1 <<'PY' || { cat log.txt; exit 1; }
import glob, json, os, struct
import pandas
from pingverter import cerul2pingmapper

def frame(message_id, payload):
    head = struct.pack("<2sHHBB", b"BR", len(payload), message_id, 1, 0) + payload
    return head + struct.pack("<H", sum(head) & 0xFFFF)

def profile(number):
    fields = (number, 2_000, 8_000, 5_000 + 20 * number, 451_127, 4, 600, 15_000, number % 2, 0,
              0.00005, 74.5, 60.0, -10.0, 0.0, 0.0)
    return frame(2198, struct.pack("<IIIIIHHHBBffffff", *fields) + struct.pack("<600H", *range(600)))

def convert(session, folder):
    os.mkdir(folder)
    with open("dive.svlog", "wb") as log:
        log.write(frame(10, json.dumps(session).encode()))
        for number in range(40):
            log.write(profile(number))
    cerul2pingmapper("dive.svlog", folder, nchunk=20, tempC=10)
    return pandas.concat(pandas.read_csv(name) for name in glob.glob(f"{folder}/**/*.csv", recursive=True))

session = {"session_id": 1, "session_uptime": 5.0, "session_devices": [{"url": "tcp://192.168.2.92:51200", "product_id": "os450"}],
           "session_platform": None, "os_uptime": 5.0, "process_uptime": 1.0,
           "timestamp": "2026-01-01T00:00:00.000+00:00", "timestamp_timezone_offset": 0}
rows = convert(session, "whole")
far, pixel = rows["max_range"].iloc[0], rows["pixM"].iloc[0]
try:
    del session["process_uptime"]
    convert(session, "without")
    second = "none"
except KeyError as error:
    second = f"KeyError {error}"
print(f"far end {far} m for 10 m, {1000 * pixel:.2f} mm a bin for {8000 / 600:.2f} mm; without process_uptime: {second}")
assert abs(far - 8.0) < 1e-6 and abs(pixel - 6 / 600) < 1e-6 and second == "KeyError 'process_uptime'"
PY
tail -n 1 log.txt
