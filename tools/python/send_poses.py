"""Sends the poses of a TUM file as a vehicle of some kind would, for tests and for trying things out.

    python send_poses.py --as mavlink-udp --to 127.0.0.1:14550 dive.tum

| --as | what | --to |
|---|---|---|
| mavlink-udp | ATTITUDE_QUATERNION and LOCAL_POSITION_NED, or ODOMETRY with --odometry | host:port sent to |
| mavlink-tcp | the same, to the first that connects | host:port listened on |
| mavlink-velocity | no position: ATTITUDE_QUATERNION, depth in GLOBAL_POSITION_INT, and VISION_POSITION_DELTA from the Water Linked extension of BlueOS; without that with --attitude-only | host:port sent to |
| mavlink-json | the same as mavlink-server puts it on zenoh | zenoh endpoint |
| mavlink-raw | the same as mavlink-server puts raw messages on zenoh, since 0.9 | zenoh endpoint |
| dvl | a Water Linked DVL: position_local at 5 Hz, velocity between | host:port listened on |
| odometry | nav_msgs/Odometry in CDR on zenoh, as rosbags writes it | zenoh endpoint |
| json | the pose of crates/bus/README.md on zenoh, with zenoh's default encoding | zenoh endpoint |

Poses are sent in step with their times (--rate 2: twice as fast; 0: at once). The vehicle's clock
counts from --boot-s at the first pose, --drift-ppm too fast. With --now, poses with a Unix stamp get
one as if the first were sent now. Beside `echosplat emulate`, whose dive begins when it is first asked to
ping, --sonar HOST:PORT starts them with its first ping and keeps them in step. Every line on standard output is `wall_ns stamp_ns`: when a pose
was sent, and its time in the file.
"""

import argparse
import json
import math
import socket
import sys
import threading
import time

from sonar_clock import SonarClock

HALF = math.sqrt(0.5)
UDP = ("mavlink-udp", "mavlink-velocity")


def read_tum(path):
    poses = []
    with open(path) as file:
        for line in file:
            fields = line.replace(",", " ").split()
            if fields and not fields[0].startswith("#"):
                seconds, _, digits = fields[0].lstrip("-").partition(".")
                nanos = int(seconds) * 10**9 + int((digits + "0" * 9)[:9])
                nanos = -nanos if fields[0].startswith("-") else nanos
                poses.append((nanos, [float(field) for field in fields[1:]]))
    return sorted(poses)


def product(a, b):
    """Of two quaternions x, y, z, w."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]


def conjugate(q):
    return [-q[0], -q[1], -q[2], q[3]]


def turned(q, vector):
    return product(product(q, [*vector, 0.0]), conjugate(q))[:3]


def ned_from_frd(enu_from_flu):
    return product(product([HALF, HALF, 0, 0], enu_from_flu), [1, 0, 0, 0])


def ned(vector):
    return [vector[1], vector[0], -vector[2]]


def wxyz(q):
    return [q[3], q[0], q[1], q[2]]


def angles(q):
    """Roll, pitch and yaw of x, y, z, w."""
    x, y, z, w = q
    return (
        math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x)))),
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )


class Clock:
    """When poses are sent, and what the vehicle's clock says then."""

    def __init__(self, options, first_nanos, sonar=None):
        self.options = options
        self.first_nanos = first_nanos
        self.start_nanos = time.time_ns()
        self.pace = options.rate if options.rate > 0 else math.inf
        self.sonar = sonar

    def wait_for(self, nanos):
        if self.sonar:
            return self.wait_for_sonar(nanos)
        due = self.start_nanos + (nanos - self.first_nanos) / self.pace
        time.sleep(max(0.0, (due - time.time_ns()) * 1e-9))

    def wait_for_sonar(self, nanos):
        """Until the sonar's dive is there: the file's times are its."""
        while True:
            offset = self.sonar.offset_nanos()
            if offset is not None and offset + nanos <= time.time_ns():
                self.start_nanos = offset + self.first_nanos
                return
            time.sleep(0.002)

    def boot_nanos(self, nanos):
        elapsed = nanos - self.first_nanos
        return int(self.options.boot_s * 1e9 + elapsed * (1 + self.options.drift_ppm * 1e-6))

    def boot_nanos_now(self):
        return self.boot_nanos(self.first_nanos + time.time_ns() - self.start_nanos)

    def stamp_nanos(self, nanos):
        return nanos - self.first_nanos + self.start_nanos if self.options.now else nanos


def with_velocities(poses):
    """Each pose with the velocity towards the next, world axes."""
    for index, (nanos, pose) in enumerate(poses):
        a, b = poses[max(index - 1, 0)], poses[min(index + 1, len(poses) - 1)]
        span_s = max((b[0] - a[0]) * 1e-9, 1e-9)
        velocity = [(y - x) / span_s for x, y in zip(a[1][:3], b[1][:3])]
        yield nanos, pose[:3], pose[3:], velocity


class Mavlink:
    """A vehicle's messages, made by pymavlink."""

    def __init__(self, options, clock):
        from pymavlink.dialects.v20 import ardupilotmega

        self.dialect = ardupilotmega
        self.options, self.clock = options, clock
        self.mav = ardupilotmega.MAVLink(self, srcSystem=1, srcComponent=1)
        self.asked = set()
        self.outgoing = b""
        self.moved_nanos = -10**18

    def write(self, data):
        self.outgoing += data

    def taken(self):
        data, self.outgoing = self.outgoing, b""
        return data

    def encoded(self, nanos, position, rotation, velocity):
        """The messages of one pose."""
        dialect, boot = self.dialect, self.clock.boot_nanos(nanos)
        q = wxyz(ned_from_frd(rotation))
        resets = [r for r in self.options.reset_at_s if (nanos - self.clock.first_nanos) * 1e-9 >= r]
        if self.options.odometry:
            unknown = [math.nan] + [0.0] * 20
            return [dialect.MAVLink_odometry_message(
                boot // 1000, 1, 12, *ned(position), q, *ned(velocity), 0, 0, 0, unknown, unknown,
                len(resets), 0, 0)]
        boot_ms = boot // 10**6
        if self.options.kind == "mavlink-velocity":
            return self.moving(nanos, boot_ms, position, rotation, velocity)
        return [
            dialect.MAVLink_local_position_ned_message(boot_ms, *ned(position), *ned(velocity)),
            dialect.MAVLink_attitude_quaternion_message(boot_ms, *q, 0, 0, 0),
        ]

    def moving(self, nanos, boot_ms, position, rotation, velocity):
        """Attitude; eight times a second depth, and what the vehicle moved by in its own axes."""
        dialect = self.dialect
        messages = [dialect.MAVLink_attitude_quaternion_message(
            boot_ms, *wxyz(ned_from_frd(rotation)), 0, 0, 0)]
        if nanos - self.moved_nanos < 125_000_000:
            return messages
        self.moved_nanos = nanos
        messages.append(dialect.MAVLink_global_position_int_message(
            boot_ms, 0, 0, 0, round(position[2] * 1000), 0, 0, 0, 0))
        if not self.options.attitude_only:
            delta_us = 125_000
            forward, left, up = (v * delta_us * 1e-6 for v in turned(conjugate(rotation), velocity))
            messages.append(dialect.MAVLink_vision_position_delta_message(
                0, delta_us, [0, 0, 0], [forward, -left, -up], 90))
        return messages

    def send(self, message):
        """As who sends such: velocities come from the extension."""
        is_delta = message.get_type() == "VISION_POSITION_DELTA"
        self.mav.srcSystem, self.mav.srcComponent = (255, 0) if is_delta else (1, 1)
        self.mav.send(message)

    def extras(self, nanos):
        """What comes once a second."""
        dialect = self.dialect
        messages = [dialect.MAVLink_heartbeat_message(12, 3, 0, 0, 4, 3)]
        if self.options.system_time:
            unix_us = self.clock.stamp_nanos(nanos) // 1000
            boot_ms = self.clock.boot_nanos(nanos) // 10**6
            messages.append(dialect.MAVLink_system_time_message(unix_us, boot_ms))
        return messages

    def answer(self, data):
        """Answers what came; the answer is in `taken`."""
        for message in self.mav.parse_buffer(data) or []:
            if message.get_type() == "TIMESYNC" and message.tc1 == 0:
                self.mav.timesync_send(self.clock.boot_nanos_now(), message.ts1)
            elif message.get_type() == "COMMAND_LONG" and message.command == 511:
                self.asked.add(int(message.param1))


def endpoint(text):
    host, _, port = text.rpartition(":")
    return host, int(port)


def in_step(options, poses, clock, send, every_second=lambda nanos: None):
    second = None
    for pose in with_velocities(poses):
        nanos = pose[0]
        clock.wait_for(nanos)
        if second != nanos // 10**9:
            second = nanos // 10**9
            every_second(nanos)
        send(pose)
        print(time.time_ns(), nanos, flush=True)


def over_link(options, poses, clock):
    """MAVLink over UDP or TCP, with answers to TIMESYNC from a thread of its own."""
    vehicle = Mavlink(options, clock)
    lock = threading.Lock()
    if options.kind in UDP:
        link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        link.connect(endpoint(options.to))
    else:
        link, _ = socket.create_server(endpoint(options.to)).accept()

    def put(messages):
        with lock:
            for message in messages:
                vehicle.send(message)
                try:
                    link.send(vehicle.taken()) if options.kind in UDP else link.sendall(
                        vehicle.taken())
                except ConnectionRefusedError:
                    pass

    def listen():
        while True:
            try:
                data = link.recv(4096)
            except ConnectionRefusedError:
                continue
            except OSError:
                return
            if not data and options.kind not in UDP:
                return
            with lock:
                vehicle.answer(data)
                answer = vehicle.taken()
                if answer:
                    link.send(answer)

    threading.Thread(target=listen, daemon=True).start()
    clock.start_nanos = time.time_ns()
    in_step(options, poses, clock, lambda pose: put(vehicle.encoded(*pose)),
            lambda nanos: put(vehicle.extras(nanos)))
    time.sleep(0.2)
    missing = {31, 32, 331} - vehicle.asked
    if options.check_asked and missing:
        sys.exit(f"messages {sorted(missing)} were never asked for")


def zenoh_session(options):
    import zenoh

    config = zenoh.Config()
    config.insert_json5("connect/endpoints", json.dumps([options.to]))
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


def over_json(options, poses, clock):
    """What mavlink-server puts on zenoh for each message."""
    vehicle = Mavlink(options, clock)
    frames = {1: "MAV_FRAME_LOCAL_NED", 12: "MAV_FRAME_BODY_FRD"}
    with zenoh_session(options) as session:
        def put(messages):
            for message in messages:
                fields = message.to_dict()
                name = fields.pop("mavpackettype")
                if name == "HEARTBEAT":
                    fields = {"mavtype": {"type": "MAV_TYPE_SUBMARINE"},
                              "autopilot": {"type": "MAV_AUTOPILOT_ARDUPILOTMEGA"}}
                for key in ("frame_id", "child_frame_id"):
                    if key in fields:
                        fields[key] = {"type": frames[fields[key]]}
                document = {
                    "header": {"system_id": 1, "component_id": 1, "sequence": 0,
                               "message_id": message.get_msgId()},
                    "message": {"type": name, **fields},
                }
                # JSON5, as the server writes it: Python's NaN is spelled the same way.
                session.put(f"{options.key or 'mavlink'}/1/1/{name}", json.dumps(document))

        in_step(options, poses, clock, lambda pose: put(vehicle.encoded(*pose)),
                lambda nanos: put(vehicle.extras(nanos)))


def over_raw(options, poses, clock):
    """What mavlink-server puts on zenoh for each message, as it came."""
    vehicle = Mavlink(options, clock)
    with zenoh_session(options) as session:
        def put(messages):
            for message in messages:
                vehicle.mav.send(message)
                session.put(f"{options.key or 'mavlink'}_raw/out", vehicle.taken())

        in_step(options, poses, clock, lambda pose: put(vehicle.encoded(*pose)),
                lambda nanos: put(vehicle.extras(nanos)))


def as_dvl(options, poses, clock):
    """A DVL that counts x, y, z forward, right, down from the world's axes turned by half about x."""
    link, _ = socket.create_server(endpoint(options.to)).accept()
    clock.start_nanos = time.time_ns()
    sent = [-(10**18)]

    def send(pose):
        nanos, position, rotation, velocity = pose
        boot = clock.stamp_nanos(nanos) if options.dvl_unix else clock.boot_nanos(nanos)
        half = [1, 0, 0, 0]
        if nanos - sent[0] >= 200_000_000:
            sent[0] = nanos
            roll, pitch, yaw = map(math.degrees, angles(product(product(half, rotation), half)))
            report = {"ts": boot * 1e-9, "x": position[0], "y": -position[1], "z": -position[2],
                      "std": 0.002, "roll": roll, "pitch": pitch, "yaw": yaw,
                      "type": "position_local", "status": 0, "format": "json_v3.1"}
        else:
            forward, left, up = turned(conjugate(rotation), velocity)
            report = {"time": 50.0, "vx": forward, "vy": -left, "vz": -up, "fom": 0.001,
                      "altitude": 2.0, "transducers": [], "velocity_valid": True, "status": 0,
                      "format": "json_v3.1", "type": "velocity",
                      "time_of_validity": boot // 1000, "time_of_transmission": boot // 1000}
        link.sendall(json.dumps(report).encode() + b"\r\n")

    in_step(options, poses, clock, send)


def as_odometry(options, poses, clock):
    import numpy
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    unknown = numpy.zeros(36)

    def encoded(pose):
        nanos, position, rotation, _ = pose
        stamp = clock.stamp_nanos(nanos)
        time_type = types["builtin_interfaces/msg/Time"]
        point, quaternion = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Quaternion"]
        vector = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
        message = types["nav_msgs/msg/Odometry"](
            header=types["std_msgs/msg/Header"](
                stamp=time_type(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="odom"),
            child_frame_id="base_link",
            pose=types["geometry_msgs/msg/PoseWithCovariance"](
                pose=types["geometry_msgs/msg/Pose"](
                    position=point(*position), orientation=quaternion(*rotation)),
                covariance=unknown),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](
                twist=types["geometry_msgs/msg/Twist"](linear=vector, angular=vector),
                covariance=unknown))
        return bytes(store.serialize_cdr(message, "nav_msgs/msg/Odometry"))

    def transforms(nanos, *frames):
        """A TFMessage of (parent, child, position, rotation)."""
        header, time_type = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
        vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
        stamp = time_type(sec=nanos // 10**9, nanosec=nanos % 10**9)
        message = types["tf2_msgs/msg/TFMessage"](transforms=[
            types["geometry_msgs/msg/TransformStamped"](
                header=header(stamp=stamp, frame_id=parent), child_frame_id=child,
                transform=types["geometry_msgs/msg/Transform"](
                    translation=vector(*position), rotation=quaternion(*rotation)))
            for parent, child, position, rotation in frames])
        return bytes(store.serialize_cdr(message, "tf2_msgs/msg/TFMessage"))

    if options.kind in ("odometry-mcap", "tf-mcap"):
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

        bag = Writer(options.to, version=9, storage_plugin=StoragePlugin.MCAP)
        bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with bag:
            if options.kind == "odometry-mcap":
                channel = bag.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=store)
                for pose in with_velocities(poses):
                    bag.write(channel, pose[0], encoded(pose))
                return
            still = bag.add_connection("/tf_static", "tf2_msgs/msg/TFMessage", typestore=store)
            moving = bag.add_connection("/tf", "tf2_msgs/msg/TFMessage", typestore=store)
            turned = [0.0, 0.0, math.sin(0.3), math.cos(0.3)]
            bag.write(still, poses[0][0], transforms(
                poses[0][0], ("base_link", "sonar", [0.2, 0.0, 0.1], turned)))
            for nanos, pose in poses:
                # Half a turn about up and back again, so that the order of frames matters.
                half = [0.0, 0.0, 1.0, 0.0]
                inner = product(conjugate(half), pose[3:])
                bag.write(moving, nanos, transforms(
                    nanos, ("map", "odom", pose[:3], half),
                    ("odom", "base_link", [0.0, 0.0, 0.0], inner),
                    ("base_link", "lamp", [0.0, 0.0, nanos % 7 * 1.0], [0.0, 0.0, 0.0, 1.0])))
        return
    with zenoh_session(options) as session:
        key = options.key or "echosplat/vehicle/pose"
        in_step(options, poses, clock, lambda pose: session.put(key, encoded(pose)))


def as_json(options, poses, clock):
    with zenoh_session(options) as session:
        def send(pose):
            nanos, position, rotation, _ = pose
            session.put(options.key or "echosplat/vehicle/pose", json.dumps({
                "stamp_ns": clock.stamp_nanos(nanos), "frame_id": "map",
                "child_frame_id": "base_link", "position": position,
                "orientation_xyzw": rotation}))

        in_step(options, poses, clock, send)


KINDS = {"mavlink-udp": over_link, "mavlink-velocity": over_link, "mavlink-tcp": over_link,
         "mavlink-json": over_json,
         "mavlink-raw": over_raw,
         "dvl": as_dvl, "odometry": as_odometry, "odometry-mcap": as_odometry, "tf-mcap": as_odometry,
         "json": as_json}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("file")
    parser.add_argument("--as", dest="kind", choices=KINDS, required=True)
    parser.add_argument("--to", required=True)
    parser.add_argument("--key", help="zenoh key, or prefix of mavlink-json and mavlink-raw")
    parser.add_argument("--rate", type=float, default=1.0)
    parser.add_argument("--boot-s", type=float, default=3.0)
    parser.add_argument("--drift-ppm", type=float, default=0.0)
    parser.add_argument("--reset-at-s", type=float, action="append", default=[])
    parser.add_argument("--odometry", action="store_true")
    parser.add_argument("--attitude-only", action="store_true")
    parser.add_argument("--system-time", action="store_true")
    parser.add_argument("--dvl-unix", action="store_true")
    parser.add_argument("--now", action="store_true")
    parser.add_argument("--sonar", metavar="HOST:PORT",
                        help="go in step with the dive of `echosplat emulate` at this address (TCP)")
    parser.add_argument("--check-asked", action="store_true",
                        help="fail unless the pose messages were asked for")
    options = parser.parse_args()
    poses = read_tum(options.file)
    sonar = None
    if options.sonar:
        try:
            sonar = SonarClock(endpoint(options.sonar))
        except OSError as error:
            sys.exit(f"no sonar at {options.sonar} ({error}): start `echosplat emulate` first")
        options.now = True
        print(f"poses start with the first ping of the sonar at {options.sonar}", file=sys.stderr)
    elif options.now:
        print("poses start now, whatever a sonar does: beside `echosplat emulate`, whose dive begins with "
              "its first ping, give --sonar HOST:PORT to start together, or they are poses of another time",
              file=sys.stderr)
    KINDS[options.kind](options, poses, Clock(options, poses[0][0], sonar))


if __name__ == "__main__":
    main()
