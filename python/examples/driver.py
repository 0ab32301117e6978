"""A driver: the process between the daemon and a robot, here one that is simulated in numpy. Its winches follow with a lag of 20 ms.

    cdcrd run --set link.kind=driver --set realtime.mode=prefer &
    python driver.py 10

A driver of your own replaces `Winches` by what talks to your motors. `prefer` lets the daemon run
without real-time priority, to try it; docs/drivers.md says what a driver has to keep.
"""

import sys
import time

import numpy as np

import cdcr

LAG_S = 0.02
NOISE_M = 1e-5


class Winches:
    """Cables moved by motors with a speed interface."""

    def __init__(self, robot: cdcr.Robot) -> None:
        self.length_m = robot.cables(np.zeros(2 * robot.sections))
        self.speed_m_s = np.zeros_like(self.length_m)
        self.random = np.random.default_rng(1)

    def move(self, wanted_m_s: cdcr.Doubles, duration_s: float) -> None:
        share = 1.0 - np.exp(-duration_s / LAG_S)
        self.speed_m_s += share * (wanted_m_s - self.speed_m_s)
        self.length_m += duration_s * self.speed_m_s

    def measure(self) -> cdcr.Doubles:
        return self.length_m + self.random.uniform(-NOISE_M, NOISE_M, len(self.length_m))


def main(seconds: float) -> None:
    with cdcr.connect(timeout_s=10) as connection, connection.driver("velocity") as driver:
        winches = Winches(driver.robot)
        begin = last = time.monotonic()
        while last - begin < seconds:
            # The speeds are zero before the first command and after the newest one has expired.
            wanted = driver.cable_speeds()
            now = time.monotonic()
            winches.move(wanted, now - last)
            last = now
            driver.send(cable_length=winches.measure())
            time.sleep(0.002)
        tip_mm = 1e3 * driver.robot.forward(driver.robot.bend_from_cables(winches.length_m))
        print(f"tip at {tip_mm.round(2)} mm, {driver.refusals()} commands refused")


if __name__ == "__main__":
    try:
        main(float(sys.argv[1]) if len(sys.argv) > 1 else float("inf"))
    except KeyboardInterrupt:
        pass
