"""Which program is given which file, and what it made of it."""
import json, pathlib, tempfile
from dataclasses import dataclass, field

import numpy as np

import files, judge, outside
from programs import run

HERE = pathlib.Path(__file__).resolve().parent
OUTSIDE = {"splat-transform": outside.splat_transform, "PCL": outside.pcl, "CloudCompare": outside.cloudcompare}
# What imports call them.
LIBRARIES = {
    "Open3D": "open3d",
    "MeshLab (pymeshlab)": "pymeshlab",
    "pypcd4": "pypcd4",
    "PyVista (VTK)": "pyvista",
    "trimesh": "trimesh",
    "Rerun": "rerun",
    "numpy": "numpy",
    "mcap (Python)": "mcap",
    "mcap-ros2-support": "mcap_ros2_support",
    "rosbags": "rosbags",
    "PINGVerter": "pingverter",
    "bluerobotics-ping": "brping",
}
NEED_SCREEN = ["open3d", "pymeshlab", "pyvista"]
MESHES = ["Open3D", "MeshLab (pymeshlab)", "PyVista (VTK)", "trimesh", "CloudCompare"]
POINTS = {
    "map.ply": [*MESHES, "Rerun", "PCL", "splat-transform"],
    "up.ply": ["splat-transform"],
    "map.pcd": ["Open3D", "pypcd4", "PCL", "CloudCompare"],
    "map.splat": ["splat-transform", "Open3D"],
    "map.npz": ["numpy"],
    "mesh.ply": MESHES,
    "mesh.obj": MESHES,
}
BAG = ["mcap (Python)", "mcap-ros2-support", "Rerun", "@mcap/core", "rosbags", "evo"]
MESSAGES = {
    "recording.mcap": BAG,
    "bag.mcap": BAG,
    "recovered.mcap": BAG,
    "log.svlog": ["PINGVerter", "bluerobotics-ping"],
    "poses.tum": ["evo"],
}
# Files that are not meant for a program, or one dive's of them, and the one word why.
NOT_MEANT = {
    ("map.pcd", "CloudCompare"): "plugin",
    ("mesh.obj", "Open3D", "UTM"): "precision",
    ("recording.mcap", "rosbags"): "JSON",
    ("recording.mcap", "evo"): "JSON",
}


@dataclass
class Row:
    """What one program made of one kind of file: of each dive what arrived, or a word why nothing."""

    file: str
    program: str
    written: dict = field(default_factory=dict)
    arrived: dict = field(default_factory=dict)
    faults: list = field(default_factory=list)


def points(programs, product, folders, wanted):
    rows, of_maps = [], {}
    for file, claimed in POINTS.items():
        of_dives = {dive: files.written(product, folder / file) for dive, folder in folders.items()}
        counts = {dive: len(written.places) for dive, written in of_dives.items()}
        of_maps = of_maps or counts
        if not file.startswith("mesh") and counts != of_maps:
            raise RuntimeError(f"{file}: {counts} Gaussians exported of {of_maps}")
        for program in filter(lambda program: wanted(file, program), claimed):
            row = Row(file, program, of_dives)
            for dive, written in of_dives.items():
                row.arrived[dive] = one_of_points(programs, row, dive, folders[dive] / file)
            rows.append(row)
    return rows


def one_of_points(programs, row, dive, path):
    """What arrived of one file, or the word why it is not given to the program."""
    not_meant = NOT_MEANT.get((row.file, row.program)) or NOT_MEANT.get((row.file, row.program, dive))
    if not_meant:
        return not_meant
    written, told = row.written[dive], f"{row.program}, {row.file} of {dive}"
    try:
        found = judge.arrived(written, decoded(programs, row.program, path))
    except (RuntimeError, ValueError, OSError, KeyError) as error:
        if len(written.places) == 0:
            # To say that nothing is there is no other count than was written.
            return "refuses"
        row.faults.append(f"{told}: {error}")
        return "fails"
    if found.count != len(written.places):
        row.faults.append(f"{told}: {len(written.places)} points written, {found.count} decoded")
    if written.triangles is not None and found.triangles != written.triangles:
        row.faults.append(f"{told}: {written.triangles} triangles written, {found.triangles} decoded")
    return found


def decoded(programs, program, path):
    is_mesh = path.stem == "mesh"
    if program in OUTSIDE:
        return OUTSIDE[program](programs, path, is_mesh)
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder) / "out.npz"
        python, library = programs.python(program), LIBRARIES[program]
        variables = programs.with_screen(python, library) if library in NEED_SCREEN else programs.variables()
        run([python, HERE / "read_points.py", library, path, out], env=variables)
        with np.load(out) as found:
            arrays = {name: found[name] for name in found.files}
    columns = {name.removeprefix("column:"): array for name, array in arrays.items() if name.startswith("column:")}
    places = arrays["places"].astype(float).reshape(-1, 3)
    triangles = int(arrays["triangles"]) if "triangles" in arrays else None
    found = {"places": places, "triangles": triangles, "columns": columns}
    return found | ({"colour": arrays["colour"]} if "colour" in arrays else {})


def messages(programs, product, folder, wanted):
    rows = []
    for file, claimed in MESSAGES.items():
        if not (folder / file).exists():
            continue
        written = files.written(product, folder / file)
        for program in filter(lambda program: wanted(file, program), claimed):
            row = Row(file, program, expected(written, program))
            not_meant = NOT_MEANT.get((file, program))
            try:
                row.arrived = not_meant or counted(programs, program, folder / file)
            except (RuntimeError, ValueError, OSError) as error:
                row.arrived = "fails"
                row.faults.append(f"{program}, {file}: {error}")
            if isinstance(row.arrived, dict):
                compare(row)
            rows.append(row)
    return rows


def expected(written, program):
    """Messages of each channel, or rows, that a program claims to decode."""
    if written.messages is None:
        return {"rows": written.rows}
    counts = {}
    for (topic, encoding), count in sorted(written.messages.items()):
        if program == "evo" and topic != "/pose" or program == "mcap-ros2-support" and encoding != "cdr":
            continue
        # Rerun shows JSON as the bytes that it is.
        counts[f"{topic} as bytes" if program == "Rerun" and encoding == "json" else topic] = count
    return counts


def compare(row):
    for topic, count in row.written.items():
        found = row.arrived.get(topic, 0)
        if found != count:
            row.faults.append(f"{row.program}, {row.file}: {topic}: {count} written, {found} decoded")


def counted(programs, program, path):
    if program == "@mcap/core":
        variables = programs.variables() | {"NODE_MODULES": str(programs.npm())}
        return json.loads(run(["node", HERE / "read_messages.mjs", path], env=variables))
    if program == "evo":
        if path.suffix == ".tum":
            return {"rows": outside.evo_traj(programs, path, "tum")}
        return {"/pose": outside.evo_traj(programs, path, "mcap", "/pose")}
    command = [programs.python(program), HERE / "read_messages.py", LIBRARIES[program], path]
    told = run(command, env=programs.variables())
    return json.loads(told.strip().splitlines()[-1])
