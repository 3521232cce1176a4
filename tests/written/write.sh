#!/bin/sh
# Writes one file of each kind that EchoSplat writes.
#
#   tests/written/write.sh PROGRAM FOLDER
#
# PROGRAM is the echosplat of the version that is to be kept, FOLDER where its files go: a new one, or one that this
# script wrote before, which is written anew. README.md beside this says the rest.
set -eu

here=$(cd "$(dirname "$0")" && pwd)
program=$(cd "$(dirname "$1")" && pwd)/$(basename "$1")
mkdir -p "$2"
cd "$2"
if [ -n "$(ls -A .)" ] && [ ! -e version.txt ]; then
    echo "$2 holds something else" >&2
    exit 2
fi
rm -rf ./*

"$program" --version > version.txt
# Deltas of the map are most of a recording: few are enough.
"$program" config |
    sed -e 's/^snapshot_interval_s = .*/snapshot_interval_s = 3.0/' \
        -e 's/^resolution_m = .*/resolution_m = 0.1/' > config.toml

# A dive as files: log, poses, how it was made, and the truth.
cat > box.toml <<'SCENE'
name = "box"
[[box]]
center_m = [0, 0, 0]
size_m = [1, 0.6, 0.8]
SCENE
"$program" simulate --scene box.toml --dive survey --seed 1 --pings-per-s 16 --duration 10 --out .
# The truth of a dive with fewer pings is smaller.
"$program" simulate --scene box.toml --dive survey --seed 1 --pings-per-s 2 --duration 10 --out short
rm -r box.toml truth
mv short/truth truth
rm -r short
# Every fourth pose is enough, and a recording of all is larger than its pings.
awk '/^#/ || NR % 4 == 2' dive.tum > every-fourth
mv every-fourth dive.tum

# Its map, the recording of making it, and the summary at the end.
"$program" replay dive.svlog --poses dive.tum --config config.toml --record recorded --map map.ply --json > summary.json
mv recorded/*.mcap recording.mcap
rmdir recorded

# A recording of a service that runs: its link, its clock, its statuses; and the log beside it.
"$program" run --sonar sim://wall --config config.toml --duration 1 --record live --record-format both \
    --zenoh 'listen/endpoints=[]' --zenoh 'connect/endpoints=[]'
mv live/*.mcap live.mcap
mv live/*.svlog live.svlog
rmdir live

# What a map is exported to.
for file in map.pcd map.npz map.splat world.ply; do
    "$program" export map.ply "$file" --all
done
for file in mesh.ply mesh.obj; do
    "$program" export map.ply "$file" --mesh --cell 0.06
done

# What the files hold, by a reader that is not EchoSplat's.
python3 "$here/holds.py" > holds.json
