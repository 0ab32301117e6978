"""A ball swings through the way of the robot: its position is sent 50 times a second, and the body keeps its distance.

    cdcrd run &
    python moving_obstacle.py
"""

import time

import numpy as np

import cdcr

SECONDS = 4.0
SWING_M, TURNS_S = 0.05, 4.0


def ball(robot: cdcr.Robot, time_s: float) -> cdcr.Obstacle:
    """Beside the last section of the straight robot."""
    turn = 2 * np.pi * time_s / TURNS_S
    place = np.array([0.1 + SWING_M * np.cos(turn), 0.0, 0.75 * robot.reach_m])
    velocity = np.array([-SWING_M * np.sin(turn) * 2 * np.pi / TURNS_S, 0.0, 0.0])
    return cdcr.Obstacle.sphere(place, 0.03, velocity)


def main() -> None:
    with cdcr.connect(timeout_s=10) as connection:
        robot = connection.robot()
        connection.home()
        for records in connection.live(batch_s=0.1):
            if records["mode"][-1] != cdcr.Mode.HOMING:
                break
        # The reference holds the tip at its position: only the body has to give way.
        tip = np.array([0.0, 0.0, 0.97 * robot.reach_m])
        t = np.array([0.0, 1.0, SECONDS + 60.0])
        with connection.feed(t, np.tile(tip, (3, 1)), track=True):
            telemetry = connection.live(batch_s=0.02)
            begin = time.monotonic()
            clearance_m: list[float] = []
            try:
                while (now := time.monotonic() - begin) < SECONDS:
                    # If this program dies, the obstacle expires half a second after the last update.
                    connection.set_obstacles({1: ball(robot, now)}, lifetime_s=0.5)
                    clearance_m.extend(next(telemetry)["clearance_m"])
            finally:
                connection.remove_obstacles([1])
        seen = np.array(clearance_m)
        seen = seen[np.isfinite(seen)]
        print(f"{len(seen)} cycles beside the ball, least clearance {1e3 * seen.min():.2f} mm")


if __name__ == "__main__":
    main()
