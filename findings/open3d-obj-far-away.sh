#!/usr/bin/env bash
# open3d 0.20.0 (PyPI), on an OBJ at UTM coordinates (500 km east, 5,000 km north). read_triangle_mesh gives double precision
# and reads in single: places are rounded to half a metre, vertices that fall together are made one, 1,600 become 26, and
# nothing is said. The count of triangles stays. The same mesh near the origin arrives whole.
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

def read(east, north):
    """A grid of 40 by 40 vertices, 1 cm apart."""
    with open("grid.obj", "w") as file:
        for i in range(1600):
            file.write(f"v {east + i // 40 * 0.01:.4f} {north + i % 40 * 0.01:.4f} 0.0000\n")
        for i in range(1, 1561):
            file.write(f"f {i} {i + 1} {i + 40}\n")
    mesh = open3d.io.read_triangle_mesh("grid.obj")
    places = np.asarray(mesh.vertices)
    print(f"at {east} {north}: {len(places)} vertices of {places.dtype}, {len(mesh.triangles)} triangles; north:", np.unique(places[:, 1])[:3])
    return len(places), len(mesh.triangles)

assert read(0, 0) == (1600, 1560)
assert read(500_000, 5_000_000) == (26, 1560)
PY
