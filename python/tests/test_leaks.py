"""No leaks of memory, descriptors, threads or shared memory."""

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import cdcr
from conftest import TIMEOUT_S, Daemon

SOLVES = 10_000
CONNECTIONS = int(os.environ.get("CDCR_PYTHON_CONNECTIONS", "100"))


def resident_kb() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") // 1024


def held(root: Path | None = None) -> dict[str, int]:
    """The exact counts."""
    return {
        "descriptors": len(os.listdir("/proc/self/fd")),
        "threads": len(os.listdir("/proc/self/task")),
        "mappings of shared memory": Path("/proc/self/maps").read_text().count(str(root)) if root else 0,
        "files": sum(len(files) for _, _, files in os.walk(root)) if root else 0,
    }


def grows_by_kb(run: Callable[[], None], times: int) -> int:
    """Growth from the first tenth, after which every memory pool has its final size, to the end."""
    for _ in range(times // 10):
        run()
    before = resident_kb()
    for _ in range(times - times // 10):
        run()
    return resident_kb() - before


def test_solves_and_kinematics_keep_no_memory() -> None:
    robot = cdcr.Robot()
    nmpc = cdcr.Nmpc(robot)
    bend = np.full(6, 0.3)
    window = robot.forward(bend) + [[0, 1e-4, 0], [0, 2e-4, 0]]
    bends = np.zeros((50, 6))
    balls = [cdcr.Obstacle.sphere([0.5, 0, 0.5], 0.1)]

    def run() -> None:
        nmpc.solve(bend, window, balls)
        robot.backbone(bends)
        try:
            robot.forward(bends[:, :4])
        except cdcr.ArgumentError:
            pass

    # A leak of one small array per call would be 1 MB and more.
    assert grows_by_kb(run, SOLVES) < 500


def test_connections_leave_nothing(daemon: Daemon) -> None:
    use(daemon)
    before = settled(daemon.root)
    grown_kb = grows_by_kb(lambda: use(daemon), CONNECTIONS)
    after = settled(daemon.root)
    assert all(after[name] <= before[name] for name in before), (before, after)
    assert threading.active_count() == 1
    # 4 kB for each of the last nine tenths would be 3.6 MB.
    assert grown_kb < max(1000, 2 * CONNECTIONS), f"{grown_kb} kB"


def settled(root: Path) -> dict[str, int]:
    """Waits until nothing changes: the daemon removes the leftovers of clients once a second."""
    until = time.monotonic() + TIMEOUT_S
    found, since = held(root), time.monotonic()
    while time.monotonic() < min(since + 3, until):
        time.sleep(0.1)
        if (now := held(root)) != found:
            found, since = now, time.monotonic()
    return found


def use(daemon: Daemon) -> None:
    """Uses many ports of a connection: telemetry, requests and obstacles. Repeated when the machine stalls."""
    until = time.monotonic() + TIMEOUT_S
    while True:
        try:
            with daemon.connect() as connection:
                connection.status()
                connection.hold()
                connection.telemetry(0.0)
                connection.clear_obstacles()
            return
        except cdcr.LinkError:
            if time.monotonic() > until:
                raise
