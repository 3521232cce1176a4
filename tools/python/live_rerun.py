"""Shows the map of a running service in Rerun: python live_rerun.py [--save live.rrd]"""
import argparse, collections, json, sys, time, numpy as np, zenoh
from subscriber import EVERY, POINT, apply, message, snapshot
try:
    import rerun as rr
except ImportError:
    sys.exit("the map is drawn by Rerun, which is not installed: pip install rerun-sdk")

def show(tile, gaussians, note):
    """Replaces a tile, metres in the poses' frame: ellipsoids of one sigma, green where their place
    is known to centimetres, red from half a metre on; what is ambiguous as grey dots."""
    points = np.array(list(gaussians.values()), POINT)  # rot is w x y z, Rerun's x y z w
    places = np.stack([points[axis] for axis in "xyz"], axis=1) + note["origin_m"]
    sure, red = points["confident"] == 1, np.clip(points["sigma"] / 0.5, 0, 1)
    rr.set_time("ping", timestamp=np.datetime64(note["time_ns"], "ns"))
    rr.log(f"map/confident/{tile}", rr.Ellipsoids3D(centers=places[sure], fill_mode="solid",
        half_sizes=points["scale"][sure], quaternions=np.roll(points["rot"][sure], -1, axis=1),
        colors=np.stack([red, 1 - red, 0 * red], axis=1)[sure]))
    rr.log(f"map/ambiguous/{tile}", rr.Points3D(places[~sure], radii=0.01, colors=[128, 128, 128]))

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--connect", default="tcp/127.0.0.1:7447", help="where the service listens")
parser.add_argument("--key", default="echosplat/vehicle/map", help="prefix, node, map")
parser.add_argument("--save", help="a file in place of a window")
options = parser.parse_args()
where = {"mode": "client", "connect": {"endpoints": [options.connect]}}
try:
    session = zenoh.open(zenoh.Config.from_json5(json.dumps(where)))
except zenoh.ZError:
    sys.exit(f"no service answers at {options.connect}: start it, or give --connect")
rr.init("echosplat")
rr.save(options.save) if options.save else rr.spawn()
arrived, redraw, (tiles, last), silent = collections.deque(maxlen=4096), {}, snapshot([]), 0
with session, session.declare_subscriber(f"{options.key}/delta/*", arrived.append):
    print("listening to", options.key, "at", options.connect, flush=True)
    while not (last and last["final"] and last["chunk"] + 1 == last["chunks"]):
        time.sleep(0.2)
        while last and arrived:
            last = apply(tiles, last, *(new := message(arrived.popleft())))
            redraw[new[0]["tile"]] = True
        if not last:
            replies = session.get(f"{options.key}/snapshot", consolidation=EVERY)
            tiles, last = snapshot([message(reply.ok) for reply in replies if reply.ok])
            redraw = dict.fromkeys([*redraw, *tiles], True)  # tiles that are gone are emptied
        wanted = [tile for tile in redraw if last and redraw[tile]]
        for tile in wanted:
            redraw[tile] = show(tile, tiles[tile], last)
        silent = 0 if wanted else silent + 1
        if silent and silent % 25 == 0:
            print("nothing new from", options.key, "for 5 s: is --key the service's?", flush=True)
