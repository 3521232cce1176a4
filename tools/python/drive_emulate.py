"""Drives a sonar with the vendor's public client and checks every field of every profile.

    python drive_emulate.py tcp://127.0.0.1:51200 --count 1000
    python drive_emulate.py udp://127.0.0.1:51200
    python drive_emulate.py serial:///tmp/sonar?baudrate=115200

Prints one JSON object; exits with 1 if a profile was lost, a field was wrong, or the unit went on
pinging after enable = 0.
"""

import argparse
import contextlib
import json
import math
import socket
import sys
import time
from urllib.parse import parse_qs, urlsplit

from brping import definitions
from brping.omniscan450 import Omniscan450

PROFILE = definitions.OMNISCAN450_OS_MONO_PROFILE
# A unit that was pinging already may finish what it was asked before.
MAX_LEADING = 20
MAX_FAULTS_LISTED = 20


class Client(Omniscan450):
    """The vendor's client, but for reading sockets: its own way spins until bytes come, and so
    never notices silence."""

    def read_io(self):
        if not isinstance(self.iodev, socket.socket):
            super().read_io()
            return
        with contextlib.suppress(BlockingIOError):
            data = self.iodev.recv(65536)
            if not data and self.iodev.type == socket.SOCK_STREAM:
                raise ConnectionError("the sonar closed the connection")
            self._input_buffer.extendleft(data)


def connect(url):
    """The vendor's client, connected as the URL says."""
    parts = urlsplit(url)
    sonar = Client()
    if parts.scheme == "tcp":
        sonar.connect_tcp(parts.hostname, parts.port)
    elif parts.scheme == "udp":
        sonar.connect_udp(parts.hostname, parts.port)
    elif parts.scheme == "serial":
        baudrate = int(parse_qs(parts.query).get("baudrate", ["115200"])[0])
        sonar.connect_serial(parts.path, baudrate)
    else:
        raise SystemExit(f"{url}: must begin with tcp://, udp:// or serial://")
    return sonar


def shows(profile, asked):
    """Whether the profile was made with the settings asked for."""
    return all(getattr(profile, name) == asked[name] for name in ("start_mm", "length_mm", "num_results"))


def faults_alone(profile):
    """What is wrong with one profile, whatever came before it."""
    results, scale = profile.pwr_results, (profile.min_pwr_db, profile.max_pwr_db)
    checks = {
        "results against num_results": len(results) == profile.num_results,
        "results within u16": all(0 <= result <= 65535 for result in results),
        "some contrast": len(set(results)) > 1,
        "finite decibel scale": all(map(math.isfinite, scale)) and -200 < scale[0] < scale[1] < 200,
        "ping_hz": 400_000 <= profile.ping_hz <= 500_000,
        "gain_index": 0 <= profile.gain_index <= 7,
        "sos_dmps": 14_000 <= profile.sos_dmps <= 16_000,
        "reserved": profile.reserved == 0,
        "pulse_duration_sec": 0 < profile.pulse_duration_sec < 0.01,
        "analog_gain": math.isfinite(profile.analog_gain),
        "headings": all(
            -360 <= heading <= 360
            for heading in (profile.transducer_heading_deg, profile.vehicle_heading_deg)
        ),
    }
    return [name for name, holds in checks.items() if not holds]


def faults_between(earlier, later):
    """What is wrong with a profile after the one before it; and how many are missing."""
    missing = later.ping_number - earlier.ping_number - 1
    faults = []
    if missing != 0:
        faults.append(f"ping_number {later.ping_number} after {earlier.ping_number}")
    if later.timestamp_ms <= earlier.timestamp_ms:
        faults.append(f"timestamp_ms {later.timestamp_ms} after {earlier.timestamp_ms}")
    if later.channel_number != earlier.channel_number:
        faults.append("channel_number changed")
    return faults, abs(missing)


def read_profiles(sonar, asked, count, deadline):
    """Reads `count` profiles of the settings asked for. Returns how many came, how many of other
    settings came first, how many are missing between them, and what was wrong."""
    received, leading, missing, faults, earlier = 0, 0, 0, [], None
    while received < count and time.monotonic() < deadline:
        profile = sonar.wait_message([PROFILE], timeout=1.0)
        if profile is None:
            continue
        if received == 0 and leading < MAX_LEADING and not shows(profile, asked):
            leading += 1
            continue
        found = faults_alone(profile)
        if not shows(profile, asked):
            found.append("settings are not those asked for")
        if earlier is not None:
            between, gap = faults_between(earlier, profile)
            found += between
            missing += gap
        faults += [f"profile {profile.ping_number}: {fault}" for fault in found]
        received, earlier = received + 1, profile
    return received, leading, missing, faults


def stops(sonar, deadline):
    """Whether the unit falls silent after enable = 0, or hangs up."""
    sonar.control_os_ping_params(enable=0)
    with contextlib.suppress(OSError):
        while sonar.wait_message([PROFILE], timeout=0.5) is not None:
            if time.monotonic() > deadline:
                return False
    return True


def drive(url, count, asked, timeout_s):
    """The result as one dictionary."""
    began = time.monotonic()
    deadline = began + timeout_s
    sonar = connect(url)
    identity = sonar.get_device_information() if sonar.initialize() else None
    sonar.control_os_ping_params(**asked, enable=1)
    received, leading, missing, faults = read_profiles(sonar, asked, count, deadline)
    stopped = stops(sonar, deadline + 5.0)
    return {
        "url": url,
        "device_type": identity and identity["device_type"],
        "profiles": received,
        "profiles_leading": leading,
        "profiles_missing": missing + count - received,
        # Status messages among them, which the client does not know.
        "frames_not_understood": sonar.parser.errors,
        "faults": len(faults),
        "faults_listed": faults[:MAX_FAULTS_LISTED],
        "stopped": stopped,
        "seconds": round(time.monotonic() - began, 3),
        "passed": bool(identity) and stopped and not faults and not missing and received == count,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("url", help="tcp://host:port, udp://host:port or serial:///dev/…")
    parser.add_argument("--count", type=int, default=1000, help="profiles to read")
    parser.add_argument("--start-mm", type=int, default=0)
    parser.add_argument("--length-mm", type=int, default=10_000)
    parser.add_argument("--num-results", type=int, default=600)
    parser.add_argument("--msec-per-ping", type=int, default=0)
    parser.add_argument("--timeout", type=float, default=120.0, metavar="S")
    arguments = parser.parse_args()
    asked = {
        name: getattr(arguments, name)
        for name in ("start_mm", "length_mm", "num_results", "msec_per_ping")
    }
    # The vendor's client prints what it does; standard output is for the result.
    with contextlib.redirect_stdout(sys.stderr):
        result = drive(arguments.url, arguments.count, asked, arguments.timeout)
    print(json.dumps(result))
    return 0 if result["passed"] else 1


if __name__ == "__main__":
    sys.exit(main())
