"""Feeds a helix to a running daemon and prints how near the tip came.

    cdcrd run &
    python feed_helix.py
"""

import numpy as np

import cdcr


def main() -> None:
    with cdcr.connect(timeout_s=10) as connection:
        robot = connection.robot()
        # Near the top of the workspace, scaled to the robot's length.
        centre = np.array([0.0, 0.0, 0.85 * robot.reach_m])
        t = np.arange(0.0, 4.0, 0.005)
        turn = 2 * np.pi * t / t[-1]
        radius, rise = 0.1 * robot.reach_m, 0.02 * robot.reach_m
        xyz = centre + np.stack([radius * np.cos(turn), radius * np.sin(turn), rise * (t / t[-1] - 0.5)], axis=-1)

        with connection.feed(t, xyz, track=True) as feed:
            records = connection.telemetry(t[-1] + 0.3)
            report = feed.wait()
        assert report is not None
        tracked = records[records["mode"] == cdcr.Mode.TRACKING]
        error_mm = 1e3 * tracked["position_error_m"]
        print(f"{report.points} points in {report.chunks} chunks, {len(tracked)} cycles tracked")
        # The error includes the approach to the reference; it is over in the second half.
        print(f"error: median of the second half {np.median(error_mm[len(error_mm) // 2 :]):.3g} mm, last {error_mm[-1]:.3g} mm")


if __name__ == "__main__":
    main()
