"""A node of ROS 2 by zenoh-ros2-sdk, which shares nothing with the Rust code; needs no ROS.

    python ros2_node.py hear --router 7447 --domain 0 /echosplat/vehicle
    python ros2_node.py steer --router 7447 --domain 0 /rov/odom dive.tum

`hear` takes a vehicle's points, odometry and transforms, and prints a JSON line for each message,
and one for each topic once its publisher is discovered, until it is interrupted. `steer` sends a
TUM file's poses as `nav_msgs/msg/Odometry` in step with their times, stamped as if the first were
sent now.

The router is a port of this machine. Definitions of messages come from rosbags.
"""

import argparse
import json
import os
import pathlib
import sys
import tempfile
import time

# The SDK would fetch definitions with git, which nothing here needs.
os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")

import numpy
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import (ROS2Publisher, ROS2Subscriber, get_message_class, get_registry,
                            get_topic_info, get_topic_names_and_types)

CLOUD, ODOMETRY, TRANSFORMS = TYPES = [
    "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"]
PATIENCE_S = 60.0


def write_definitions(folder):
    """Each message and what it is made of as `<package>/msg/<Name>.msg`."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for message in TYPES:
        text, _ = store.generate_msgdef(message, ros_version=2)
        first, *rest = text.split("=" * 80 + "\n")
        named = [(message, first)]
        for part in rest:
            title, body = part.split("\n", 1)
            named.append((title.removeprefix("MSG: ").replace("/", "/msg/"), body))
        for name, body in named:
            path = folder / f"{name}.msg"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(body)


def say(**fields):
    sys.stdout.write(json.dumps(fields) + "\n")  # in one piece: messages come on several threads
    sys.stdout.flush()


def on_cloud(message):
    names = [(field.name, {7: "<f4", 6: "<u4"}[field.datatype]) for field in message.fields]
    offsets = [field.offset for field in message.fields]
    layout = numpy.dtype({"names": [name for name, _ in names], "formats": [f for _, f in names],
                          "offsets": offsets, "itemsize": message.point_step})
    points = numpy.frombuffer(bytes(message.data), layout)
    assert len(points) == message.width * message.height and not message.is_bigendian
    spread = {}
    for name in layout.names if len(points) else []:
        spread[name] = [float(points[name].min()), float(points[name].max())]
    say(topic="points", count=len(points), fields=list(layout.names),
        frame=message.header.frame_id, spread=spread)


def on_odometry(message):
    place = message.pose.pose.position
    say(topic="odometry", frame=message.header.frame_id, child=message.child_frame_id,
        place=[place.x, place.y, place.z], sec=message.header.stamp.sec)


def on_transforms(message):
    frames = [[t.header.frame_id, t.child_frame_id] for t in message.transforms]
    say(topic="tf", frames=frames)


def hear(options, where):
    own = options.topic.rstrip("/")
    takers = {f"{own}/points": (CLOUD, on_cloud), f"{own}/odometry": (ODOMETRY, on_odometry),
              "/tf": (TRANSFORMS, on_transforms)}
    subscribers = {name: ROS2Subscriber(name, kind, taker, **where)
                   for name, (kind, taker) in takers.items()}
    deadline = time.monotonic() + PATIENCE_S
    for name, subscriber in subscribers.items():
        # An answer may be late or not whole yet.
        while not (info := get_topic_info(name, verbose=True, **where)) or not info.publishers:
            if time.monotonic() > deadline:
                sys.exit(f"nobody publishes {name}: {get_topic_names_and_types(**where)}")
        [publisher] = info.publishers
        assert publisher.type_hash == subscriber.type_hash, (publisher, subscriber.type_hash)
        say(topic=name, types=info.topic_types, node=publisher.node_name,
            namespace=publisher.node_namespace, qos=publisher.qos)
    while True:
        time.sleep(1.0)


def steer(options, where):
    from send_poses import read_tum

    publisher = ROS2Publisher(options.topic, ODOMETRY, **where)
    of = {name: get_message_class(f"geometry_msgs/msg/{name}") for name in
          ["Point", "Quaternion", "Pose", "PoseWithCovariance", "Vector3", "Twist",
           "TwistWithCovariance"]}
    header, stamp = (get_message_class(name) for name in
                     ["std_msgs/msg/Header", "builtin_interfaces/msg/Time"])
    unknown = numpy.zeros(36)
    still = of["Vector3"](x=0.0, y=0.0, z=0.0)
    poses = read_tum(options.file)
    begin_ns, first_ns = time.time_ns(), poses[0][0]
    for nanos, (*position, qx, qy, qz, qw) in poses:
        stamp_ns = begin_ns + nanos - first_ns
        time.sleep(max(0.0, (stamp_ns - time.time_ns()) * 1e-9))
        pose = of["Pose"](position=of["Point"](*position), orientation=of["Quaternion"](qx, qy, qz, qw))
        publisher.publish(
            header=header(stamp=stamp(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9),
                          frame_id="odom"),
            child_frame_id="base_link",
            pose=of["PoseWithCovariance"](pose=pose, covariance=unknown),
            twist=of["TwistWithCovariance"](
                twist=of["Twist"](linear=still, angular=still), covariance=unknown))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=["hear", "steer"])
    parser.add_argument("--router", type=int, default=7447)
    parser.add_argument("--domain", type=int, default=0)
    parser.add_argument("topic", help="hear: a vehicle's namespace")
    parser.add_argument("file", nargs="?", help="steer: a TUM file")
    options = parser.parse_args()
    where = {"domain_id": options.domain, "router_ip": "127.0.0.1", "router_port": options.router}
    with tempfile.TemporaryDirectory() as folder:
        write_definitions(pathlib.Path(folder))
        get_registry(folder)
        {"hear": hear, "steer": steer}[options.what](options, where)


if __name__ == "__main__":
    main()
