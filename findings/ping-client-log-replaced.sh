#!/usr/bin/env bash
# bluerobotics-ping 0.2.5 (PyPI), class Omniscan450 with logging=True.
# A log's name has the minute and no seconds, and a file of that name is deleted when a log is opened.
# A program that is started again within a minute, as after a crash, loses what the run before recorded.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet bluerobotics-ping==0.2.5
venv/bin/python - <<'PY'
import pathlib, time
from brping import Omniscan450, definitions, pingmessage

if time.localtime().tm_sec > 50:
    time.sleep(61 - time.localtime().tm_sec)
profile = pingmessage.PingMessage(definitions.OMNISCAN450_OS_MONO_PROFILE)
profile.pwr_results = bytes(1200)
profile.num_results = 600
profile.pack_msg_data()
first = Omniscan450()
first.new_log("logs")
for _ in range(10):
    first.write_data(profile)
before, = pathlib.Path("logs").glob("*.svlog")
size = before.stat().st_size
second = Omniscan450()
second.new_log("logs")
after, = pathlib.Path("logs").glob("*.svlog")
print(f"{size} bytes of the first run, {after.stat().st_size} once the second began, under one name: {before == after}")
assert before == after and size > 12_000 and after.stat().st_size < 2_000
PY
