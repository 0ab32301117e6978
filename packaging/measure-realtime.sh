#!/usr/bin/env bash
# Measures the effect of each step of docs/realtime.md on this machine: the daemon's own statistics with one more step
# in each run, idle and beside a busy loop on every core. Needs root (to remove privileges step by step), python3 and
# setpriv (util-linux).
#
# usage: packaging/measure-realtime.sh [SECONDS a run] [ROUNDS] [FILE]
# FILE gets the tables as JSON, like docs/results/realtime.json.
# PROFILE=debug uses the programs of `cargo build` to test the script; its numbers are meaningless.
set -euo pipefail
tables=$(realpath -m "${3:-/dev/null}")
cd "$(dirname "$0")/.."
seconds=${1:-10}
rounds=${2:-3}
programs=./target/${PROFILE:-release}
cdcrd=$programs/cdcrd
cdcrctl=$programs/cdcrctl
for program in "$cdcrd" "$cdcrctl"; do
  [ -x "$program" ] || { echo "$program is missing; build it first: cargo build --release" >&2; exit 1; }
done
[ "$(id -u)" = 0 ] || { echo "run it as root" >&2; exit 1; }
# The daemon keeps its root folder in memory.
folder=$(mktemp -d -p /dev/shm)
export CDCR_ROOT=$folder/root CDCR_PREFIX=measure_$$_
busy=()
daemon=
end() {
  [ -z "$daemon" ] || kill "$daemon" 2>/dev/null || true
  [ ${#busy[@]} = 0 ] || kill "${busy[@]}" 2>/dev/null || true
  wait 2>/dev/null || true
  rm -rf "$folder"
}
trap end EXIT

late="--set realtime.spin_us=0"
# Name of the step | wrapper that starts the daemon | options of the daemon.
steps=(
  "nothing||$late --set realtime.mode=off"
  "a core of its own|setpriv --bounding-set -sys_nice,-ipc_lock|$late --set realtime.no_deep_sleep=false"
  "+ locked memory|setpriv --bounding-set -sys_nice|$late --set realtime.no_deep_sleep=false"
  "+ SCHED_FIFO||$late --set realtime.no_deep_sleep=false"
  "+ no deep sleep||$late"
  "+ a rehearsal (default)||"
  "+ 200 µs early||--set realtime.spin_us=200"
)

run() { # load, step
  IFS='|' read -r name through options <<<"${steps[$2]}"
  # shellcheck disable=SC2086
  $through "$cdcrd" run --set cycle.miss_limit=1000000 $options 2>"$folder/log" &
  daemon=$!
  for _ in $(seq 100); do "$cdcrctl" status >/dev/null 2>&1 && break; sleep 0.05; done
  # Tracking all the time, so that the solver runs.
  "$cdcrctl" ref line --velocity 0.001,0,-0.001 --duration "$((seconds + 5))s" --lead 1s --track >/dev/null 2>&1 &
  local feeder=$!
  sleep 1.5
  "$cdcrctl" status --reset-statistics >/dev/null
  sleep "$seconds"
  "$cdcrctl" status --format json >"$folder/$1.$2.$3.json"
  kill "$daemon"
  wait "$daemon" || true
  daemon=
  kill "$feeder" 2>/dev/null || true
  wait "$feeder" 2>/dev/null || true
}

for round in $(seq "$rounds"); do
  for load in idle busy; do
    if [ "$load" = busy ]; then
      for core in $(seq 0 $(($(nproc) - 1))); do
        taskset -c "$core" sh -c 'while :; do :; done' &
        busy+=($!)
      done
    fi
    for step in "${!steps[@]}"; do
      echo "round $round of $rounds, $load, step $((step + 1)) of ${#steps[@]}" >&2
      run "$load" "$step" "$round"
    done
    [ ${#busy[@]} = 0 ] || { kill "${busy[@]}"; wait "${busy[@]}" 2>/dev/null || true; }
    busy=()
  done
done

names=$(printf '%s\n' "${steps[@]}" | cut -d'|' -f1)
python3 - "$folder" "$rounds" "$names" "$tables" <<'P'
import json, statistics, sys
folder, rounds, names, file = sys.argv[1], int(sys.argv[2]), sys.argv[3].splitlines(), sys.argv[4]
heads = ["step", "wake-up p50", "wake-up p99", "response p99", "response max", "misses", "skipped"]
tables = []
for load, title in (("idle", "Idle"), ("busy", "Beside a busy loop on every core")):
    lines = []
    for step, name in enumerate(names):
        runs = [json.load(open(f"{folder}/{load}.{step}.{r + 1}.json"))["since_reset"] for r in range(rounds)]
        us = lambda key, q: f"{statistics.median(run[key][q] for run in runs) / 1e3:.1f}"
        total = lambda key: str(sum(run[key] for run in runs))
        longest = f"{max(run['response']['max_ns'] for run in runs) / 1e3:.0f}"
        times = [us("wake", "p50_ns"), us("wake", "p99_ns"), us("response", "p99_ns"), longest]
        lines.append([name, *times, total("deadline_misses"), total("skipped_periods")])
    title += f": µs, medians of {rounds} runs; counts are sums"
    tables.append({"title": title, "heads": heads, "words": [True] + 6 * [False], "lines": lines})
    print(f"\n{title}\n")
    for line in [heads, ["---"] + 6 * ["--:"], *lines]:
        print("|", " | ".join(line), "|")
with open(file, "w") as output:
    json.dump({"tables": tables}, output, ensure_ascii=False)
    output.write("\n")
P
