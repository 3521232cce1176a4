"""The published vectors of the firmware protocol, read by this code and by the vendor's client."""

import dataclasses
import os
import struct
import unittest

from brping import definitions, pingmessage

import ping_wire as wire

try:
    import tomllib
except ImportError:
    import tomli as tomllib

FOLDER = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../firmware-protocol/vectors")
PAYLOADS = {**definitions.payload_dict_common, **definitions.payload_dict_omniscan450}
# What the vectors and the vendor call differently.
VENDOR_NAMES = {
    "speed_of_sound_mmps": "speed_of_sound",
    "channel_count": "number_of_channels",
    "text": None,
    "hex": None,
    "firmware": None,
    "version": None,
    "type": None,
    "values": None,
    "short_payload": None,
}


def vectors(name):
    with open(os.path.join(FOLDER, f"{name}.toml"), "rb") as file:
        return tomllib.load(file)


def single(number):
    """As it is after four bytes."""
    return struct.unpack("<f", struct.pack("<f", number))[0] if isinstance(number, float) else number


class Vectors(unittest.TestCase):
    def decode(self, vector):
        (frame,) = wire.Decoder().feed(bytes.fromhex(vector["hex"]))
        self.assertEqual((frame.source, frame.destination), (vector["src_device_id"], vector["dst_device_id"]))
        return frame

    def test_messages_say_here_what_they_say_there(self):
        seen = set()
        for vector in vectors("messages")["frame"]:
            with self.subTest(vector["name"]):
                frame, message = self.decode(vector), vector["message"]
                kind = {wire.OS_PING_PARAMS: wire.PingParams, wire.OS_MONO_PROFILE: wire.Profile}
                if frame.message_id not in kind:
                    continue
                ours = dataclasses.asdict(kind[frame.message_id].unpack(frame.payload))
                for name, value in message.items():
                    if name not in ("type", "short_payload"):
                        value = tuple(value) if isinstance(value, list) else single(value)
                        self.assertEqual(ours[name], value, name)
                seen.add(frame.message_id)
        self.assertEqual(seen, {wire.OS_PING_PARAMS, wire.OS_MONO_PROFILE})

    def test_messages_say_the_same_to_the_vendors_client(self):
        compared = 0
        for vector in vectors("messages")["frame"]:
            message = vector["message"]
            frame = self.decode(vector)
            if frame.message_id not in PAYLOADS or message.get("short_payload"):
                continue
            parser = pingmessage.PingParser(payload_dict=PAYLOADS)
            states = [parser.parse_byte(byte) for byte in bytes.fromhex(vector["hex"])]
            self.assertEqual(states[-1], parser.NEW_MESSAGE, vector["name"])
            for name, value in message.items():
                name = VENDOR_NAMES.get(name, name)
                if name is None:
                    continue
                theirs = getattr(parser.rx_msg, name)
                if name == "pwr_results":
                    theirs, value = bytes(theirs), struct.pack(f"<{len(value)}H", *value)
                with self.subTest(vector["name"], field=name):
                    self.assertEqual(theirs, single(value))
                    compared += 1
        self.assertGreater(compared, 40)

    def test_streams_hold_the_same_frames_and_stray_bytes(self):
        for vector in vectors("streams")["stream"]:
            with self.subTest(vector["name"]):
                decoder = wire.Decoder()
                found = decoder.feed(bytes.fromhex(vector["hex"])) + decoder.finish()
                found = [
                    wire.encode(frame.message_id, frame.payload, frame.source, frame.destination)
                    for frame in found
                ]
                events = vector["events"]
                frames = [bytes.fromhex(event["frame_hex"]) for event in events if "frame_hex" in event]
                self.assertEqual(found, frames)
                self.assertEqual(decoder.bad_bytes, sum(event.get("skipped", 0) for event in events))


if __name__ == "__main__":
    unittest.main()
