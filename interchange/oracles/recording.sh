#!/usr/bin/env bash
# Makes, with the programs that run.sh built, a recording of a daemon of its own, recording.mcap, and its tables in a folder, and reads what cdcr-view serves of it.
set -euo pipefail
folder=$1
root=$(mktemp -d -p /dev/shm)
export CDCR_PREFIX=cdcr_oracle_ CDCR_ROOT=$root CDCR_ROBOT=oracle
programs=()
trap 'kill "${programs[@]}" 2>/dev/null || true; wait; rm -r "$root"' EXIT
target/debug/cdcrd run --set link.simulated=laboratory --set realtime.mode=off 2> "$folder/daemon.log" & programs+=($!)
for _ in $(seq 100); do target/debug/cdcrctl status > /dev/null 2>&1 && break; sleep 0.1; done
target/debug/cdcrctl record -o "$folder/recording.mcap" 2> /dev/null & programs+=($!)
recorder=$!
for _ in $(seq 100); do [ -e "$folder/recording.mcap" ] && break; sleep 0.1; done
target/debug/cdcrctl obstacle add --id 1 --at 0.3,0,0.5 --radius 0.02 > /dev/null
target/debug/cdcrctl jog 0.01,0,-0.01 > /dev/null
kill -INT "$recorder"
wait "$recorder"
target/debug/cdcrctl convert "$folder/recording.mcap" --csv "$folder/tables" > /dev/null
target/debug/cdcr-view --port 0 > "$folder/view.txt" & programs+=($!)
for _ in $(seq 100); do [ -s "$folder/view.txt" ] && break; sleep 0.1; done
node interchange/oracles/check_live.mjs "$folder" "$(sed -n 's/.*127\.0\.0\.1:\([0-9]*\);.*/\1/p' "$folder/view.txt")"
