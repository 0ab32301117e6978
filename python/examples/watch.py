"""Shows twice a second what a running daemon does, until Ctrl-C or for so many seconds.

    python watch.py 10
"""

import sys
import time

import numpy as np

import cdcr


def main(seconds: float) -> None:
    with cdcr.connect(timeout_s=10) as connection:
        status = connection.status()
        print(f"{status['robot_name']}: {status['mode'].name.lower()}, process {status['process_id']}")
        end = time.monotonic() + seconds
        for records in connection.live(batch_s=0.5):
            newest = records[-1]
            response_us = 1e-3 * (records["handed_over_ns"] - records["due_ns"])
            tip_mm = ", ".join(f"{value:.2f}" for value in 1e3 * newest["tip_position_m"])
            # Without a reference there is no error, and the record has NaN.
            error_mm = 1e3 * newest["position_error_m"]
            error = "-" if np.isnan(error_mm) else f"{error_mm:.3g} mm"
            print(
                f"cycle {newest['cycle']}: {cdcr.Mode(newest['mode']).name.lower()}, tip {tip_mm} mm, "
                f"error {error}, response {np.median(response_us):.0f} µs, "
                f"{newest['deadline_misses_total']} deadline misses, {connection.lost_records()} records lost",
                flush=True,
            )
            if time.monotonic() > end:
                return


if __name__ == "__main__":
    try:
        main(float(sys.argv[1]) if len(sys.argv) > 1 else float("inf"))
    except KeyboardInterrupt:
        pass
