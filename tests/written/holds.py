"""Says what the files that write.sh has written hold, as JSON: read with nothing of EchoSplat's."""
import json
import math
import struct

SIZES = {"float": "f", "double": "d", "uchar": "B", "int": "i"}


def mean(numbers):
    numbers = [number for number in numbers if math.isfinite(number)]
    return sum(numbers) / len(numbers) if numbers else None


def vertices(path):
    """The header's lines, and one dictionary a vertex."""
    with open(path, "rb") as stream:
        header, _, body = stream.read().partition(b"end_header\n")
    lines = [line.split() for line in header.decode().splitlines()]
    at = next(i for i, line in enumerate(lines) if line[:2] == ["element", "vertex"])
    names, kinds = [], ""
    for line in lines[at + 1:]:
        if line[0] != "property":
            break
        kinds += SIZES[line[1]]
        names.append(line[2])
    row = struct.Struct("<" + kinds)
    count = int(lines[at][2])
    return lines, [dict(zip(names, row.unpack_from(body, i * row.size))) for i in range(count)]


def map_file(path):
    lines, rows = vertices(path)
    said = {"gaussians": len(rows)}
    origin = next(line[2:] for line in lines if line[:2] == ["comment", "origin_m"])
    said["origin_m"] = [float(number) for number in origin]
    said["mean_m"] = [mean(row[axis] for row in rows) for axis in "xyz"]
    for name in ("sigma", "probability", "reflectivity"):
        said[name] = mean(row[name] for row in rows)
    return said


def mesh_file(path):
    lines, rows = vertices(path)
    triangles = next(int(line[2]) for line in lines if line[:2] == ["element", "face"])
    return {"vertices": len(rows), "triangles": triangles, "sigma": mean(row["sigma"] for row in rows)}


def trajectory(path):
    with open(path) as stream:
        rows = [line.split() for line in stream if not line.startswith("#")]
    return {"poses": len(rows), "first": [float(number) for number in rows[0]]}


print(json.dumps({
    "map.ply": map_file("map.ply"),
    "map.ambiguous.ply": map_file("map.ambiguous.ply"),
    "world.ply": map_file("world.ply"),
    "mesh.ply": mesh_file("mesh.ply"),
    "dive.tum": trajectory("dive.tum"),
}, indent=1))
