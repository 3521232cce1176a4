#!/usr/bin/env bash
# bluerobotics-ping 0.2.5 (PyPI), class Omniscan450 with logging=True.
# The session packet of its .svlog is stamped when the log is opened, and opening it starts no ping.
# A profile carries only milliseconds since the unit's power-up. So no field of the log tells how long
# after the stamp the first profile came: a reader that takes the stamp for the first profile's time is
# off by however long the operator waited. Here the first profile comes 2 s after the log is opened.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet bluerobotics-ping==0.2.5
venv/bin/python - <<'PY'
import datetime, json, pathlib, socket, struct, threading, time
from brping import Omniscan450, definitions

def frame(message_id, payload):
    head = struct.pack("<2sHHBB", b"BR", len(payload), message_id, 1, 0) + payload
    return head + struct.pack("<H", sum(head) & 0xFFFF)

def profile(number, since_power_up_ms):
    bins = [(7 * i + number) % 65536 for i in range(600)]
    fields = (number, 0, 10_000, since_power_up_ms, 451_127, 4, 600, 15_000, 0, 0,
              0.00005, 74.5, 60.0, -10.0, 0.0, 0.0)
    return frame(2198, struct.pack("<IIIIIHHHBBffffff", *fields) + struct.pack("<600H", *bins))

listener = socket.create_server(("127.0.0.1", 0))
go_on = threading.Event()

def unit():
    client, _ = listener.accept()
    client.recv(100)
    client.sendall(frame(4, bytes([104, 2, 1, 5, 6, 0])))
    go_on.wait()
    client.sendall(profile(0, 81_000))
    client.recv(1)

threading.Thread(target=unit, daemon=True).start()
sonar = Omniscan450(logging=True, log_directory="logs")
sonar.connect_tcp(*listener.getsockname())
assert sonar.initialize()
time.sleep(2.0)
go_on.set()
message = sonar.wait_message([definitions.OMNISCAN450_OS_MONO_PROFILE], timeout=5)
heard = time.time()
log = next(pathlib.Path("logs").glob("*.svlog")).read_bytes()
length, message_id = struct.unpack_from("<HH", log, 2)
session = json.loads(log[8:8 + length])
stamped = datetime.datetime.fromisoformat(session["timestamp"]).timestamp()
print(f"packet {message_id} is stamped {heard - stamped:.1f} s before the first profile was heard")
print("uptimes that it holds:", {k: session[k] for k in ("session_uptime", "os_uptime")})
assert message_id == 10 and heard - stamped > 1.9
assert session["session_uptime"] == 0.0 and session["os_uptime"] is None
assert log[8 + length + 2:][:2] == b"BR" and message.timestamp_ms == 81_000
PY
