#!/bin/sh
# What the extension runs. Configuration, maps and recordings are in DATA, which BlueOS keeps; the configuration is put there
# at the first start and is the owner's from then on.
set -eu
data=${ECHOSPLAT_DATA-/data}
given=${ECHOSPLAT_GIVEN-/usr/share/echosplat/echosplat.toml}
[ -e "$data/echosplat.toml" ] || cp "$given" "$data/echosplat.toml"
exec echosplat run --config "$data/echosplat.toml" --map "$data/maps/{time}.ply" --record "$data/recordings" "$@"
