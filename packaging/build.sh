#!/usr/bin/env bash
# Builds the Debian package and prints its path. Needs cargo-deb.
#   packaging/build.sh [PROFILE]    default: dist
set -euo pipefail
cd "$(dirname "$0")/.."
profile=${1:-dist}

command -v cargo-deb >/dev/null || { echo "cargo-deb is missing: cargo install cargo-deb --locked" >&2; exit 1; }
# Separate builds: together, the daemon would get the features of the controller that only the bench needs.
cargo build --locked --profile "$profile" -p cdcr-daemon -p cdcr-client >&2
cargo build --locked --profile "$profile" -p cdcr-bench >&2
cargo deb -q --no-build --locked --profile "$profile" -p cdcr-daemon
