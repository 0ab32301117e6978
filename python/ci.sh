#!/usr/bin/env bash
# Tests the wheel of the users: builds it, installs it into an empty virtual environment, runs tests and type checks,
# and runs its examples and notebook against a real daemon. Takes 2 minutes on two cores if cdcrd and cdcrctl are built.
# CDCR_PYTHON names the interpreter, Python 3.10 or later.
set -euo pipefail
cd "$(dirname "$0")"
here=$PWD
python=${CDCR_PYTHON:-python3}
programs=$(realpath ../target/release)
step() { printf '\n--- %s\n' "$*"; }

work=$(mktemp -d)
root=$(mktemp -d /dev/shm/cdcr-python-ci-XXXXXX)
daemon=
tools=
end() {
  [ -z "$tools" ] || kill "$tools" 2>/dev/null || true
  [ -z "$daemon" ] || { kill "$daemon" 2>/dev/null && wait "$daemon" 2>/dev/null; } || true
  rm -rf "$work" "$root"
}
trap end EXIT

step "virtual environments"
"$python" -c 'import sys; assert sys.version_info >= (3, 10), sys.version'
"$python" -m venv "$work/build"
"$work/build/bin/pip" install -q -r requirements-build.txt
# Dependencies of the tests are installed while the wheel compiles; the wheel declares its own.
"$python" -m venv "$work/venv"
"$work/venv/bin/pip" install -q -r requirements-test.txt &
tools=$!

step "wheel"
rm -rf dist
(cd .. && cargo build --release --locked -p cdcr-daemon -p cdcr-client -p cdcr-controller)
"$work/build/bin/maturin" build --profile release --locked -i "$python" -o dist
"$work/build/bin/maturin" generate-stubs --profile release --locked -i "$python" -o "$work/stubs"
"$work/build/bin/auditwheel" show dist/*.whl
ls -l dist/*.whl | awk '{ printf "the wheel has %.2f MB\n", $5 / 1e6 }'

step "installed"
wait "$tools"
tools=
"$work/venv/bin/pip" install -q "$(echo dist/*.whl)[plot]"
run="$work/venv/bin/python"
# Uses the installed package, not that of this folder.
(cd "$work" && "$run" -c 'import cdcr; assert "site-packages" in cdcr.__file__, cdcr.__file__')

step "what is generated is what is committed"
(cd "$work" && cp "$here/generate.py" . && "$run" generate.py "$work/stubs" "$here" --check)

step "types"
"$run" -m mypy --config-file pyproject.toml cdcr examples tests/measure.py

step "tests"
cp -r tests "$work/tests"
(cd "$work" && CDCR_PROJECT=$(dirname "$here") "$run" -m pytest -q -rs -n 4 --timeout=240 -p no:cacheprovider tests) | tee "$work/tests.log"
# All of their dependencies are installed here.
if grep -qE '[0-9]+ skipped' "$work/tests.log"; then echo "tests were skipped"; exit 1; fi

step "examples and notebook"
export CDCR_ROOT=$root CDCR_PREFIX=cdcr_python_ci_
cp -r examples run_notebook.py "$work"
cd "$work/examples"
start() { "$programs/cdcrd" run --set realtime.mode=prefer "$@" 2>>"$work/daemon.log" & daemon=$!; }
stop() { kill "$daemon"; wait "$daemon" || true; daemon=; }
start
sleep 1
"$programs/cdcrctl" record -o run.mcap --duration 8s &
recorder=$!
"$run" feed_helix.py
"$run" watch.py 1
wait "$recorder"
"$run" moving_obstacle.py
stop
start --set link.kind=driver
"$run" driver.py 15 &
driver=$!
sleep 1
# On a machine that stalls, a driver without real time is late, and the daemon faults: retried.
fed=
for try in 1 2; do
  if "$run" feed_helix.py; then fed=$try; break; fi
  "$programs/cdcrctl" status
  "$programs/cdcrctl" reset || true
done
[ -n "$fed" ]
"$run" tune.py tune.png
"$run" ../run_notebook.py continuum_robot.ipynb .
wait "$driver"
stop
ls -- *.png
