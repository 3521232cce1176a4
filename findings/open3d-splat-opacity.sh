#!/usr/bin/env bash
# open3d 0.20.0 (PyPI), open3d.t.io.read_point_cloud on a 3DGS PLY (scales as logarithms, opacity as a logit).
# It knows the format by half: scale_0..2 become one column `scale` in metres (the exponential was taken), while
# opacity stays the logit that the file has, so 0.12 reads as −2 under the same name. Columns of unsigned integers,
# as ids, are left out with a warning; signed ones and bytes are kept.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export HOME="$folder"
python3 -m venv venv
venv/bin/pip install --quiet open3d==0.20.0
# What its wheel links to and a machine without a screen may lack, on Debian and Ubuntu.
if ! venv/bin/python -c "import open3d" >/dev/null 2>&1; then
    mkdir -p unpacked partial
    apt-get install -qq --download-only --reinstall -y -o Dir::Cache::archives="$folder" \
        libusb-1.0-0 libgl1 libgomp1 libx11-6 >/dev/null
    for package in *.deb; do dpkg -x "$package" unpacked; done
    LD_LIBRARY_PATH=$(find "$folder/unpacked" -name '*.so*' -printf '%h\n' | sort -u | paste -sd:)
    export LD_LIBRARY_PATH
fi
venv/bin/python - <<'PY'
import numpy as np
import open3d

names = ("x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 sigma").split()
rows = np.zeros(5, [(name, "<f4") for name in names] + [("id", "<u4"), ("looks", "u1"), ("tile", "<i4")])
rows["x"], rows["opacity"], rows["rot_0"], rows["sigma"], rows["id"], rows["looks"] = range(5), -2.0, 1.0, 0.25, 7, 3
for axis in range(3):
    rows[f"scale_{axis}"] = np.log(0.03)
types = {"<f4": "float", "<u4": "uint", "|u1": "uchar", "<i4": "int"}
with open("map.ply", "wb") as file:
    file.write(b"ply\nformat binary_little_endian 1.0\nelement vertex 5\n")
    for name in rows.dtype.names:
        file.write(f"property {types[rows.dtype[name].str]} {name}\n".encode())
    file.write(b"end_header\n" + rows.tobytes())
cloud = open3d.t.io.read_point_cloud("map.ply")
found = {name: cloud.point[name].numpy() for name in cloud.point}
for name in ("scale", "opacity", "sigma"):
    print(name, found[name][0])
print("columns:", sorted(found))
assert np.allclose(found["scale"], 0.03) and np.allclose(found["opacity"], -2.0)
assert "id" not in found and {"looks", "tile", "sigma", "rot", "f_dc"} <= set(found)
PY
