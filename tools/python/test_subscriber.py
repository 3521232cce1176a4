"""The subscriber's reading of messages and its bookkeeping, on messages made by hand."""

import json
import struct
import unittest
from types import SimpleNamespace

import numpy as np

import subscriber

FIELDS = (
    "x y z intensity id opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 "
    "reflectivity sigma cov_xx cov_xy cov_xz cov_yy cov_yz cov_zz probability confident"
).split()
NO_POINTS = np.empty(0, subscriber.POINT)


def aligned(body, layout, *values):
    """Appends CDR primitives, each at a multiple of its size."""
    for code, value in zip(layout, values):
        body += bytes(-len(body) % struct.calcsize(code)) + struct.pack("<" + code, value)


def string(body, text):
    aligned(body, "I", len(text) + 1)
    body += text.encode() + b"\0"


def point_cloud(points, frame_id):
    """A sensor_msgs/msg/PointCloud2 by the specification of CDR, little-endian."""
    body = bytearray()
    aligned(body, "iI", 1_700_000_000, 5)
    string(body, frame_id)
    aligned(body, "III", 1, len(points), len(FIELDS))
    for index, name in enumerate(FIELDS):
        string(body, name)
        aligned(body, "IBI", 4 * index, 6 if name in ("id", "confident") else 7, 1)
    aligned(body, "BIII", 0, 92, 92 * len(points), 92 * len(points))
    body += points.tobytes() + b"\1"
    return b"\0\1\0\0" + bytes(body)


def gaussians(*ids):
    points = np.zeros(len(ids), subscriber.POINT)
    points["id"] = ids
    points["x"] = [id / 2 for id in ids]
    points["rot"] = (1, 0, 0, 0)
    points["confident"] = 1
    return points


def note(sequence, chunk=0, chunks=1, tile="0_0_0", epoch=1, removed=()):
    return {
        "epoch": epoch, "sequence": sequence, "tile": tile, "chunk": chunk, "chunks": chunks,
        "removed": list(removed), "final": False,
    }  # fmt: skip


def ids(tiles):
    return sorted(id for tile in tiles.values() for id in tile)


class Messages(unittest.TestCase):
    def test_a_point_cloud_is_read_whatever_its_frame_is_called(self):
        points = gaussians(3, 70_000)
        for frame_id in ("", "m", "map", "maps", "a/long/name"):
            sample = SimpleNamespace(
                payload=SimpleNamespace(to_bytes=lambda: point_cloud(points, frame_id)),
                attachment=SimpleNamespace(to_bytes=lambda: json.dumps(note(1)).encode()),
            )
            attachment, found = subscriber.message(sample)
            self.assertEqual(attachment, note(1))
            self.assertTrue(np.array_equal(found, points), frame_id)

    def test_a_point_has_92_bytes_without_gaps(self):
        self.assertEqual(subscriber.POINT.itemsize, 92)
        self.assertEqual(subscriber.POINT.fields["confident"][1], 88)


class Bookkeeping(unittest.TestCase):
    def setUp(self):
        parts = [
            ({**note(7, tile=tile), "part": part, "parts": 2}, gaussians(*held))
            for part, (tile, held) in enumerate((("0_0_0", (1, 2)), ("1_0_0", (3,))))
        ]
        self.answer = parts
        self.tiles, self.last = subscriber.snapshot(parts)

    def apply(self, *attachment_and_points):
        return subscriber.apply(self.tiles, self.last, *attachment_and_points)

    def test_an_answer_is_the_map_only_when_whole(self):
        self.assertEqual(ids(self.tiles), [1, 2, 3])
        self.assertIsNone(subscriber.snapshot(self.answer[:1])[1])
        self.assertIsNone(subscriber.snapshot([])[1])

    def test_what_the_answer_held_already_is_passed_over(self):
        for sequence in (1, 7):
            self.assertIs(self.apply(note(sequence), gaussians(9)), self.last)
        self.assertEqual(ids(self.tiles), [1, 2, 3])

    def test_deltas_replace_add_and_remove(self):
        moved = gaussians(2, 4)
        moved["x"] = 9
        self.last = self.apply(note(8, removed=[1, 99]), moved)
        self.assertEqual(ids(self.tiles), [2, 3, 4])
        self.assertEqual(self.tiles["0_0_0"][2]["x"], 9)
        self.assertEqual(self.last["sequence"], 8)

    def test_the_same_id_in_another_tile_stays(self):
        self.last = self.apply(note(8, tile="1_0_0"), gaussians(1))
        self.last = self.apply(note(9, removed=[1]), NO_POINTS)
        self.assertEqual(ids(self.tiles), [1, 2, 3])

    def test_a_gap_a_lost_chunk_and_a_new_epoch_ask_for_the_map(self):
        self.assertIsNone(self.apply(note(9), NO_POINTS))
        self.assertIsNone(self.apply(note(8, chunk=1, chunks=2), NO_POINTS))
        self.assertIsNone(self.apply(note(8, epoch=2), NO_POINTS))
        self.assertIsNone(self.apply(note(3, epoch=0), NO_POINTS))
        self.last = self.apply(note(8, chunk=0, chunks=3), NO_POINTS)
        self.assertIsNone(self.apply(note(8, chunk=2, chunks=3), NO_POINTS))
        self.assertIsNone(self.apply(note(9), NO_POINTS))
        self.last = self.apply(note(8, chunk=1, chunks=3), NO_POINTS)
        self.last = self.apply(note(8, chunk=2, chunks=3), NO_POINTS)
        self.assertIsNotNone(self.apply(note(9), NO_POINTS))


if __name__ == "__main__":
    unittest.main()
