"""Prints the status of a running service, one JSON object a line, once a second.

    python status.py --connect tcp/127.0.0.1:7447 --key echosplat/vehicle/status
"""

import argparse
import json
import queue
import sys

import zenoh


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447", help="where the service listens")
    parser.add_argument("--key", default="echosplat/vehicle/status", help="prefix, node, status")
    options = parser.parse_args()
    where = {"mode": "client", "connect": {"endpoints": [options.connect]}}
    arrived = queue.Queue(maxsize=16)
    try:
        session = zenoh.open(zenoh.Config.from_json5(json.dumps(where)))
    except zenoh.ZError:
        sys.exit(f"no service answers at {options.connect}: start it, or give --connect")
    with session:
        session.declare_subscriber(options.key, arrived.put)
        while True:
            status = json.loads(arrived.get().payload.to_bytes())
            print(json.dumps(status), flush=True)
            if status["final"]:
                return


if __name__ == "__main__":
    main()
