#!/bin/sh
# Builds the program for a vehicle's computer on this one: build.sh aarch64 | armv7 | x86_64 [FOLDER]
# Puts it, stripped and without benches, at FOLDER/echosplat (out/<target>). Needs Debian's compiler for that computer,
# gcc-aarch64-linux-gnu or gcc-arm-linux-gnueabihf.
set -eu
cd "$(dirname "$0")/.."
case "${1-}" in
aarch64 | arm64 | arm64v8) target=aarch64-unknown-linux-gnu gcc=aarch64-linux-gnu-gcc ;;
armv7 | armv7l | arm) target=armv7-unknown-linux-gnueabihf gcc=arm-linux-gnueabihf-gcc ;;
x86_64 | amd64) target=x86_64-unknown-linux-gnu gcc=cc ;;
*)
    echo "usage: blueos/build.sh aarch64|armv7|x86_64 [FOLDER], not '${1-}'" >&2
    exit 2
    ;;
esac
command -v "$gcc" >/dev/null || {
    echo "$gcc is not installed; Debian has it in gcc-aarch64-linux-gnu or gcc-arm-linux-gnueabihf" >&2
    exit 2
}
folder=${2-out/$target}
rustup target add "$target"
linker=CARGO_TARGET_$(echo "$target" | tr 'a-z-' 'A-Z_')_LINKER
env "$linker=$gcc" cargo build --locked --profile vehicle --no-default-features --package echosplat --target "$target"
mkdir -p "$folder"
cp "${CARGO_TARGET_DIR-target}/$target/vehicle/echosplat" "$folder/echosplat"
ls -l "$folder/echosplat"
