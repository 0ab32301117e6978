"""Tunes without a robot: how the weight on changes of the rates and the filter of the estimate trade the error of the tip for calm motors.

    python tune.py tune.png

Each line of the figure is one closed loop of a simulated robot with noise, lag and offsets ("laboratory"), whose tip is measured beside its cables.
"""

import itertools
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import cdcr
from cdcr import plot

WEIGHTS = (0.0, 1e-9, 1e-8)
FILTERS_S = (0.05, 0.15)


def main(file: str) -> None:
    robot = cdcr.Robot()
    start = np.array([0.2, 0.0, 0.2, 0.0, 0.2, 0.0])
    tip = robot.forward(start)
    helix = cdcr.Trajectory.helix([0, 0, tip[2]], tip[0], rise_m=0.02, speed_m_s=0.1)

    figure, (above, below) = plt.subplots(2, figsize=(9, 8), layout="constrained")
    for weight, filter_s in itertools.product(WEIGHTS, FILTERS_S):
        ran = cdcr.simulate(
            robot,
            helix,
            plant="laboratory",
            sensor="both",
            start=start,
            duration_s=6.0,
            settings={"rate_change_weight": weight},
            actuator_time_constant_s=0.02,
            estimator_time_constant_s=filter_s,
        )
        label = f"weight {weight:g}, filter {filter_s:g} s"
        plot.error(ran, ax=above, label=label)
        settled = ran.time_s > 1.0
        change = np.linalg.norm(np.diff(ran.bend_rate_rad_s[settled], axis=0), axis=1)
        error_mm = 1e3 * ran.position_error_m[settled].mean()
        below.plot(change.mean(), error_mm, "o", label=label)
        print(f"{label}: mean error {error_mm:.3f} mm, mean change of the rates {change.mean():.4f} rad/s")
    below.set(xlabel="mean change of the rates from cycle to cycle [rad/s]", ylabel="mean error [mm]")
    below.legend()
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "tune.png")
