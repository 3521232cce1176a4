#!/usr/bin/env bash
# pcl-tools 1.13.0 (Debian 12), on a binary PCD whose x, y and z are doubles, as the format allows.
# pcl_voxel_grid and pcl_passthrough_filter say that they read 1,000 points with x, y, z, and write a cloud of none,
# with exit code 0. The same points in single precision give hundreds. Large coordinates have to be shifted instead.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
mkdir -p unpacked partial
apt-get install -qq --download-only --reinstall -y -o Dir::Cache::archives="$folder" pcl-tools=1.13.0+dfsg-3 >/dev/null
for package in *.deb; do dpkg -x "$package" unpacked; done
LD_LIBRARY_PATH=$(find "$folder/unpacked" -name '*.so*' -printf '%h\n' | sort -u | paste -sd:)
export LD_LIBRARY_PATH PATH="$folder/unpacked/usr/bin:$PATH"
python3 - <<'PY'
import re, struct, subprocess

def points_after(tool, size, *options):
    kind = {4: "f", 8: "d"}[size]
    with open("cloud.pcd", "wb") as file:
        file.write(
            f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z\nSIZE {size} {size} {size}\n"
            "TYPE F F F\nCOUNT 1 1 1\nWIDTH 1000\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 1000\nDATA binary\n".encode()
        )
        for i in range(1000):
            file.write(struct.pack(f"<3{kind}", i % 10 * 0.1, i // 10 % 10 * 0.1, i // 100 * 0.1))
    run = subprocess.run([tool, "cloud.pcd", "out.pcd", *options], capture_output=True, text=True)
    assert run.returncode == 0, run
    told = [int(n) for n in re.findall(r"(\d+)\D{0,12} points", re.sub(r"\x1b\[[0-9;]*m", "", run.stdout + run.stderr))]
    header = open("out.pcd", "rb").read(400).decode("ascii", "replace")
    return told[0], int(re.search(r"POINTS (\d+)", header)[1])

for tool, options in (("pcl_voxel_grid", ("-leaf", "0.2,0.2,0.2")), ("pcl_passthrough_filter", ("-field", "z", "-min", "-1", "-max", "2"))):
    single, double = points_after(tool, 4, *options), points_after(tool, 8, *options)
    print(f"{tool}: single precision {single[0]} read, {single[1]} written; double {double[0]} read, {double[1]} written")
    assert single[0] == double[0] == 1000 and single[1] > 100 and double[1] == 0
PY
