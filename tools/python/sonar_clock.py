"""Where a simulated dive is, as its sonar's pings tell: what is sent beside it can go in step with it.

The profiles of `echosplat emulate` bear the time of its dive, which begins when a client first has it
ping and stands while it is silent.
"""

import socket
import threading
import time

import ping_wire

# The dive stands when no ping came for so long.
SILENT_S = 1.0
# One that comes later than this after its time is not late: the dive stood meanwhile.
STOOD_NANOS = 500_000_000


class SonarClock:
    """The time of the dive of the sonar at (host, port), from the first ping on; None while it is silent."""

    def __init__(self, address):
        self._link = socket.create_connection(address, timeout=3.0)
        self._link.settimeout(None)
        self._lock = threading.Lock()
        self._offset_nanos = None
        self._heard = 0.0
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self):
        decoder = ping_wire.Decoder()
        while data := self._link.recv(65536):
            for frame in decoder.feed(data):
                if frame.message_id == ping_wire.OS_MONO_PROFILE:
                    self._take(ping_wire.Profile.unpack(frame.payload).timestamp_ms * 10**6)

    def _take(self, dive_nanos):
        offset = time.time_ns() - dive_nanos
        with self._lock:
            known = self._offset_nanos
            if known is None or offset < known or offset - known > STOOD_NANOS:
                self._offset_nanos = offset
            self._heard = time.monotonic()

    def offset_nanos(self):
        """Unix time over the dive's, of late; None while the sonar is silent."""
        with self._lock:
            is_silent = time.monotonic() - self._heard > SILENT_S
            return None if is_silent else self._offset_nanos
