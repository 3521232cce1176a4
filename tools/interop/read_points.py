"""What one Python library decodes of a file: read_points.py LIBRARY FILE OUT.npz, in that library's environment.

OUT.npz holds `places` (n × 3), where there are such `triangles` (how many) and `colour` (n × 3, 0 to 1), and
a `column:NAME` for every other number that a point came with."""
import pathlib, subprocess, sys, tempfile

import numpy as np


def columns_of(arrays):
    """Named arrays of n or n × k numbers as columns."""
    columns = {}
    for name, array in arrays.items():
        array = np.asarray(array, float)
        if array.ndim == 0:
            # A single number is of the file, as its version is.
            continue
        if array.ndim == 1 or array.shape[1] == 1:
            columns[f"column:{name}"] = array.ravel()
        else:
            columns |= {f"column:{name}_{i}": array[:, i] for i in range(array.shape[1])}
    return columns


def open3d(file, is_mesh):
    import open3d

    if is_mesh:
        mesh = open3d.t.io.read_triangle_mesh(file)
        found = {name: mesh.vertex[name].numpy() for name in mesh.vertex}
        more = {"triangles": len(mesh.triangle.indices) if "indices" in mesh.triangle else 0}
    else:
        cloud = open3d.t.io.read_point_cloud(file)
        found = {name: cloud.point[name].numpy() for name in cloud.point}
        more = {}
    places = found.pop("positions", np.zeros((0, 3)))
    if "colors" in found:
        colour = found.pop("colors")
        more["colour"] = colour / 255.0 if colour.dtype == np.uint8 else colour
    return {"places": places, **more, **columns_of(found)}


def pymeshlab(file, is_mesh):
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(file)
    mesh = meshes.current_mesh()
    found, more = {"normals": mesh.vertex_normal_matrix()}, {"triangles": mesh.face_number()}
    if mesh.has_vertex_scalar():
        found["quality"] = mesh.vertex_scalar_array()
    if mesh.has_vertex_color():
        more["colour"] = mesh.vertex_color_matrix()[:, :3]
    # Columns that it has no name for are attributes, which have to be asked for by name.
    for name in names_in_header(file):
        try:
            found[name] = mesh.vertex_custom_scalar_attribute_array(name)
        except pymeshlab.PyMeshLabException:
            pass
    return {"places": mesh.vertex_matrix(), **more, **columns_of(found)}


def names_in_header(file):
    lines = pathlib.Path(file).read_bytes()[:4096].split(b"end_header")[0].decode("ascii", "replace").splitlines()
    return [line.split()[2] for line in lines if line.startswith("property float ")]


def pypcd4(file, is_mesh):
    from pypcd4 import PointCloud

    cloud = PointCloud.from_path(file)
    others = [name for name in cloud.fields if name not in "xyz"]
    columns = dict(zip(others, cloud.numpy(others).T))
    return {"places": cloud.numpy(("x", "y", "z")), **columns_of(columns)}


def pyvista(file, is_mesh):
    import pyvista

    mesh = pyvista.read(file)
    found = {name: mesh.point_data[name] for name in mesh.point_data}
    more = {"triangles": mesh.n_faces_strict} if is_mesh else {}
    for name in ("RGB", "RGBA"):
        if name in found:
            more["colour"] = found.pop(name)[:, :3] / 255.0
    return {"places": mesh.points, **more, **columns_of(found)}


def trimesh(file, is_mesh):
    import trimesh

    found = trimesh.load(file)
    if isinstance(found, trimesh.Scene):
        found = found.to_geometry()
    # It keeps the columns of a PLY aside, as they were.
    raw = found.metadata.get("_ply_raw", {}).get("vertex", {}).get("data", np.zeros(0))
    columns = {name: raw[name] for name in raw.dtype.names or [] if name not in "xyz"}
    if is_mesh:
        return {"places": found.vertices, "triangles": len(found.faces), **columns_of(columns)}
    more = {}
    if getattr(found, "colors", None) is not None and len(found.colors):
        more["colour"] = np.asarray(found.colors)[:, :3] / 255.0
    return {"places": found.vertices, **more, **columns_of(columns)}


def rerun(file, is_mesh):
    """What its viewer is given of a file: Gaussians or points."""
    from rerun.chunk import RrdReader

    program, columns = pathlib.Path(sys.executable).with_name("rerun"), {}
    with tempfile.TemporaryDirectory() as folder:
        out = f"{folder}/out.rrd"
        # Port 0: it listens, and any is as good.
        done = subprocess.run([program, "--port", "0", "--save", out, file], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        for chunk in RrdReader(out).stream().to_chunks():
            batch = chunk.to_record_batch()
            for name, column in zip(batch.schema.names, batch.columns):
                columns.setdefault(name.split(":")[-1], []).extend(column.to_pylist())
    values = {name: [value for row in rows if isinstance(row, list) for value in row] for name, rows in columns.items()}
    places = np.array(values.pop("centers", []) or values.pop("positions", []), float).reshape(-1, 3)
    more = {}
    if colours := values.pop("colors", None):
        more["colour"] = (np.array(colours)[:, None] >> np.array([24, 16, 8]) & 255) / 255.0
        more["opacity"] = (np.array(colours) & 255) / 255.0
    opacity = {"opacity": more.pop("opacity")} if more else {}
    columns = {name: column for name, column in values.items() if len(column) == len(places)}
    return {"places": places, **more, **columns_of(columns | opacity)}


def numpy(file, is_mesh):
    with np.load(file) as found:
        arrays = {name: found[name] for name in found.files}
    return {"places": arrays.pop("position"), **columns_of(arrays)}


if __name__ == "__main__":
    library, file, out = sys.argv[1:]
    np.savez(out, **globals()[library](file, pathlib.Path(file).stem == "mesh"))
