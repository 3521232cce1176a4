"""What programs decode that are no Python libraries: they write what they read as text, which is read here."""
import csv, pathlib, re, tempfile

import numpy as np

import files
from programs import run


def splat_transform(programs, file, is_mesh):
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder) / "out.csv"
        program = programs.npm() / "@playcanvas/splat-transform/bin/cli.mjs"
        run(["node", program, "--quiet", file, "-w", out], env=programs.variables())
        with open(out) as stream:
            names, *rows = list(csv.reader(stream))
    columns = dict(zip(names, np.array(rows, float).reshape(-1, len(names)).T))
    places = np.stack([columns.pop(axis) for axis in "xyz"], 1)
    return {"places": places, "columns": columns}


def table(names, lines):
    """Columns of rows of text."""
    rows = np.array([line.split() for line in lines], float)
    return dict(zip(names, rows.reshape(-1, len(names)).T))


def pcl(programs, file, is_mesh):
    """By its tools for PLY and for PCD; the second decodes the points, the first alone would copy bytes."""
    variables = programs.with_packages()

    def tool(name, *arguments):
        run([programs.binary(name), *arguments], env=variables)

    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        if file.suffix == ".ply":
            tool("pcl_ply2pcd", file, folder / "in.pcd")
            file = folder / "in.pcd"
        tool("pcl_passthrough_filter", file, folder / "out.pcd", "-field", "z", "-min", "-1e9", "-max", "1e9")
        tool("pcl_convert_pcd_ascii_binary", folder / "out.pcd", folder / "ascii.pcd", "0")
        lines = (folder / "ascii.pcd").read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("DATA"))
    head = dict(line.split(" ", 1) for line in lines[:at] if " " in line and line[0] != "#")
    names, counts = head["FIELDS"].split(), map(int, head["COUNT"].split())
    names = [name if count == 1 else f"{name}_{i}" for name, count in zip(names, counts) for i in range(count)]
    columns = table(names, lines[at + 1 :])
    found = {"places": np.stack([columns.pop(axis) for axis in "xyz"], 1), "columns": columns}
    if "rgb" in columns:
        # Three bytes in one number.
        packed = columns.pop("rgb").astype(np.int64)
        found["colour"] = (packed[:, None] >> np.array([16, 8, 0]) & 255) / 255
    return found


def cloudcompare(programs, file, is_mesh):
    """Points and their columns as text; of a mesh its vertices, and as OBJ its triangles. With the shift that its window
    proposes for coordinates far from the origin."""
    with tempfile.TemporaryDirectory() as folder:
        text, mesh = pathlib.Path(folder) / "out.asc", pathlib.Path(folder) / "out.obj"
        formats = ["-C_EXPORT_FMT", "ASC", "-ADD_HEADER", "-M_EXPORT_FMT", "OBJ", "-NO_TIMESTAMP"]
        first = ["-SAVE_MESHES", "FILE", mesh, "-EXTRACT_VERTICES"] if is_mesh else []
        opened = ["-SILENT", *formats, "-O", "-GLOBAL_SHIFT", "AUTO", file]
        saved = [*first, "-SAVE_CLOUDS", "FILE", text]
        run([programs.binary("CloudCompare"), *opened, *saved], env=programs.with_packages())
        head, *lines = text.read_text().splitlines()
        triangles = files.read_obj(mesh).triangles if is_mesh else None
    names = head.lstrip("/").split()
    columns = table(names, lines)
    found = {"places": np.stack([columns.pop(axis) for axis in "XYZ"], 1), "triangles": triangles, "columns": columns}
    if "R" in columns:
        found["colour"] = np.stack([columns.pop(name) for name in "RGB"], 1) / 255
    return found


def evo_traj(programs, file, kind, *topics):
    """Poses that it tells of the trajectory."""
    python = programs.python("evo")
    told = run([python.with_name("evo_traj"), kind, file, *topics, "--full_check"], env=programs.variables())
    return int(re.search(r"nr\. of poses\s+(\d+)", told)[1])
