"""Measures what docs/decisions/0019-python.md states, with the package installed and from the project's folder:

    cargo build --release && cargo build --release -p cdcr-controller --example one_solve
    python python/tests/measure.py [SECONDS_OF_FEEDING]
"""

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import cdcr

PROGRAMS = Path(__file__).resolve().parents[2] / "target" / "release"
CONFIGURATIONS = 100_000
SOLVES = 2000


def plain_numpy(bends: cdcr.Doubles, length_m: cdcr.Doubles) -> cdcr.Doubles:
    """Tips by rotation matrices, section by section, vectorised over all configurations."""
    position = np.zeros((len(bends), 3))
    rotation = np.tile(np.eye(3), (len(bends), 1, 1))
    for j, length in enumerate(length_m):
        u, v = bends[:, 2 * j], bends[:, 2 * j + 1]
        theta, phi = np.maximum(np.hypot(u, v), 1e-12), np.arctan2(v, u)
        s, c, sp, cp = np.sin(theta), np.cos(theta), np.sin(phi), np.cos(phi)
        step = (length / theta)[:, None] * np.stack([(1 - c) * cp, (1 - c) * sp, s], axis=-1)
        turn = np.stack(
            [
                np.stack([cp * cp * (c - 1) + 1, sp * cp * (c - 1), cp * s], axis=-1),
                np.stack([sp * cp * (c - 1), cp * cp * (1 - c) + c, sp * s], axis=-1),
                np.stack([-cp * s, -sp * s, c], axis=-1),
            ],
            axis=-2,
        )
        position = position + np.einsum("nij,nj->ni", rotation, step)
        rotation = rotation @ turn
    return position


def best_ms(run: Callable[[], object], times: int = 9) -> float:
    took = []
    for _ in range(times):
        begin = time.perf_counter()
        run()
        took.append(time.perf_counter() - begin)
    return 1e3 * min(took)


def kinematics() -> None:
    robot = cdcr.Robot()
    bends = np.random.default_rng(1).uniform(-1.5, 1.5, (CONFIGURATIONS, 6))
    assert np.abs(robot.forward(bends) - plain_numpy(bends, robot.length_m)).max() < 1e-12
    ours, theirs = best_ms(lambda: robot.forward(bends)), best_ms(lambda: plain_numpy(bends, robot.length_m))
    print(f"forward of {CONFIGURATIONS} configurations: {ours:.2f} ms; numpy {theirs:.1f} ms: {theirs / ours:.0f} times")


def solve() -> None:
    robot = cdcr.Robot()
    nmpc = cdcr.Nmpc(robot)
    bend = np.full(6, 0.3)
    window = robot.forward(bend) + [[0, 1e-4, 0], [0, 2e-4, 0]]
    took_us = []
    for _ in range(SOLVES):
        begin = time.perf_counter()
        nmpc.solve(bend, window, seed=1)
        took_us.append(1e6 * (time.perf_counter() - begin))
    text = subprocess.run([PROGRAMS / "examples" / "one_solve"], capture_output=True, text=True, check=True).stdout
    found = re.search(r"([\d.]+) µs", text)
    assert found is not None
    ours, rust = float(np.median(took_us)), float(found[1])
    print(f"solve, median of {SOLVES}: {ours:.2f} µs from Python, {rust:.2f} µs in Rust, {ours - rust:.2f} µs more")


def feeding(seconds: float) -> None:
    """Feeds a point every 5 ms, 0.2 s ahead, while another process keeps a core busy."""
    with tempfile.TemporaryDirectory(prefix="cdcr-python-", dir="/dev/shm") as root:
        environment = {**os.environ, "CDCR_ROOT": root}
        daemon = subprocess.Popen([PROGRAMS / "cdcrd", "run", "--set", "realtime.mode=prefer"], env=environment, stderr=subprocess.DEVNULL)
        busy = subprocess.Popen([sys.executable, "-c", "while True: pass"])
        try:
            with cdcr.connect(root=root, timeout_s=30) as connection:
                robot = connection.robot()
                late_ms = []
                with connection.stream() as stream:
                    begin = stream.now()
                    for k in range(int(200 * seconds)):
                        due = begin + 0.005 * k
                        while (left := due - stream.now()) > 0:
                            time.sleep(left)
                        late_ms.append(1e3 * (stream.now() - due))
                        turn = 0.5 * 0.005 * k
                        bend = [0, 0, 0.3 * np.sin(turn), 0, 0.2 * np.sin(turn), 0.1]
                        stream.send(due + 0.2, robot.forward(bend))
                    time.sleep(0.05)
                    sent, accepted = stream.sent_chunks, stream.accepted_chunks
            print(
                f"feeding {seconds:.0f} s at 200 Hz beside a busy process: {sent} chunks sent, {accepted} accepted; "
                f"Python was at most {max(late_ms):.1f} ms late"
            )
        finally:
            busy.kill()
            daemon.terminate()
            daemon.wait()
            busy.wait()


if __name__ == "__main__":
    kinematics()
    solve()
    feeding(float(sys.argv[1]) if len(sys.argv) > 1 else 60.0)
