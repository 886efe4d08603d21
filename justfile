# The commands of .ci/run one by one, and what else is done often. `just` lists them.

default:
    @just --list

# Everything that must pass before a change goes in
ci:
    .ci/run

# Format all sources
format:
    cargo fmt --all

# Lints of libraries, programs, tests and benchmarks
lint:
    cargo fmt --all --check
    cargo clippy --workspace --all-targets -- -D warnings

# Documentation of all crates
doc:
    RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps

# All tests
test:
    cargo test --workspace

# Tests that need data (../shared), ffmpeg, PyTorch, pycolmap or Blender, or more than a minute
test-data *NAMES:
    cargo test --workspace -- --ignored {{NAMES}}

# The program with --rerun, outside of the workspace: lints, test, target/release/i2slam in its folder
rerun:
    cd crates/rerun && cargo fmt --check && cargo clippy --all-targets -- -D warnings
    cd crates/rerun && cargo test && cargo build --release

# Damaged files for every reader, for hours: `just fuzz --seconds 7200 tum sens`; the seed is printed
fuzz *OPTIONS="--seconds 3600":
    cargo run -p i2slam-fuzz -- {{OPTIONS}}

# Kill run, render and eval 300 times, and fill a disk at 20 sizes (needs the right to mount)
lose-nothing:
    cargo test -p i2slam-cli --test program -- --ignored --nocapture a_hundred_kills a_full_disk

# Reconstruct the clip that comes with the program; the last line is the path of the report
demo:
    cargo run --release -p i2slam-cli -- demo

# Time of rendering, blurred steps and frames
bench:
    cargo bench -p i2slam-radiance -p i2slam

# Run a suite of sequences and configurations: `just suite ablation --data DATA --out DIR`
suite NAME *OPTIONS:
    cargo build --release -p i2slam-cli -p i2slam-bench
    target/release/i2slam-bench {{NAME}} {{OPTIONS}}

# Run the benches and write docs/performance.md; names of tables make only those
performance *TABLES:
    python3 docs/performance.py {{TABLES}}

# Ratios of two commits, run in turns
compare A B *OPTIONS:
    scripts/compare {{A}} {{B}} {{OPTIONS}}

# Write the values of the presets into docs/presets.md
presets:
    cargo build --release -p i2slam-cli
    python3 docs/presets.py target/release/i2slam docs/presets.md

# Make the pictures of README.md (needs Pillow)
pictures:
    cargo build --release -p i2slam-cli
    scripts/readme-pictures

# What crates.io asks for, and packages that build by themselves
packages:
    scripts/check-packages

# The archive of a release, tried in an empty root folder (needs `pip install cargo-zigbuild ziglang`)
archive:
    scripts/release-archive

# The commands of docs/tutorials.md, on a short video (needs ffmpeg)
tutorials:
    cargo build --release -p i2slam-cli
    scripts/check-tutorials

# Licences, sources and advisories of dependencies (needs cargo-deny)
deny:
    cargo deny check
