"""Figures of a simulation, of telemetry, of a recording or of a live connection, in one line each. Needs matplotlib: `pip install cdcr[plot]`.

Each function takes what to show first: a Simulation, records of telemetry, what read() gives, or a Connection, which is watched for `seconds`. It draws
into `ax`, or into a new figure, and returns the axes.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from mpl_toolkits.mplot3d import Axes3D  # type: ignore[import-untyped]

from ._cdcr import FAR_LIMIT, SILENT_NS, Connection, Robot, Simulation, dtype
from ._errors import ArgumentError
from ._types import Doubles, Records
from ._wire import TipCause

Source: TypeAlias = Simulation | Records | Mapping[str, Records] | Connection

SHAPES = 4
"""So many shapes of the robot are drawn, from the first to the last."""

OFFSET_M = 1e-4
"""A larger distance of the tip from the end of the shape is drawn."""


@dataclass
class _Shown:
    robot: Robot
    time_s: Doubles
    bend_rad: Doubles
    tip_m: Doubles
    reference_m: Doubles
    error_m: Doubles
    measured_s: Doubles
    measured_error_m: Doubles
    unused_percent: float
    took_s: Doubles
    took: str
    deadline_s: float | None = None


def path(source: Source, *, seconds: float = 2.0, ax: Axes3D | None = None) -> Axes3D:
    """The way of the tip in 3-D beside its reference, with the robot's shape at some moments; a dotted line leads from a shape to a tip that was measured beside it."""
    shown = _shown(source, seconds)
    if ax is None:
        ax = plt.figure(figsize=(6, 6)).add_subplot(projection="3d")
    moments = np.linspace(0, len(shown.time_s) - 1, SHAPES).astype(int)
    has_offset = False
    for moment, shade in zip(moments, np.linspace(0.75, 0.2, SHAPES)):
        body = shown.robot.backbone(shown.bend_rad[moment])
        ax.plot(*body.T, color=str(shade), linewidth=3, solid_capstyle="round")
        # A tip that is measured beside the bends is not where they place it.
        if np.linalg.norm(shown.tip_m[moment] - body[-1]) > OFFSET_M:
            offset = np.stack([body[-1], shown.tip_m[moment]])
            ax.plot(*offset.T, color="black", linewidth=1, linestyle=":", label=None if has_offset else "tip offset")
            has_offset = True
    ax.plot(*shown.reference_m.T, color="tab:orange", linewidth=3, alpha=0.6, label="reference")
    ax.plot(*shown.tip_m.T, color="tab:blue", linewidth=1, label="tip")
    for axis, name in ((ax.xaxis, "x"), (ax.yaxis, "y"), (ax.zaxis, "z")):
        axis.set_label_text(f"{name} [m]")
        axis.labelpad = 8
    _widen(ax)
    ax.legend(loc="upper left")
    return ax


def error(source: Source, *, seconds: float = 2.0, ax: Axes | None = None, label: str | None = None) -> Axes:
    """Distance of the tip from its reference against time; of telemetry with a tip sensor also as measured, and how long that was not in use."""
    shown = _shown(source, seconds)
    ax = _axes(ax)
    words = [label] if label is not None else []
    if shown.unused_percent > 0:
        words.append(f"by the model (measured tip not in use: {shown.unused_percent:.1f} % of the time)")
    elif len(shown.measured_s):
        words.append("estimated")
    ax.semilogy(shown.time_s, 1e3 * np.maximum(shown.error_m, 1e-18), linewidth=1, label=", ".join(words) or None)
    if len(shown.measured_s):
        ax.semilogy(shown.measured_s, 1e3 * np.maximum(shown.measured_error_m, 1e-18), ".", markersize=2, label="as measured")
    ax.set(xlabel="time [s]", ylabel="position error [mm]")
    ax.grid(alpha=0.3)
    if words:
        ax.legend()
    return ax


def timing(source: Source, *, seconds: float = 2.0, ax: Axes | None = None) -> Axes:
    """How long the cycles took: of a daemon, from the release that was due to the hand-over of the command, with the deadline as a line."""
    shown = _shown(source, seconds)
    ax = _axes(ax)
    took_us = np.maximum(1e6 * shown.took_s, 0.1)
    # Powers of ten: a single late cycle must not squeeze the rest into one bar.
    ax.hist(took_us, bins=np.geomspace(0.9 * took_us.min(), 1.1 * took_us.max(), 60).tolist(), log=True)
    ax.set_xscale("log")
    if shown.deadline_s is not None:
        ax.axvline(1e6 * shown.deadline_s, color="black", label=f"deadline, {1e6 * shown.deadline_s:.0f} µs")
        ax.legend()
    median_us, p99_us = np.percentile(took_us, [50, 99])
    ax.set(xlabel=f"{shown.took} [µs]", ylabel="cycles", title=f"median {median_us:.0f} µs, 99 % below {p99_us:.0f} µs, largest {took_us.max():.0f} µs")
    return ax


def _widen(ax: Axes3D) -> None:
    """A robot is longer than wide: the numbers of x and y have room where the box is 0.6 times as wide as tall."""
    x, y, z = (np.array(limits()) for limits in (ax.get_xlim, ax.get_ylim, ax.get_zlim))
    half = max(np.ptp(x), np.ptp(y), 0.6 * np.ptp(z)) / 2
    ax.set(xlim=(x.mean() - half, x.mean() + half), ylim=(y.mean() - half, y.mean() + half))
    for axis in ("x", "y"):
        ax.locator_params(axis=axis, nbins=4)
    ax.set_aspect("equal")


def _axes(ax: Axes | None) -> Axes:
    return plt.figure(figsize=(7, 4), layout="constrained").add_subplot() if ax is None else ax


def _shown(source: Source, seconds: float) -> _Shown:
    if isinstance(source, Simulation):
        if len(source) == 0:
            raise ArgumentError("the simulation has no periods", "Simulate for longer.")
        return _Shown(
            robot=source.robot,
            time_s=source.time_s,
            bend_rad=source.bend_rad,
            tip_m=source.tip_position_m,
            reference_m=source.reference_position_m,
            error_m=source.position_error_m,
            measured_s=np.empty(0),
            measured_error_m=np.empty(0),
            unused_percent=0.0,
            took_s=source.solve_s,
            took="solve, safety checks and simulated robot",
        )
    if isinstance(source, Connection):
        source = source.telemetry(seconds)
    if isinstance(source, Mapping):
        source = source.get("telemetry", np.empty(0, dtype("Telemetry")))
    if not isinstance(source, np.ndarray) or source.dtype != dtype("Telemetry") or source.ndim != 1:
        found = f"an array of {source.dtype}" if isinstance(source, np.ndarray) else f"a {type(source).__name__}"
        raise ArgumentError(f"{found[:80]} cannot be drawn", "Give a Simulation, what read() returns, records of telemetry, or a Connection.")
    if len(source) == 0:
        raise ArgumentError("there are no records of telemetry", "Watch for longer, or record telemetry.")
    # Without a reference the error is not a number, and the position of none is zero.
    has_reference = np.isfinite(source["position_error_m"])
    sections = int(source["robot"]["sections"][0])
    is_stray = _is_stray(source)
    measured_ns, measured_error_m = _measured_error(source, has_reference, is_stray)
    unused = ((source["tip_cause"] != 0) & ~is_stray | _is_silent(source))[has_reference]
    return _Shown(
        robot=_robot(source["robot"][0]),
        time_s=1e-9 * (source["release_ns"] - source["release_ns"][0]).astype(float),
        bend_rad=source["present_rad"][:, : 2 * sections],
        tip_m=source["tip_position_m"],
        reference_m=np.where(has_reference[:, None], source["reference"]["position_m"], np.nan),
        error_m=np.where(has_reference, source["position_error_m"], np.nan),
        measured_s=1e-9 * (measured_ns - float(source["release_ns"][0])),
        measured_error_m=measured_error_m,
        unused_percent=100 * float(unused.mean()) if len(unused) else 0.0,
        took_s=1e-9 * (source["handed_over_ns"] - source["due_ns"]).astype(float),
        took="response time",
        deadline_s=1e-9 * float(source["deadline_ns"][-1]),
    )


def _is_silent(source: Records) -> np.ndarray:
    """Where the tip sensor is silent, from its last measurement on: tip and error are those of the model."""
    tip_ns = source["tip_measured_ns"].astype(np.int64)
    _, measurement = np.unique(tip_ns, return_inverse=True)
    silent_ns = np.zeros(len(source), dtype=np.int64)
    np.maximum.at(silent_ns, measurement, source["release_ns"].astype(np.int64) - tip_ns)
    return (tip_ns > 0) & (silent_ns[measurement] > SILENT_NS)


def _is_stray(source: Records) -> np.ndarray:
    """Where the newest measured tip is one that the daemon refused, and fewer in a row than make a wrong sensor, as in cdcrctl."""
    cause, tip_ns, release_ns = source["tip_cause"], source["tip_measured_ns"], source["release_ns"].astype(np.int64)
    is_refused = cause != 0
    # Cycles without another cause between them are one run.
    run = np.cumsum(np.diff(is_refused, prepend=False))
    is_new = is_refused & (np.diff(tip_ns, prepend=np.uint64(0)) != 0)
    first = np.flatnonzero(np.diff(run, prepend=-1))[np.unique(run, return_inverse=True)[1]]
    before = np.cumsum(is_new) - is_new
    in_a_row = np.cumsum(is_new) - before[first]
    limit = np.where(cause == TipCause.FAR, FAR_LIMIT, np.where(cause == TipCause.JUMPS, source["measurement_jump_limit"], 0))
    lasts = (in_a_row > 1) & (release_ns - release_ns[first] > SILENT_NS)
    is_wrong = is_refused & ((in_a_row >= limit) | lasts)
    is_stray: np.ndarray = is_refused & (np.bincount(run, weights=is_wrong)[run] == 0)
    return is_stray


def _measured_error(source: Records, has_reference: np.ndarray, is_stray: np.ndarray) -> tuple[Doubles, Doubles]:
    """When the tip was measured [ns], and how far from where its reference was then. Stray tips are left out."""
    tip_ns = source["tip_measured_ns"]
    new = np.flatnonzero((np.diff(tip_ns, prepend=tip_ns[:1]) > 0) & ~is_stray)
    release_ns = source["release_ns"]
    after = np.searchsorted(release_ns, tip_ns[new])
    inside = (after > 0) & (after < len(source))
    new, after = new[inside], after[inside]
    kept = has_reference[after] & has_reference[after - 1]
    new, after = new[kept], after[kept]
    times_ns = tip_ns[new].astype(float)
    from_ns, to_ns = release_ns[after - 1].astype(float), release_ns[after].astype(float)
    share = ((times_ns - from_ns) / (to_ns - from_ns))[:, None]
    reference_m = source["reference"]["position_m"]
    then_m = (1 - share) * reference_m[after - 1] + share * reference_m[after]
    return times_ns, np.linalg.norm(source["tip_measured_m"][new] - then_m, axis=1)


def _robot(robot: np.void) -> Robot:
    """That of a message RobotDescription."""
    used = robot["section"][: robot["sections"]]
    names = ("length_m", "cable_radius_m", "cable_offset_rad", "bend_max_rad", "rate_max_rad_s", "body_radius_m")
    numbers = {name: used[name] for name in names}
    of_all = ("cable_speed_max_m_s", "cable_stroke_max_m", "tip_speed_max_m_s", "self_overlap_max_m")
    return Robot(**numbers, **{name: float(robot[name]) for name in of_all})
