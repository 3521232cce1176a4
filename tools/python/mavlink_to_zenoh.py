"""Poses of a MAVLink vehicle, put on zenoh by pymavlink: a bridge for links that EchoSplat does not
reach itself. `echosplat run --pose mavlink+udp://…` does the same with a better clock: here a pose
is stamped with the time at which it came.

    python mavlink_to_zenoh.py udpin:0.0.0.0:14550 [KEY] [ENDPOINT]
"""

import json
import math
import sys
import time

import zenoh
from pymavlink import mavutil


def enu_from_flu(roll, pitch, yaw):
    """The x, y, z, w of a vehicle's attitude, from an autopilot's angles (NED from FRD)."""
    # Of a vehicle with y left and z up, pitch and yaw turn the other way; north is ENU's y.
    halves = [roll / 2, -pitch / 2, (math.pi / 2 - yaw) / 2]
    (sr, sp, sy), (cr, cp, cy) = [map(f, halves) for f in (math.sin, math.cos)]
    return [
        cy * cp * sr - sy * sp * cr,
        cy * sp * cr + sy * cp * sr,
        sy * cp * cr - cy * sp * sr,
        cy * cp * cr + sy * sp * sr,
    ]


def main(link, key="echosplat/vehicle/pose", endpoint="tcp/127.0.0.1:7447"):
    config = zenoh.Config()
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    vehicle = mavutil.mavlink_connection(link)
    vehicle.wait_heartbeat()
    for message_id in (30, 32):  # ATTITUDE and LOCAL_POSITION_NED, at 50 Hz
        vehicle.mav.command_long_send(
            vehicle.target_system, vehicle.target_component,
            mavutil.mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, message_id, 20_000, 0, 0, 0, 0, 0)
    position = None
    with zenoh.open(config) as session:
        while True:
            message = vehicle.recv_match(type=["ATTITUDE", "LOCAL_POSITION_NED"], blocking=True)
            if message.get_type() == "LOCAL_POSITION_NED":
                position = message
                continue
            age_s = (message.time_boot_ms - position.time_boot_ms) / 1000 if position else None
            if age_s is None or abs(age_s) > 0.5:
                continue
            north, east, down = (
                place + velocity * age_s
                for place, velocity in [(position.x, position.vx), (position.y, position.vy),
                                        (position.z, position.vz)])
            session.put(key, json.dumps({
                "stamp_ns": time.time_ns(),
                "frame_id": "map",
                "child_frame_id": "base_link",
                "position": [east, north, -down],
                "orientation_xyzw": enu_from_flu(message.roll, message.pitch, message.yaw),
            }))


if __name__ == "__main__":
    main(*sys.argv[1:])
