"""The Ping wire format as the OmniScan 450 speaks it, written a second time.

Shares nothing with the Rust crate, so that the two can be held against one another. A frame is
`BR`, payload length u16, message id u16, source u8, destination u8, the payload, and the sum of
all bytes before it modulo 65536 as u16; everything little-endian.
"""

import struct
from dataclasses import dataclass, fields

ACK, NACK = 1, 2
DEVICE_INFORMATION, PROTOCOL_VERSION, GENERAL_REQUEST = 4, 5, 6
SET_SPEED_OF_SOUND = 116
SYNC_CHANNEL_NUMBER = 169
OS_PING_PARAMS, OS_MONO_PROFILE = 2197, 2198

_HEADER = struct.Struct("<2sHHBB")
_CHECKSUM = struct.Struct("<H")
_PING_PARAMS = struct.Struct("<3I8x2fhHB3x")
_PING_PARAMS_SHORT = struct.Struct("<3I8x2fhHBx")
_PROFILE = struct.Struct("<5I3HBx6f")
# No payload of these devices is longer: a profile of 1200 results takes 2452 bytes.
_MAX_PAYLOAD = 4096


@dataclass(frozen=True)
class Frame:
    """One intact frame."""

    message_id: int
    source: int
    destination: int
    payload: bytes


@dataclass(frozen=True)
class PingParams:
    """os_ping_params; millimetres, milliseconds, fractions of the two-way time."""

    start_mm: int
    length_mm: int
    msec_per_ping: int
    pulse_len_percent: float
    filter_duration_percent: float
    gain_index: int
    num_results: int
    enable: int

    def pack(self):
        return _PING_PARAMS.pack(*(getattr(self, field.name) for field in fields(self)))

    @classmethod
    def unpack(cls, payload):
        """Takes both published lengths, 36 and 34 bytes."""
        layout = _PING_PARAMS_SHORT if len(payload) == 34 else _PING_PARAMS
        return cls(*layout.unpack(payload))


@dataclass(frozen=True)
class Profile:
    """os_mono_profile; millimetres, milliseconds, decimetres per second, decibels, degrees."""

    ping_number: int
    start_mm: int
    length_mm: int
    timestamp_ms: int
    ping_hz: int
    gain_index: int
    num_results: int
    sos_dmps: int
    channel_number: int
    pulse_duration_sec: float
    analog_gain: float
    max_pwr_db: float
    min_pwr_db: float
    transducer_heading_deg: float
    vehicle_heading_deg: float
    pwr_results: tuple

    def pack(self):
        *settings, results = (getattr(self, field.name) for field in fields(self))
        return _PROFILE.pack(*settings) + struct.pack(f"<{len(results)}H", *results)

    @classmethod
    def unpack(cls, payload):
        settings = _PROFILE.unpack_from(payload)
        results = struct.unpack(f"<{settings[6]}H", payload[_PROFILE.size :])
        return cls(*settings, results)


def encode(message_id, payload=b"", source=0, destination=0):
    """The bytes of one frame."""
    frame = _HEADER.pack(b"BR", len(payload), message_id, source, destination) + payload
    return frame + _CHECKSUM.pack(sum(frame) & 0xFFFF)


class Decoder:
    """Finds intact frames in a stream; counts the bytes that belong to none."""

    def __init__(self):
        self.bad_bytes = 0
        self._pending = bytearray()

    def feed(self, data):
        """The frames that these bytes complete, in order."""
        self._pending += data
        frames = []
        while (step := self._next()) is not None:
            frame, byte_count = step
            if frame is None:
                self.bad_bytes += byte_count
            else:
                frames.append(frame)
            del self._pending[:byte_count]
        return frames

    def finish(self):
        """The frames left when no more bytes come: within what looked like a frame's start."""
        frames = []
        while self._pending:
            self.bad_bytes += 1
            del self._pending[0]
            frames += self.feed(b"")
        return frames

    def _next(self):
        """A frame or None for stray bytes, and their count; None when bytes are missing."""
        pending = self._pending
        start = pending.find(b"B")
        if start != 0:
            stray = len(pending) if start < 0 else start
            return (None, stray) if stray else None
        if len(pending) >= 2 and pending[1] != ord("R"):
            return None, 1
        if len(pending) < _HEADER.size:
            return None
        _, length, message_id, source, destination = _HEADER.unpack_from(pending)
        if length > _MAX_PAYLOAD:
            return None, 1
        end = _HEADER.size + length
        if len(pending) < end + _CHECKSUM.size:
            return None
        (checksum,) = _CHECKSUM.unpack_from(pending, end)
        if checksum != sum(pending[:end]) & 0xFFFF:
            return None, 1
        payload = bytes(pending[_HEADER.size : end])
        return Frame(message_id, source, destination, payload), end + _CHECKSUM.size
