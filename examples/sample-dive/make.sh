#!/bin/sh
# Makes the dive of this folder anew: make.sh [PROGRAM]. Needs awk and Python 3.
set -eu
cd "$(dirname "$0")"
program=${1-echosplat}
scratch=$(mktemp -d)
trap 'rm -r "$scratch"' EXIT
"$program" simulate --scene truth/scene.toml --noise field --pings-per-s 5 --seed 1 --out "$scratch"
cp "$scratch/dive.svlog" .
# Ten poses a second of fifty, to a tenth of a millimetre, and a quarter of the places seen: the folder stays small.
awk 'NR == 1 { print } NR % 5 == 2 {
    printf "%.3f %.4f %.4f %.4f %.5f %.5f %.5f %.5f\n", $1, $2, $3, $4, $5, $6, $7, $8
}' "$scratch/dive.tum" >poses.tum
python3 - "$scratch/truth/seen.ply" >truth/seen.ply <<'PYTHON'
import struct
import sys

header, places = open(sys.argv[1], "rb").read().split(b"end_header\n", 1)
places = list(struct.iter_unpack("<6d", places))[::4]
print(f"ply\nformat ascii 1.0\nelement vertex {len(places)}")
print("property float x\nproperty float y\nproperty float z\nend_header")
for x, y, z, *_ in places:
    print(f"{x:.4f} {y:.4f} {z:.4f}")
PYTHON
