#!/usr/bin/env bash
# eclipse-zenoh 1.10.2 (PyPI; the Rust library of the same version inside).
# connect/exit_on_failure = false with a connect timeout of 0 lets a session in mode "peer" open where nobody
# listens at its endpoint yet; it tries on in the background. In mode "client" the same settings are not heeded: opening fails at
# once. So a program that is started before its router has to be a peer, or to open again and again by itself.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet eclipse-zenoh==1.10.2
venv/bin/python - <<'PY'
import socket
import zenoh

with socket.create_server(("127.0.0.1", 0)) as taken:
    port = taken.getsockname()[1]

def outcome(mode):
    config = zenoh.Config()
    for key, value in [
        ("mode", f'"{mode}"'),
        ("connect/endpoints", f'["tcp/127.0.0.1:{port}"]'),
        ("connect/timeout_ms", "0"),
        ("connect/exit_on_failure", "false"),
        ("listen/endpoints", "[]"),
        ("scouting/multicast/enabled", "false"),
    ]:
        config.insert_json5(key, value)
    try:
        session = zenoh.open(config)
    except zenoh.ZError:
        return "refused"
    session.close()
    return "open"

found = {mode: outcome(mode) for mode in ("peer", "client")}
print(found)
assert found == {"peer": "open", "client": "refused"}
PY
