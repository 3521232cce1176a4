"""Publishes a pose twenty times a second, as a start for your own: python publish_pose.py [KEY]"""

import json
import sys
import time

import zenoh

key = sys.argv[1] if len(sys.argv) > 1 else "echosplat/vehicle/pose"
config = zenoh.Config()
config.insert_json5("connect/endpoints", '["tcp/127.0.0.1:7447"]')
with zenoh.open(config) as session:
    while True:
        session.put(key, json.dumps({
            "stamp_ns": time.time_ns(),
            "frame_id": "map",  # x east, y north, z up, metres
            "child_frame_id": "base_link",  # x forward, y left, z up
            "position": [1.0, 2.0, -3.0],
            "orientation_xyzw": [0, 0, 0, 1],
        }))
        time.sleep(0.05)
