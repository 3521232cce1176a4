"""The frames written here against the published ones and against the vendor's client."""

import random
import struct
import unittest

from brping import definitions, pingmessage

import ping_wire as wire
from emulator import known_profile

TYPICAL = wire.PingParams(0, 5000, 0, 0.002, 0.0015, -1, 600, 1)


def vendor_frame(message_id, payload_dict, **values):
    message = pingmessage.PingMessage(message_id, payload_dict=payload_dict)
    for name, value in values.items():
        setattr(message, name, value)
    return bytes(message.pack_msg_data())


def vendor_parse(data):
    payloads = {**definitions.payload_dict_common, **definitions.payload_dict_omniscan450}
    parser = pingmessage.PingParser(payload_dict=payloads)
    return [
        parser.rx_msg for byte in data if parser.parse_byte(byte) == parser.NEW_MESSAGE
    ]


class PublishedFrames(unittest.TestCase):
    def test_general_request(self):
        frame = wire.encode(wire.GENERAL_REQUEST, struct.pack("<H", wire.DEVICE_INFORMATION))
        self.assertEqual(frame.hex(), "42520200060000000400a000")

    def test_set_speed_of_sound(self):
        frame = wire.encode(wire.SET_SPEED_OF_SOUND, struct.pack("<I", 1_500_000))
        self.assertEqual(frame.hex(), "425204007400000060e316006502")

    def test_os_ping_params(self):
        published = (
            "425224009508000000000000881300000000000000000000000000006f12033ba69bc43a"
            "ffff5802010000004707"
        )
        self.assertEqual(wire.encode(wire.OS_PING_PARAMS, TYPICAL.pack()).hex(), published)


class AgainstTheVendorsClient(unittest.TestCase):
    def test_ping_params_it_writes_are_read(self):
        written = vendor_frame(
            definitions.OMNISCAN450_OS_PING_PARAMS,
            definitions.payload_dict_omniscan450,
            start_mm=250, length_mm=30000, msec_per_ping=40, reserved_1=0, reserved_2=0,
            pulse_len_percent=0.002, filter_duration_percent=0.0015, gain_index=-1,
            num_results=1200, enable=1, reserved_3=0, reserved_4=0, reserved_5=0,
        )  # fmt: skip
        (frame,) = wire.Decoder().feed(written)
        params = wire.PingParams.unpack(frame.payload)
        self.assertEqual((params.start_mm, params.length_mm, params.msec_per_ping), (250, 30000, 40))
        self.assertEqual((params.gain_index, params.num_results, params.enable), (-1, 1200, 1))
        self.assertAlmostEqual(params.pulse_len_percent, 0.002, places=9)
        self.assertEqual(wire.encode(wire.OS_PING_PARAMS, params.pack()), written)

    def test_the_short_ping_params_are_read(self):
        self.assertEqual(
            wire.PingParams.unpack(TYPICAL.pack()[:34]), wire.PingParams.unpack(TYPICAL.pack())
        )

    def test_profiles_are_read_alike(self):
        for number, num_results in ((0, 1), (3, 200), (70_000, 600), (2**32 - 1, 1200)):
            params = wire.PingParams(500, 9500, 20, 0.002, 0.0015, -1, num_results, 1)
            profile = known_profile(number, params)
            data = wire.encode(wire.OS_MONO_PROFILE, profile.pack(), 1, 0)
            (message,) = vendor_parse(data)
            (frame,) = wire.Decoder().feed(data)
            ours = wire.Profile.unpack(frame.payload)
            for name in message.payload_field_names:
                if name not in ("reserved", "pwr_results"):
                    self.assertEqual(getattr(message, name), getattr(ours, name), name)
            theirs = struct.unpack(f"<{num_results}H", bytes(message.pwr_results))
            self.assertEqual(theirs, ours.pwr_results)
            self.assertEqual(ours.pwr_results, profile.pwr_results)


class Damage(unittest.TestCase):
    def frames(self, count):
        return [wire.encode(wire.OS_MONO_PROFILE, known_profile(k, TYPICAL).pack()) for k in range(count)]

    def test_stray_bytes_between_frames_lose_none(self):
        for stray in (b"B", b"BR", b"\x00\xff", b"BB", b"BR\xff\xff"):
            decoder = wire.Decoder()
            found = decoder.feed(b"".join(stray + frame for frame in self.frames(20)))
            self.assertEqual(len(found), 20, stray)
            self.assertEqual(decoder.bad_bytes, 20 * len(stray))

    def test_the_cut_of_the_stream_does_not_matter(self):
        data, cut = b"".join(self.frames(5)), random.Random(1)
        decoder, found = wire.Decoder(), []
        while data:
            length = cut.randrange(1, 400)
            found += decoder.feed(data[:length])
            data = data[length:]
        self.assertEqual([wire.Profile.unpack(frame.payload).ping_number for frame in found], list(range(5)))
        self.assertEqual(decoder.bad_bytes, 0)

    def test_a_damaged_byte_loses_one_frame(self):
        for at in (2, 3, 700, 1261):
            frames = self.frames(3)
            damaged = bytearray(frames[1])
            damaged[at] ^= 0x40
            found = wire.Decoder().feed(frames[0] + bytes(damaged) + frames[2] + bytes(5000))
            self.assertEqual(len(found), 2, at)


if __name__ == "__main__":
    unittest.main()
