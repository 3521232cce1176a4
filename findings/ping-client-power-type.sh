#!/usr/bin/env bash
# bluerobotics-ping 0.2.5 (PyPI), class Omniscan450.
# The same profile has pwr_results in two types: wait_message() gives a tuple of 16-bit numbers,
# get_os_mono_profile() gives the bytes, twice as many. Code that takes pwr_results[i] for bin i works with the
# one and reads single bytes, 0 to 255, with the other, without an error.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet bluerobotics-ping==0.2.5
venv/bin/python - <<'PY'
import socket, struct, threading
from brping import Omniscan450, definitions

def frame(message_id, payload):
    head = struct.pack("<2sHHBB", b"BR", len(payload), message_id, 1, 0) + payload
    return head + struct.pack("<H", sum(head) & 0xFFFF)

fields = (0, 0, 10_000, 1_000, 451_127, 4, 200, 15_000, 0, 0, 0.00005, 74.5, 60.0, -10.0, 0.0, 0.0)
profile = frame(2198, struct.pack("<IIIIIHHHBBffffff", *fields) + struct.pack("<200H", *range(1000, 1200)))
listener = socket.create_server(("127.0.0.1", 0))

def unit():
    client, _ = listener.accept()
    while client.recv(100):
        client.sendall(profile)

threading.Thread(target=unit, daemon=True).start()
sonar = Omniscan450()
sonar.connect_tcp(*listener.getsockname())
sonar.write(b"\0")
waited = sonar.wait_message([definitions.OMNISCAN450_OS_MONO_PROFILE], timeout=5).pwr_results
asked = sonar.get_os_mono_profile()["pwr_results"]
print(f"wait_message: {type(waited).__name__} of {len(waited)}, begins with {list(waited[:2])}")
print(f"get_os_mono_profile: {type(asked).__name__} of {len(asked)}, begins with {list(asked[:2])}")
assert type(waited) is tuple and len(waited) == 200 and waited[0] == 1000
assert isinstance(asked, (bytes, bytearray)) and len(asked) == 400 and asked[0] == 1000 % 256
PY
