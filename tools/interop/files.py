"""The files: written by EchoSplat, and read a second time by libraries that are not under test."""
import collections, hashlib, json, pathlib, shutil, subprocess
from dataclasses import dataclass, field

import numpy as np

# Far from the world's origin, as UTM coordinates are.
SHIFT_M = (500_000.0, 5_000_000.0, 0.0)
DIVES = {"fence": "fence", "pier": "pier", "UTM": "fence", "empty": "empty"}
# The recordings are of this dive: its map has a frame of its own, which is recorded too.
RECORDED = "UTM"
HARMONIC_0 = 0.28209479177387814
SPLAT = np.dtype([("place", "<f4", 3), ("scale", "<f4", 3), ("colour", "u1", 4), ("rotation", "u1", 4)])


@dataclass
class Written:
    """What a file holds; `None` for what a file of its kind has no place for."""

    places: np.ndarray | None = None
    triangles: int | None = None
    colour: np.ndarray | None = None
    columns: dict = field(default_factory=dict)
    messages: dict | None = None
    rows: int | None = None


class Product:
    """The program under test: one method a command, so that its options stand in one place."""

    def __init__(self, program):
        self.program = pathlib.Path(program).resolve()

    def run(self, *arguments, allowed=(0,)):
        command = [self.program, *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode not in allowed:
            raise RuntimeError(f"{' '.join(map(str, command))} ended with {done.returncode}:\n{done.stderr[-3000:]}")
        return done.stdout

    def key(self):
        """Of the program's bytes: files of another program are written anew."""
        return hashlib.sha256(self.program.read_bytes()).hexdigest()[:16]

    def simulate(self, scene, out):
        self.run("simulate", "--scene", scene, "--dive", "survey", "--seed", 1, "--out", out)

    def replay(self, log, poses, out, *more):
        # 3: a map without Gaussians is said as something that is wrong.
        self.run("replay", log, "--poses", poses, "--rate", 0, "--map", out, *more, allowed=(0, 3))

    def record(self, log, poses, folder, kind):
        # What is published is recorded: the map's changes and its frame.
        more = ("--publish", "--record", folder, "--record-format", kind)
        self.replay(log, poses, folder / "map.ply", *more)

    def as_bag(self, recording, out):
        self.run("recover", "--ros", recording, "--out", out)

    def export(self, source, out, *more):
        self.run("export", source, out, *more)

    def info(self, file):
        return json.loads(self.run("info", file, "--json"))


def shifted(poses, out):
    """The poses of a TUM file as far away as UTM coordinates are."""
    lines = []
    for line in poses.read_text().splitlines():
        if not line.startswith("#"):
            time, *rest = line.split()
            moved = [repr(float(x) + by) for x, by in zip(rest, SHIFT_M)]
            line = " ".join([time, *moved, *rest[3:]])
        lines.append(line)
    out.write_text("\n".join(lines) + "\n")


def write_dive(product, name, folder):
    """Every kind of file of one dive but recordings."""
    folder.mkdir(parents=True)
    dive, poses, map_file = folder / "dive", folder / "poses.tum", folder / "map.ply"
    product.simulate(DIVES[name], dive)
    if name == "UTM":
        shifted(dive / "dive.tum", poses)
    else:
        shutil.copy(dive / "dive.tum", poses)
    product.replay(dive / "dive.svlog", poses, map_file, "--finished-only")
    product.export(map_file, folder / "up.ply", "--up", "-y")
    for ending in ("pcd", "npz", "splat"):
        product.export(map_file, folder / f"map.{ending}")
    for ending in ("ply", "obj"):
        product.export(map_file, folder / f"mesh.{ending}", "--mesh")
    if name == RECORDED:
        write_recordings(product, dive / "dive.svlog", poses, folder)


def write_recordings(product, log, poses, folder):
    for kind, name in (("both", "recording.mcap"), ("ros", "bag.mcap")):
        into = folder / kind
        into.mkdir()
        product.record(log, poses, into, kind)
        [found] = into.glob("*.mcap")
        shutil.move(found, folder / name)
        for other in into.glob("*.svlog"):
            shutil.move(other, folder / "log.svlog")
    product.as_bag(folder / "recording.mcap", folder / "recovered.mcap")


def write_all(product, folder):
    """The folder of each dive; written once for a program."""
    folder = folder / product.key()
    for name in DIVES:
        into, mark = folder / name, folder / f"{name}.complete"
        if not mark.exists():
            shutil.rmtree(into, ignore_errors=True)
            write_dive(product, name, into)
            mark.touch()
    return {name: folder / name for name in DIVES}


def read_ply(file):
    from plyfile import PlyData

    found = PlyData.read(str(file))
    vertex = found["vertex"]
    columns = {p.name: np.asarray(vertex[p.name], float) for p in vertex.properties}
    places = np.stack([columns.pop(axis) for axis in "xyz"], 1)
    colour = None
    if "red" in columns:
        colour = np.stack([columns.pop(name) for name in ("red", "green", "blue")], 1) / 255.0
    triangles = len(found["face"].data) if "face" in found else None
    return Written(places, triangles, colour, columns)


def read_pcd(file):
    head, body = file.read_bytes().split(b"DATA binary\n", 1)
    lines = dict(line.split(" ", 1) for line in head.decode().splitlines() if line and line[0] != "#")
    kinds = [kind.lower() + size for kind, size in zip(lines["TYPE"].split(), lines["SIZE"].split())]
    rows = np.frombuffer(body, list(zip(lines["FIELDS"].split(), kinds)), int(lines["POINTS"]))
    columns = {name: rows[name].astype(float) for name in rows.dtype.names}
    places = np.stack([columns.pop(axis) for axis in "xyz"], 1)
    return Written(places, columns=columns)


def read_npz(file):
    with np.load(file) as found:
        arrays = {name: found[name] for name in found.files}
    places = arrays.pop("position")
    return Written(places, columns=split(arrays))


def read_splat(file):
    rows = np.frombuffer(file.read_bytes(), SPLAT)
    # Scale and turn are told by their own columns; opacity is the colour's fourth.
    columns = {f"scale_{i}": rows["scale"][:, i].astype(float) for i in range(3)}
    columns["opacity"] = rows["colour"][:, 3] / 255.0
    return Written(rows["place"].astype(float), colour=rows["colour"][:, :3] / 255.0, columns=columns)


def read_obj(file):
    lines = file.read_text().splitlines()
    places = [line.split()[1:4] for line in lines if line.startswith("v ")]
    return Written(np.array(places, float).reshape(-1, 3), sum(line.startswith("f ") for line in lines))


def split(arrays):
    """Arrays of one dimension: `scale` of three becomes `scale_0` to `scale_2`."""
    columns = {}
    for name, array in arrays.items():
        array = np.asarray(array)
        if array.ndim == 0:
            # A single number is of the file, as its version is.
            continue
        if array.ndim == 1:
            columns[name] = array.astype(float)
        else:
            columns |= {f"{name}_{i}": array[:, i].astype(float) for i in range(array.shape[1])}
    return columns


def read_mcap(file):
    """Counted record by record from the front: neither index nor statistics are asked."""
    from mcap.records import Channel, Message
    from mcap.stream_reader import StreamReader

    topics, counts = {}, collections.Counter()
    with open(file, "rb") as stream:
        for record in StreamReader(stream).records:
            if isinstance(record, Channel):
                topics[record.id] = (record.topic, record.message_encoding)
            elif isinstance(record, Message):
                counts[topics[record.channel_id]] += 1
    return Written(messages=dict(counts))


def read_tum(file):
    lines = file.read_text().splitlines()
    return Written(rows=sum(bool(line.strip()) and not line.startswith("#") for line in lines))


READERS = {
    ".ply": read_ply,
    ".pcd": read_pcd,
    ".npz": read_npz,
    ".splat": read_splat,
    ".obj": read_obj,
    ".mcap": read_mcap,
    ".tum": read_tum,
}


# What `echosplat info` says of a file, beside the same counted here.
TOLD = {
    "map.ply": ("gaussians", lambda found: len(found.places)),
    "recording.mcap": ("poses", lambda found: found.messages["/pose", "cdr"]),
    "poses.tum": ("poses", lambda found: found.rows),
}


def written(product, file):
    """What the file holds, which has to be what EchoSplat says of it."""
    if file.suffix == ".svlog":
        return Written(rows=product.info(file)["pings"])
    found = READERS[file.suffix](file)
    if file.name in TOLD:
        name, count = TOLD[file.name]
        told = product.info(file)[name]
        if told != count(found):
            raise RuntimeError(f"{file}: {count(found)} {name} are in it, and `echosplat info` says {told}")
    return found
