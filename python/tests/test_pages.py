"""The programs of the pages run unchanged."""

import re
import subprocess
import sys
import time
from pathlib import Path

from conftest import TIMEOUT_S, PROGRAMS, PROJECT, Daemon


def blocks(page: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (PROJECT / page).read_text(), re.DOTALL)


def works(daemon: Daemon, folder: Path, program: str) -> None:
    environment = {**daemon.environment, "MPLBACKEND": "Agg", "PYTHONSAFEPATH": "1"}
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=folder, env=environment, capture_output=True, text=True, timeout=4 * TIMEOUT_S
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_readme(daemon: Daemon, tmp_path: Path) -> None:
    [program] = blocks("README.md")
    works(daemon, tmp_path, program)


def test_the_camera_of_the_page(tmp_path: Path) -> None:
    _, _, camera, _ = blocks("docs/python.md")
    daemon = Daemon("--set", "link.kind=driver", "--set", "link.tip_sensor=separate")
    try:
        begin_ns = time.monotonic_ns()
        works(daemon, tmp_path, camera)
        with daemon.connect() as connection:
            assert connection.status()["tip_measured_ns"] > begin_ns
    finally:
        daemon.end()


def test_the_page(daemon: Daemon, tmp_path: Path) -> None:
    offline, online, _, recorded = blocks("docs/python.md")
    recorder = subprocess.Popen([PROGRAMS / "cdcrctl", "record", "-o", "run.mcap"], cwd=tmp_path, env=daemon.environment)
    works(daemon, tmp_path, offline + online)
    recorder.terminate()
    recorder.wait(TIMEOUT_S)
    works(daemon, tmp_path, "import cdcr\n" + recorded)


def test_the_lag_of_the_motors_that_drivers_md_measures(tmp_path: Path) -> None:
    [program] = blocks("docs/drivers.md")
    daemon = Daemon("--set", "link.simulated=slow")
    try:
        daemon.connect().close()
        recorder = subprocess.Popen([PROGRAMS / "cdcrctl", "record", "-o", "moved.mcap"], cwd=tmp_path, env=daemon.environment)
        for words in ["goto 0.2,0.1,0.75 --speed 0.1", "home"]:
            done = daemon.run(PROGRAMS / "cdcrctl", *words.split())
            assert done.returncode == 0, done.stderr
        recorder.terminate()
        recorder.wait(TIMEOUT_S)
    finally:
        daemon.end()
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=4 * TIMEOUT_S)
    assert done.returncode == 0, done.stderr
    found = re.search(r", (\d+), (\d+)\)$", done.stdout.strip())
    assert found, done.stdout
    # A busy machine delays commands.
    assert abs(int(found[1]) - 30) <= 10 and abs(int(found[2]) - 100) <= 20, done.stdout
