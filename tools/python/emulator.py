"""An OmniScan 450 on a serial line, for testing hosts: every field of every profile is known.

    python emulator.py --pty /tmp/sonar --count 1000      makes a pseudo-terminal with that link
    python emulator.py --port /dev/ttyUSB0                speaks over a real line

Prints a JSON line when it is ready, when `--count` profiles are out, and when it is done: at the
host's enable = 0 after that, at SIGTERM or SIGINT, or after `--timeout` seconds.

Profile k (from 0 at power-up) holds, whatever was lost before it:

    start_mm, length_mm, num_results   as asked
    timestamp_ms                       5000 + k * interval_ms, modulo 2**32
    ping_hz, channel_number            451127, 0
    gain_index                         as asked; automatic: 0, 4, 5, 6, 7, 7, ...
    sos_dmps                           15000, or as set by the host
    pulse_duration_sec                 pulse_len_percent * two-way time to the range's end
    analog_gain                        gain_index * 3
    max_pwr_db, min_pwr_db             60 + k % 8, -40 - k % 4
    transducer_heading_deg             0
    vehicle_heading_deg                k % 360
    pwr_results[i]                     (7 * k + 109 * i) % 65536

interval_ms is msec_per_ping, or for 0 the two-way time plus 3.5 ms, rounded up.
"""

import argparse
import json
import math
import os
import random
import signal
import struct
import threading
import time
import tty
from collections import Counter

import serial

import ping_wire as wire

AUTOMATIC_GAIN = (0, 4, 5, 6, 7)
DEVICE_ID, HOST_ID = 1, 0
# Vendor's type of a real FS unit, revision 2, firmware 1.5.6; protocol 1.0.0.
DEVICE_INFORMATION = bytes((104, 2, 1, 5, 6, 0))
PROTOCOL_VERSION = bytes((1, 0, 0, 0))


def interval_ms(params):
    """Time between pings, in whole milliseconds of the device's clock."""
    two_way_ms = 2 * (params.start_mm + params.length_mm) / 1500
    return params.msec_per_ping or math.ceil(two_way_ms + 3.5)


def known_profile(number, params, sos_dmps=15000):
    """The profile with this ping number, by the formulas above."""
    gain = params.gain_index
    if gain < 0:
        gain = AUTOMATIC_GAIN[min(number, len(AUTOMATIC_GAIN) - 1)]
    two_way_s = 2 * (params.start_mm + params.length_mm) / (100 * sos_dmps)
    return wire.Profile(
        ping_number=number,
        start_mm=params.start_mm,
        length_mm=params.length_mm,
        timestamp_ms=(5000 + number * interval_ms(params)) % 2**32,
        ping_hz=451127,
        gain_index=gain,
        num_results=params.num_results,
        sos_dmps=sos_dmps,
        channel_number=0,
        pulse_duration_sec=params.pulse_len_percent * two_way_s,
        analog_gain=gain * 3.0,
        max_pwr_db=60.0 + number % 8,
        min_pwr_db=-40.0 - number % 4,
        transducer_heading_deg=0.0,
        vehicle_heading_deg=float(number % 360),
        pwr_results=tuple((7 * number + 109 * i) % 65536 for i in range(params.num_results)),
    )


class Device:
    """What the unit does with bytes, without a line or a clock."""

    def __init__(self, count, noise_seed=None):
        self.count = count
        self.params = None
        self.sos_dmps = 15000
        self.profiles_sent = 0
        self.noise_bytes_sent = 0
        self.enables = 0
        self.disables = 0
        self.requests = Counter()
        self._decoder = wire.Decoder()
        self._noise = None if noise_seed is None else random.Random(noise_seed)

    @property
    def is_pinging(self):
        return self.params is not None and self.profiles_sent < self.count

    @property
    def is_done(self):
        return self.params is None and self.profiles_sent >= self.count

    def receive(self, data):
        """What to send back for the host's bytes."""
        return b"".join(self._answer(frame) for frame in self._decoder.feed(data))

    def next_profile(self):
        """The bytes of the next ping."""
        profile = known_profile(self.profiles_sent, self.params, self.sos_dmps)
        self.profiles_sent += 1
        return self._send(wire.OS_MONO_PROFILE, profile.pack())

    def report(self):
        return {
            "event": "done",
            "profiles_sent": self.profiles_sent,
            "noise_bytes_sent": self.noise_bytes_sent,
            "enables": self.enables,
            "disables": self.disables,
            "requests": {str(number): times for number, times in sorted(self.requests.items())},
            "sos_dmps": self.sos_dmps,
            "bad_bytes": self._decoder.bad_bytes,
        }

    def _answer(self, frame):
        try:
            return self._handle(frame)
        except struct.error as error:
            return self._nack(frame.message_id, str(error))

    def _handle(self, frame):
        if frame.message_id == wire.GENERAL_REQUEST:
            return self._handle_request(*struct.unpack("<H", frame.payload))
        if frame.message_id == wire.SET_SPEED_OF_SOUND:
            (millimetres_per_s,) = struct.unpack("<I", frame.payload)
            self.sos_dmps = millimetres_per_s // 100
            return self._send(wire.ACK, struct.pack("<H", frame.message_id))
        if frame.message_id == wire.OS_PING_PARAMS:
            self._set_params(wire.PingParams.unpack(frame.payload))
            return b""
        return self._nack(frame.message_id, "unknown message")

    def _handle_request(self, requested):
        self.requests[requested] += 1
        answers = {
            wire.DEVICE_INFORMATION: DEVICE_INFORMATION,
            wire.PROTOCOL_VERSION: PROTOCOL_VERSION,
            wire.SYNC_CHANNEL_NUMBER: bytes((0, 1)),
        }
        if requested in answers:
            return self._send(requested, answers[requested])
        return self._nack(requested, "cannot be requested")

    def _set_params(self, params):
        if params.enable:
            self.enables += 1
            self.params = params
        else:
            self.disables += 1
            self.params = None

    def _nack(self, message_id, text):
        return self._send(wire.NACK, struct.pack("<H", message_id) + text.encode())

    def _send(self, message_id, payload):
        return self._stray_bytes() + wire.encode(message_id, payload, DEVICE_ID, HOST_ID)

    def _stray_bytes(self):
        """None to seven bytes of line noise, now and then what looks like a frame's start."""
        if self._noise is None:
            return b""
        stray = self._noise.randbytes(self._noise.randrange(6))
        stray += self._noise.choice((b"", b"", b"B", b"BR"))
        self.noise_bytes_sent += len(stray)
        return stray


def null_modem(link):
    """Two pseudo-terminals wired to one another: `link` leads to the host's end, the path that is
    returned is ours. The threads that copy end with the program."""
    ours, theirs = os.openpty(), os.openpty()
    for _, terminal in (ours, theirs):
        tty.setraw(terminal)
    for source, sink in ((ours[0], theirs[0]), (theirs[0], ours[0])):
        threading.Thread(target=_copy, args=(source, sink), daemon=True).start()
    if os.path.islink(link):
        os.unlink(link)
    os.symlink(os.ttyname(theirs[1]), link)
    return os.ttyname(ours[1])


def _copy(source, sink):
    while data := os.read(source, 4096):
        view = memoryview(data)
        while view:
            view = view[os.write(sink, view) :]


def serve(device, port, pace_ms=None, deadline=math.inf):
    """Speaks over the open port until the device is done or time is up.

    Pings every `pace_ms` (0: as fast as the line takes them), or as the host asked."""
    due = 0.0
    while not device.is_done and time.monotonic() < deadline:
        now = time.monotonic()
        if not device.is_pinging:
            due = now
            port.timeout = 0.05
        else:
            port.timeout = min(max(due - now, 0.0), 0.05)
        data = port.read(max(port.in_waiting, 1))
        if answer := device.receive(data):
            port.write(answer)
        if device.is_pinging and time.monotonic() >= due:
            pace = interval_ms(device.params) if pace_ms is None else pace_ms
            due += pace / 1000
            port.write(device.next_profile())
            if not device.is_pinging:
                announce({"event": "sent", "profiles_sent": device.profiles_sent})


def announce(event):
    print(json.dumps(event), flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    line = parser.add_mutually_exclusive_group(required=True)
    line.add_argument("--port", help="serial device to speak over")
    line.add_argument("--pty", metavar="LINK", help="make a pseudo-terminal with this link")
    parser.add_argument("--baudrate", type=int, default=115200)
    parser.add_argument("--count", type=int, default=2**31, help="profiles to send")
    parser.add_argument("--pace-ms", type=float, help="time between pings; 0: what the line takes")
    parser.add_argument("--noise", type=int, metavar="SEED", help="strew stray bytes")
    parser.add_argument("--timeout", type=float, default=math.inf, metavar="S", help="give up then")
    arguments = parser.parse_args()

    def stop(*_):
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, stop)
    device = Device(arguments.count, arguments.noise)
    path = arguments.port or null_modem(arguments.pty)
    deadline = time.monotonic() + arguments.timeout
    try:
        with serial.Serial(path, arguments.baudrate) as port:
            announce({"event": "ready", "port": arguments.port or arguments.pty})
            serve(device, port, arguments.pace_ms, deadline)
    except KeyboardInterrupt:
        pass
    finally:
        if arguments.pty and os.path.islink(arguments.pty):
            os.unlink(arguments.pty)
    announce(device.report())


if __name__ == "__main__":
    main()
