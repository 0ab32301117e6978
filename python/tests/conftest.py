"""A separate daemon for each test that needs one, in a place that is removed afterwards."""

import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import cdcr

PROJECT = Path(os.environ.get("CDCR_PROJECT", Path(__file__).resolve().parents[2]))
PROGRAMS = Path(os.environ.get("CDCR_PROGRAMS", PROJECT / "target" / "release"))

# Long, because a machine with other work may stall; only a failing test waits that long.
TIMEOUT_S = 60.0

MEMORY = Path("/dev/shm")
# The process id follows, so that the next run finds what a killed one left.
PREFIX = "cdcr-python-"


def pytest_report_header() -> list[str]:
    """Removes what killed runs left in shared memory, and reports it."""
    reported = []
    for place in MEMORY.glob(PREFIX + "*"):
        number = place.name.removeprefix(PREFIX).partition("-")[0]
        if not number.isdigit() or Path("/proc", number).exists() or place.stat().st_uid != os.getuid():
            continue
        reported.append(f"removed, of a run that was killed: {place}")
        shutil.rmtree(place) if place.is_dir() else place.unlink()
    return reported


class Daemon:
    """cdcrd with a private root folder."""

    def __init__(self, *options: str, config: Path | None = None) -> None:
        self.root = Path(tempfile.mkdtemp(prefix=f"{PREFIX}{os.getpid()}-", dir=MEMORY))
        self.options = [*(["--config", str(config)] if config else []), *options]
        self.environment = {**os.environ, "CDCR_ROOT": str(self.root), "CDCR_PREFIX": "cdcr_python_"}
        for name in ("CDCR_CONFIG", "CDCR_ROBOT"):
            self.environment.pop(name, None)
        self.start()

    def start(self) -> None:
        self.log = (self.root.parent / (self.root.name + ".log")).open("ab")
        # These tests do not depend on a machine that meets deadlines.
        stall_tolerant = ["--set", "realtime.mode=prefer", "--set", "cycle.miss_limit=1000000"]
        command = [PROGRAMS / "cdcrd", "run", *stall_tolerant, *self.options]
        self.process = subprocess.Popen(command, env=self.environment, stderr=self.log)

    def connect(self, **options: object) -> cdcr.Connection:
        given = {"timeout_s": TIMEOUT_S, **options}
        return cdcr.connect("cdcr", root=self.root, prefix="cdcr_python_", **given)

    def run(self, *command: str) -> subprocess.CompletedProcess[str]:
        """cdcrctl, or a Python program, for this daemon."""
        return subprocess.run(command, env=self.environment, capture_output=True, text=True, timeout=4 * TIMEOUT_S)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def end(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self.kill()
        self.log.close()
        Path(self.log.name).unlink(missing_ok=True)
        shutil.rmtree(self.root, ignore_errors=True)


@pytest.fixture
def daemon() -> Iterator[Daemon]:
    """The ideal robot of the default configuration, at rest."""
    running = Daemon()
    with running.connect() as connection:
        until = time.monotonic() + TIMEOUT_S
        while connection.status()["mode"] is not cdcr.Mode.HOLDING:
            assert time.monotonic() < until
            time.sleep(0.02)
    yield running
    running.end()


def eventually(happened, timeout_s: float = TIMEOUT_S) -> None:
    until = time.monotonic() + timeout_s
    while not happened():
        assert time.monotonic() < until, "it did not happen"
        time.sleep(0.02)


def newest(connection: cdcr.Connection) -> np.void:
    """A new record, however long the machine stalls; the status may be 0.1 s old."""
    until = time.monotonic() + TIMEOUT_S
    while len(records := connection.telemetry(0.05)) == 0:
        assert time.monotonic() < until, "there are no records"
    return records[-1]


def mode(connection: cdcr.Connection) -> cdcr.Mode:
    return cdcr.Mode(newest(connection)["mode"])


def curve(robot: cdcr.Robot, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    t = np.linspace(0, seconds, int(200 * seconds) + 1)
    bends = np.zeros((len(t), 2 * robot.sections))
    bends[:, -2], bends[:, -1] = 0.3 * np.sin(t), 0.2 * (1 - np.cos(t))
    return t, robot.forward(bends)
