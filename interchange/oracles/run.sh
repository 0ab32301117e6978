#!/usr/bin/env bash
# Others' decoders read what we write, messages, a recording and what is served live: rosbags and mcap-ros2-support (Python), those of Foxglove (JavaScript).
# Needs python3 with venv, node and npm, and their registries; says so and ends with 0 where a program is missing.
set -euo pipefail
cd "$(dirname "$0")/../.."
folder=$(mktemp -d)
trap 'rm -r "$folder"' EXIT
missing() { echo "not tried: $*"; exit 0; }
for tool in python3 node npm; do command -v "$tool" >/dev/null || missing "$tool is not installed"; done
python3 -m venv "$folder/venv" >/dev/null || missing "python3 has no venv"
"$folder/venv/bin/pip" install -q --disable-pip-version-check rosbags==0.11.9 mcap-ros2-support==0.6.0
npm install --prefix "$folder" --silent --no-fund --no-audit @mcap/core@2 @mcap/support@1 @foxglove/rosmsg@5 @foxglove/rosmsg2-serialization@3 ws@8
# With the features that `cargo test --workspace` has, so that neither compiles what the other has.
cargo build -q --locked --workspace --bins --examples
target/debug/examples/samples "$folder"
"$folder/venv/bin/python" interchange/oracles/check.py "$folder"
node interchange/oracles/check.mjs "$folder"
interchange/oracles/recording.sh "$folder"
"$folder/venv/bin/python" interchange/oracles/check_recording.py "$folder/recording.mcap" "$folder/tables/telemetry.csv"
node interchange/oracles/check_recording.mjs "$folder" "$folder/recording.mcap" "$folder/tables/telemetry.csv"
