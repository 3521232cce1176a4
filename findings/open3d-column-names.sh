#!/usr/bin/env bash
# open3d 0.20.0 (PyPI), open3d.t.io.read_point_cloud on a binary PLY of points.
# Columns of a vertex become keys of a dictionary in Python, and a column that is named like one of a dictionary's own
# methods (clear, get, items, keys, pop, update, values) ends the reading of the whole file with an error about a reserved
# key. The older reader, open3d.io.read_point_cloud, reads the same file, since it looks at places, normals and colours alone.
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

REFUSED = {"clear", "get", "items", "keys", "pop", "update", "values"}


def outcome(column):
    rows = np.zeros(4, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), (column, "u1")])
    rows["x"], rows[column] = range(4), 7
    with open("points.ply", "wb") as file:
        file.write(b"ply\nformat binary_little_endian 1.0\nelement vertex 4\n")
        for name in "xyz":
            file.write(f"property float {name}\n".encode())
        file.write(f"property uchar {column}\nend_header\n".encode() + rows.tobytes())
    assert len(open3d.io.read_point_cloud("points.ply").points) == 4
    try:
        cloud = open3d.t.io.read_point_cloud("points.ply")
    except RuntimeError as error:
        assert f'reserved key "{column}"' in str(error), error
        return "refused"
    assert (cloud.point[column].numpy() == 7).all()
    return "read"


for column in sorted(REFUSED | {"count", "index", "looks", "measured", "reason", "sort"}):
    print(column, outcome(column))
    assert (outcome(column) == "refused") == (column in REFUSED), column
PY
