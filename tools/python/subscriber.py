"""Follows the map of a running service: python subscriber.py --save map.npy"""
import argparse, collections, json, sys, time, numpy as np, zenoh

# One Gaussian: metres from origin_m, one sigma per axis, rotation wxyz, cov xx xy xz yy yz zz of its place.
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("id", "<u4"),
                  ("opacity", "<f4"), ("scale", "<f4", 3), ("rot", "<f4", 4), ("reflectivity", "<f4"),
                  ("sigma", "<f4"), ("cov", "<f4", 6), ("probability", "<f4"), ("confident", "<u4")])
EVERY = zenoh.ConsolidationMode.NONE  # all messages of an answer, not only its last

def message(sample):
    """Attachment and points of a sensor_msgs/msg/PointCloud2: they end one byte before it does."""
    data = sample.payload.to_bytes()
    height_at = 16 + (int.from_bytes(data[12:16], "little") + 3) // 4 * 4
    width = int.from_bytes(data[height_at + 4 : height_at + 8], "little")
    points = np.frombuffer(data, POINT, width, len(data) - 1 - width * POINT.itemsize)
    return json.loads(sample.attachment.to_bytes()), points

def snapshot(answer):
    """The map as {tile: {id: point}} and where it stands: None if a message of it is missing."""
    tiles = collections.defaultdict(dict)
    for note, points in answer: tiles[note["tile"]].update(zip(points["id"].tolist(), points))
    return tiles, {**note, "chunk": 0, "chunks": 1} if answer and len(answer) == note["parts"] else None

def apply(tiles, last, note, points):
    """Applies a delta and returns where the map stands then: None if one before it is missing."""
    epoch, sequence, chunk = last["epoch"], last["sequence"], last["chunk"] + 1
    expected = (epoch, sequence, chunk) if chunk < last["chunks"] else (epoch, sequence + 1, 0)
    if (found := (note["epoch"], note["sequence"], note["chunk"])) != expected:
        return last if found[0] == epoch and found < expected else None
    for gone in note["removed"]: tiles[note["tile"]].pop(gone, None)
    tiles[note["tile"]].update(zip(points["id"].tolist(), points))
    return note

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447", help="where the service listens")
    parser.add_argument("--key", default="echosplat/vehicle/map", help="prefix, node, map")
    parser.add_argument("--save", default="map.npy", help="where the newest map is kept")
    options = parser.parse_args()
    where = {"mode": "client", "connect": {"endpoints": [options.connect]}}
    arrived, (tiles, last), silent = collections.deque(maxlen=4096), snapshot([]), 0
    try: session = zenoh.open(zenoh.Config.from_json5(json.dumps(where)))
    except zenoh.ZError: sys.exit(f"no service answers at {options.connect}: start it, or give --connect")
    with session, session.declare_subscriber(f"{options.key}/delta/*", arrived.append):
        print("listening to", options.key, "at", options.connect, flush=True)
        while not (last and last["final"] and last["chunk"] + 1 == last["chunks"]):
            time.sleep(0.5)
            before = last
            while last and arrived: last = apply(tiles, last, *message(arrived.popleft()))
            if not last:
                replies = session.get(f"{options.key}/snapshot", consolidation=EVERY)
                tiles, last = snapshot([message(reply.ok) for reply in replies if reply.ok])
            silent = 0 if last and last is not before else silent + 1
            if not silent:
                np.save(options.save, points := np.array([p for t in tiles.values() for p in t.values()], POINT))
                box = [f"{a} {points[a].min():.2f} to {points[a].max():.2f}" for a in "xyz" if len(points)]
                print(len(points), "gaussians:", *box, flush=True)
            elif silent % 10 == 0:
                print("nothing new from", options.key, "for 5 s: is --key the service's?", flush=True)
