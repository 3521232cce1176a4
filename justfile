# Commands for who changes the code: `just` lists them. Each is one line that also works without just.

# All commands.
default:
    @just --list

# The program, as `target/release/echosplat`.
build:
    cargo build --release

# The simulated dive, with map and report in out/demo.
demo *ARGS:
    cargo run --release -- demo {{ARGS}}

# All that a change has to pass.
ci:
    .ci/run

# All tests.
test:
    cargo test --release --workspace

# Whole-service tests whose name holds NAME.
e2e NAME:
    cargo test --release -p echosplat --test e2e {{NAME}} -- --nocapture

# The fast loop: the unit tests of one crate, as `just fast mapper`; a change is built in seconds.
fast CRATE *ARGS:
    cargo unit echosplat-{{CRATE}} {{ARGS}}

# Format, and the linters.
lint:
    cargo fmt --all
    cargo clippy --release --workspace --all-targets -- -D warnings
    cargo xtask check

# One bench in short, as `just bench kernels`.
bench NAME *ARGS:
    cargo run --release -- bench {{NAME}} --quick {{ARGS}}

# The live page with a simulated dive, at http://127.0.0.1:8080.
page:
    cargo run --release -- demo --web 8080

# A map to look into: a short dive of SCENE, its map, what it holds, how far it is from the truth, and a report.
map SCENE="fence":
    cargo run --release -- simulate --scene {{SCENE}} --duration 60 --out out/{{SCENE}}
    cargo run --release -- replay out/{{SCENE}}/dive.svlog --poses out/{{SCENE}}/dive.tum --map out/{{SCENE}}/map.ply --truth out/{{SCENE}} --report out/{{SCENE}}/report.html
    cargo run --release -- info out/{{SCENE}}/map.ply
    cargo run --release -- evaluate out/{{SCENE}}/map.ply --truth out/{{SCENE}}

# Spelling, with `typos` (cargo install typos-cli).
spell:
    typos
