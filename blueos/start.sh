#!/bin/sh
# What the extension runs. Configuration, maps and recordings are in DATA, which BlueOS keeps; the configuration is put there
# at the first start and is the owner's from then on.
set -eu
data=${ECHOSPLAT_DATA-/data}
given=${ECHOSPLAT_GIVEN-/usr/share/echosplat/echosplat.toml}
[ -e "$data/echosplat.toml" ] || cp "$given" "$data/echosplat.toml"
# Threads share two pools of memory, so that what one of them gave back is there for the next.
export MALLOC_ARENA_MAX=2
exec echosplat run --config "$data/echosplat.toml" --map "$data/maps/{time}.ply" --record "$data/recordings" "$@"
