"""The emulated device, alone and driven by the vendor's client over a pseudo-terminal."""

import dataclasses
import json
import os
import signal
import struct
import subprocess
import sys
import tempfile
import unittest

import drive_emulate
import emulator
import ping_wire as wire

HERE = os.path.dirname(os.path.abspath(__file__))
# Through the wire and back, so that fractions are single precision as the device sees them.
PARAMS = wire.PingParams.unpack(
    wire.PingParams(0, 10_000, 0, 0.002, 0.0015, -1, 600, 1).pack()
)


def request(message_id):
    return wire.encode(wire.GENERAL_REQUEST, struct.pack("<H", message_id))


def enable(on):
    return wire.encode(wire.OS_PING_PARAMS, dataclasses.replace(PARAMS, enable=on).pack())


class Alone(unittest.TestCase):
    def answers(self, device, data):
        return wire.Decoder().feed(device.receive(data))

    def test_requests_are_answered(self):
        device = emulator.Device(count=1)
        (identity,) = self.answers(device, request(wire.DEVICE_INFORMATION))
        self.assertEqual(identity.payload, bytes((104, 2, 1, 5, 6, 0)))
        (refused,) = self.answers(device, request(1002))
        self.assertEqual((refused.message_id, refused.payload[:2]), (wire.NACK, b"\xea\x03"))
        self.assertEqual(device.report()["requests"], {"4": 1, "1002": 1})

    def test_the_speed_of_sound_is_taken_over_and_acknowledged(self):
        device = emulator.Device(count=1)
        message = wire.encode(wire.SET_SPEED_OF_SOUND, struct.pack("<I", 1_480_000))
        (answer,) = self.answers(device, message)
        self.assertEqual((answer.message_id, answer.payload), (wire.ACK, b"\x74\x00"))
        device.receive(enable(1))
        (frame,) = wire.Decoder().feed(device.next_profile())
        self.assertEqual(wire.Profile.unpack(frame.payload).sos_dmps, 14_800)

    def test_it_pings_from_enable_to_disable(self):
        device = emulator.Device(count=10)
        self.assertFalse(device.is_pinging)
        device.receive(enable(1))
        self.assertTrue(device.is_pinging)
        device.next_profile()
        device.receive(enable(0))
        self.assertFalse(device.is_pinging)
        self.assertFalse(device.is_done)
        report = device.report()
        self.assertEqual((report["enables"], report["disables"], report["profiles_sent"]), (1, 1, 1))

    def test_a_wrong_length_is_refused(self):
        (answer,) = self.answers(emulator.Device(count=1), wire.encode(wire.OS_PING_PARAMS, bytes(35)))
        self.assertEqual(answer.message_id, wire.NACK)

    def test_noise_lies_between_the_profiles(self):
        device = emulator.Device(count=500, noise_seed=7)
        device.receive(enable(1))
        decoder, numbers = wire.Decoder(), []
        while device.is_pinging:
            frames = decoder.feed(device.next_profile())
            numbers += [wire.Profile.unpack(frame.payload).ping_number for frame in frames]
        self.assertEqual(numbers, list(range(500)))
        self.assertGreater(device.noise_bytes_sent, 500)
        self.assertEqual(decoder.bad_bytes, device.noise_bytes_sent)


class OverALine(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.link = os.path.join(folder.name, "sonar")

    def start(self, *arguments):
        command = [sys.executable, os.path.join(HERE, "emulator.py"), "--pty", self.link, *arguments]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.addCleanup(process.stdout.close)
        self.addCleanup(process.wait)
        self.addCleanup(process.kill)
        self.assertEqual(json.loads(process.stdout.readline())["event"], "ready")
        return process

    def test_the_vendors_client_reads_every_profile_as_it_was_made(self):
        process = self.start("--count", "200", "--pace-ms", "0", "--timeout", "60")
        sonar = drive_emulate.connect(f"serial://{self.link}")
        self.addCleanup(sonar.iodev.close)
        sonar.control_os_ping_params(length_mm=10_000, enable=1)
        for number in range(200):
            message = sonar.wait_message([drive_emulate.PROFILE], timeout=10)
            self.assertIsNotNone(message, number)
            (frame,) = wire.Decoder().feed(bytes(message.msg_data))
            expected = emulator.known_profile(number, PARAMS)
            self.assertEqual(wire.Profile.unpack(frame.payload).pack(), expected.pack())
        self.assertTrue(drive_emulate.stops(sonar, float("inf")))
        self.assertEqual(json.loads(process.stdout.readline())["event"], "sent")
        report = json.loads(process.stdout.readline())
        self.assertEqual((report["profiles_sent"], report["disables"]), (200, 1))
        # The client sends a `U` so that the unit can find its speed.
        self.assertEqual(report["bad_bytes"], 1)

    def test_the_driver_accepts_a_sound_stream(self):
        process = self.start("--count", "100", "--pace-ms", "0", "--timeout", "60")
        asked = {"start_mm": 0, "length_mm": 5000, "num_results": 300, "msec_per_ping": 20}
        result = drive_emulate.drive(f"serial://{self.link}", 100, asked, 30.0)
        self.assertTrue(result["passed"], result)
        self.assertEqual(process.wait(), 0)

    def test_it_reports_when_it_is_told_to_end(self):
        process = self.start("--timeout", "60")
        process.send_signal(signal.SIGTERM)
        report = json.loads(process.stdout.readline())
        self.assertEqual(report["profiles_sent"], 0)
        self.assertEqual(process.wait(), 0)
        self.assertFalse(os.path.islink(self.link))


class Judgement(unittest.TestCase):
    """The driver must be able to fail."""

    def profile(self, number, **changes):
        class Seen:
            reserved = 0

        seen = Seen()
        vars(seen).update(vars(emulator.known_profile(number, PARAMS)), **changes)
        return seen

    def test_a_sound_profile_has_no_faults(self):
        self.assertEqual(drive_emulate.faults_alone(self.profile(5)), [])
        faults, missing = drive_emulate.faults_between(self.profile(5), self.profile(6))
        self.assertEqual((faults, missing), ([], 0))

    def test_each_wrong_field_is_named(self):
        for changes, fault in (
            ({"pwr_results": (1, 2)}, "results against num_results"),
            ({"pwr_results": (1,) * 600}, "some contrast"),
            ({"max_pwr_db": float("nan")}, "finite decibel scale"),
            ({"max_pwr_db": -50.0}, "finite decibel scale"),
            ({"ping_hz": 0}, "ping_hz"),
            ({"gain_index": 8}, "gain_index"),
            ({"sos_dmps": 1500}, "sos_dmps"),
            ({"pulse_duration_sec": 0.0}, "pulse_duration_sec"),
            ({"vehicle_heading_deg": float("inf")}, "headings"),
        ):
            self.assertEqual(drive_emulate.faults_alone(self.profile(5, **changes)), [fault])

    def test_loss_repetition_and_time_are_judged(self):
        for later, missing in ((7, 1), (5, 1), (4, 2)):
            faults, counted = drive_emulate.faults_between(self.profile(5), self.profile(later))
            self.assertEqual(counted, missing)
            self.assertTrue(faults)
        faults, _ = drive_emulate.faults_between(self.profile(5), self.profile(6, timestamp_ms=0))
        self.assertEqual(len(faults), 1)


if __name__ == "__main__":
    unittest.main()
