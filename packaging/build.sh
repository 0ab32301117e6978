#!/usr/bin/env bash
# Builds the Debian package, and prints where it is. Needs cargo-deb.
#   packaging/build.sh [PROFILE]    dist, unless another one is named
set -euo pipefail
cd "$(dirname "$0")/.."
profile=${1:-dist}

command -v cargo-deb >/dev/null || { echo "cargo-deb is missing: cargo install cargo-deb --locked" >&2; exit 1; }
# One by one: built together, the daemon would get what only the bench needs of the controller.
cargo build --locked --profile "$profile" -p cdcr-daemon -p cdcr-client >&2
cargo build --locked --profile "$profile" -p cdcr-bench >&2
cargo deb -q --no-build --locked --profile "$profile" -p cdcr-daemon
