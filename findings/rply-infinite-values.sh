#!/usr/bin/env bash
# CloudCompare 2.11.3 (Debian 12) and open3d 0.20.0 (PyPI), on a PLY with one infinite number, as a column of uncertainties
# may have. Both read it right. Both write PLY by RPly, which refuses to write an infinite number and has begun the row: the
# number is left out, every one after it moves up by a column, and the file ends early. CloudCompare says "saved
# successfully" with exit code 0, Open3D's write_point_cloud gives True. As text, CloudCompare writes it right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export HOME="$folder" QT_QPA_PLATFORM=offscreen
python3 -m venv venv
venv/bin/pip install --quiet open3d==0.20.0
# What their wheels and packages link to and a machine without a screen may lack, on Debian 12.
unpack() {
    mkdir -p "$1/partial"
    apt-get install -qq --download-only --reinstall -y -o Dir::Cache::archives="$folder/$1" "${@:2}" >/dev/null
    for package in "$1"/*.deb; do dpkg -x "$package" "$1/unpacked"; done
}
libraries() { find "$folder/$1/unpacked" -name '*.so*' -printf '%h\n' | sort -u | paste -sd:; }
unpack viewer cloudcompare=2.11.3-7.1
unpack screen libusb-1.0-0 libgl1 libgomp1 libx11-6
cat >write.py <<'PY'
import struct

rows = [(0, 0, 0, 0.25), (1, 2, 3, float("inf")), (4, 5, 6, 0.5), (7, 8, 9, 0.75)]
with open("in.ply", "wb") as file:
    names = "".join(f"property float {name}\n" for name in ("x", "y", "z", "scalar_sigma"))
    file.write(f"ply\nformat binary_little_endian 1.0\nelement vertex 4\n{names}end_header\n".encode())
    for row in rows:
        file.write(struct.pack("<4f", *row))
PY
python3 write.py
plugins=$(find viewer/unpacked -path '*qt5/plugins' -prune)
save() {
    LD_LIBRARY_PATH=$(libraries viewer) QT_PLUGIN_PATH="$folder/$plugins" viewer/unpacked/usr/bin/CloudCompare \
        -SILENT "${@:2}" -NO_TIMESTAMP -O in.ply -SAVE_CLOUDS FILE "$folder/$1" 2>/dev/null
}
said=$(save out.ply -C_EXPORT_FMT PLY -PLY_EXPORT_FMT ASCII) # set -e: exit code 0
echo "CloudCompare: $(grep -o "saved successfully" <<<"$said"); its last rows:"
tail -n 2 out.ply
grep -q "saved successfully" <<<"$said"
[[ $(tail -n 2 out.ply | head -n 1 | xargs) == "5 6 0.5 7" && $(tail -n 1 out.ply | xargs) == "8 9 0.75" ]]
save out.asc -C_EXPORT_FMT ASC >/dev/null
grep -q " inf" out.asc
LD_LIBRARY_PATH=$(libraries screen) venv/bin/python - <<'PY'
import open3d

cloud = open3d.t.io.read_point_cloud("in.ply")
sigma = cloud.point["scalar_sigma"].numpy().ravel().tolist()
told = open3d.t.io.write_point_cloud("again.ply", cloud)
again = open3d.t.io.read_point_cloud("again.ply")
after = again.point["scalar_sigma"].numpy().ravel().tolist()
print("Open3D: read", sigma, "written", told, "read again", after)
assert sigma == [0.25, float("inf"), 0.5, 0.75] and told and after[1:3] == [4.0, 7.0]
PY
